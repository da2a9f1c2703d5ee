"""Frames drawn from the posterior beside those measured: right models pass, wrong ones are told by
what no fit saw.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from charact.estimators import noise
from charact.estimators.noise import (
    fit_single_setting,
    gain_line,
    predictive_check,
    read_levels,
    series_of,
)
from labdata import FrameStack
from tests.truth.counted_pulses import QUICK, Pulses, flat_series, gaussian, memory_of, session_of

LEVELS = (1.0, 4.0, 12.0, 36.0)
SHAPE = 112, 112


def told(session):
    """Signs of a session beside those drawn from what is fitted to it."""
    darks, flats, single = read_levels(session, context=QUICK, spectra=True)
    one = fit_single_setting(series_of(flats, darks, single), context=QUICK, quick=True)
    gain = gain_line(one.series, context=QUICK).slope if one.white else None
    return predictive_check.predictive_residuals(session.stacks, one, gain, context=QUICK)


def changed(session, in_memory, change):
    """The same with other flats, each changed as a whole, shape (frame, row, col)."""
    stacks = []
    for entry in session.stacks:
        data = entry.read().data.astype(float)
        data = np.clip(np.rint(change(data) if entry.kind == "flat" else data), 0, 65535).astype(
            np.uint16
        )
        stacks.append(
            (
                entry.label,
                entry.kind,
                FrameStack(data=data, full_scale_dn=65535.0),
                entry.conditions,
            )
        )
    return in_memory(stacks)


@pytest.mark.parametrize("kind", ["wings", "lag", "white"])
def test_a_camera_that_is_as_the_model_has_it_is_not_called_wrong(seed, kind):
    camera = {
        "wings": Pulses(transfer=lambda f: np.exp(-((f / 0.25) ** 1.2)), shape=SHAPE),
        "lag": Pulses(transfer=gaussian(0.9), memory=memory_of(0.3), shape=SHAPE),
        "white": Pulses(gain_dn=0.0, electron_gain_dn=0.5, shape=SHAPE),
    }[kind]
    levels = tuple(100.0 * level for level in LEVELS) if kind == "white" else LEVELS
    found = told(flat_series(camera, np.random.default_rng(seed), levels, frames=6, dark_frames=6))
    assert {one.stack for one in found} == {"flat-0", "flat-2", "flat-3"}
    assert not predictive_check.findings_of(found)


@pytest.mark.parametrize("wrong", ["flicker", "blobs", "gamma", "patches"])
def test_what_the_model_has_not_is_found_by_its_own_sign(seed, wrong):
    rng = np.random.default_rng(seed)

    def flicker(data):
        return 100.0 + (data - 100.0) * (1.0 + 0.03 * rng.standard_normal((len(data), 1, 1)))

    def blobs(data):
        """Rare flashes a few pixels wide, of two hundred photoelectrons each."""
        return data + gaussian_filter(200.0 * 20.0 * rng.poisson(2e-4, data.shape), (0, 3, 3))

    def gamma(data):
        return 100.0 + 20.0 * np.maximum(data - 100.0, 0.0) ** 0.7

    def patches(data):
        """Noise, and not light, that is nearly twice as strong here and nearly none there."""
        steady, wave = data.mean(axis=0), np.sin(np.linspace(0.0, 6.0 * np.pi, data.shape[2]))
        return steady + (data - steady) * (1.0 + 0.9 * wave)

    change, sign = {
        "flicker": (flicker, "flicker"),
        "blobs": (blobs, "skewness"),
        "gamma": (gamma, "variance"),
        "patches": (patches, "patches"),
    }[wrong]
    camera = Pulses(transfer=gaussian(0.9), shape=SHAPE)
    # Few frames tell little of how their means vary.
    frames = 8 if wrong == "flicker" else 5
    found = told(
        changed(flat_series(camera, rng, LEVELS, frames=frames, dark_frames=5), session_of, change)
    )
    flags = predictive_check.findings_of(found)
    assert flags and all(entry.flag == "model-misfit" for entry in flags)
    assert any(
        one.sign == sign and one.chance * len(found) < predictive_check.PREDICTIVE.false_alarm
        for one in found
    )


def test_a_number_that_is_not_quick_carries_what_its_frames_say(seed):
    rng = np.random.default_rng(seed)

    def flashes(data):
        return data + gaussian_filter(200.0 * 20.0 * rng.poisson(2e-4, data.shape), (0, 3, 3))

    camera = Pulses(transfer=gaussian(0.9), shape=SHAPE)
    session = changed(
        flat_series(camera, rng, LEVELS[:3], frames=5, dark_frames=5), session_of, flashes
    )
    result = noise.measure(session, method="covariance-sum", context=replace(QUICK, quick=False))
    (gain,) = result.find("covariance_gain")
    assert "model-misfit" in gain.flags
    assert any("frames drawn from the posterior" in note for note in gain.notes)
    evidence = result.evidence["predictive-frames"]
    assert len(evidence["chance"]) == len(evidence["sign"]) and min(evidence["chance"]) < 1e-4
    assert (
        "predictive-frames"
        not in noise.measure(session, method="covariance-sum", context=QUICK).evidence
    )
