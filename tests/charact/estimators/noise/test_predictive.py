"""Frames drawn from the posterior beside those measured: right models pass, wrong ones are told by
what no fit saw.
"""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from charact.estimators import noise
from charact.estimators.noise import predictive_check
from charact.estimators.noise.gain import emva1288
from charact.estimators.noise.gain.series import read_levels, series_of
from charact.estimators.noise.gain.single_setting import fit_single_setting
from charact.estimators.noise.predictive_check import LightNoise
from labdata import FrameStack
from tests.truth.counted_pulses import QUICK, Pulses, flat_series, gaussian, memory_of, session_of

LEVELS = (1.0, 4.0, 12.0, 36.0)
SHAPE = 112, 112


def told(session):
    """Signs of a session beside those drawn from what is fitted to it."""
    darks, flats, single = read_levels(session, context=QUICK, spectra=True)
    one = fit_single_setting(series_of(flats, darks, single), context=QUICK, quick=True)
    gain = emva1288.gain_line(one.series, context=QUICK).slope if one.white else None
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
    assert [flag for flag, _ in flags] == ["model-misfit"] * len(flags) and flags
    assert any(
        one.sign == sign and one.chance * len(found) < predictive_check.PREDICTIVE.false_alarm
        for one in found
    )


def test_chances_are_no_smaller_than_they_say(seed, monkeypatch):
    """Frames drawn from the very law: of each sign no more are odd than chance has it, with nothing
    held harmless.
    """
    monkeypatch.setattr(
        predictive_check,
        "STATISTICS",
        {n: replace(sign, harmless=0.0) for n, sign in predictive_check.STATISTICS.items()},
    )
    rng, sets, odd = np.random.default_rng(seed), 30, 0.1
    law = LightNoise(pulse_dn=20.0, height_variance=1.0, electron_gain_dn=0.1)
    light, dark = np.full((40, 40), 80.0), 2.0 * rng.standard_normal((6, 40, 40))
    seen: Counter[str] = Counter()
    for _ in range(sets):
        frames = law.frames(light, 4, 1, rng) + 2.0 * rng.standard_normal((4, 40, 40))
        seen.update(
            one.sign
            for one in predictive_check._stack_residuals("flat", frames, dark, lambda: law, 1, rng)
            if one.chance < odd
        )
    most = sets * odd + 4.5 * np.sqrt(sets * odd * (1.0 - odd))
    assert max(seen.values()) <= most, seen
    assert sum(seen.values()) >= 0.25 * odd * sets * len(predictive_check.STATISTICS)


@pytest.mark.parametrize(("kept", "spread"), [(0.0, 0.0), (0.4, 1.0), (0.6, 0.5)])
def test_light_of_decaying_pulses_has_the_cumulants_of_shot_noise(seed, kept, spread):
    """Cumulants of a sum of exposures, each (1 - r) r^i of compound Poisson light (Campbell's
    theorem).
    """
    light, pulse, every, pixels = 40.0, 5.0, 2, 400
    law = LightNoise(pulse_dn=pulse, height_variance=spread, electron_gain_dn=0.0, retained=kept)
    drawn = law.frames(np.full((pixels, pixels), light), 3, every, np.random.default_rng(seed))
    age = np.arange(200)
    left = (1.0 - kept) * kept**age
    variance = light * pulse * (1.0 + spread) * np.sum(left**2)
    third = light * pulse**2 * (1.0 + spread) * (1.0 + 2.0 * spread) * np.sum(left**3)
    for frame in drawn:
        off = frame - light
        errors = 5.0 / pixels
        assert abs(off.mean()) < errors * np.sqrt(variance)
        assert abs(off.var() / variance - 1.0) < errors * np.sqrt(4.0)
        assert abs(np.mean(off**3) - third) < errors * np.sqrt(20.0) * variance**1.5
    correlation = np.corrcoef(drawn[1].ravel(), drawn[2].ravel())[0, 1]
    assert abs(correlation - kept**every) < 5.0 / pixels


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
