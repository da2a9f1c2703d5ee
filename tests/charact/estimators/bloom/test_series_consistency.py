"""Gain, dark, place and light of a series stay as they are, or it is said which does not."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from charact.estimators.bloom import check_consistency, read_point_stacks
from charact.method import Context
from labdata import FrameStack
from tests.truth.bloom import bloom_session, noiseless_frame
from tests.truth.bloom_light import BloomScene
from tests.truth.sessions import stack_in_memory

QUICK = Context(seed=1, quick=True)
LEVELS = (0.7, 10.0, 300.0, 1e4)
FRAME_S = 1.0 / 30.0


def flags_of(found, label=None):
    """Flags of the findings of a stack, or of all."""
    labels = found.findings if label is None else (label,)
    return {check.flag for name in labels for check in found.findings[name]}


def followed(scene, rng, overloads=LEVELS) -> Any:
    series = bloom_session(scene, overloads, rng)
    return check_consistency(series, read_point_stacks(series, context=QUICK), QUICK, method="test")


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"frames": 3},
        {"glare_fraction": 0.05, "wing_share": 0.1},
        {"lag": 0.3, "full_well_dn": 300.0},
    ],
    ids=["calm", "three frames", "glare and wing", "afterglow and streak"],
)
def test_a_series_at_rest_has_no_flags(seed, settings):
    rng = np.random.default_rng(seed)
    for _ in range(2):
        assert not flags_of(followed(BloomScene(**settings), rng))


def test_an_automatic_gain_is_seen_and_its_fall_measured(seed):
    """The background falls with the gain, and nothing of this scene lights it: the bound is the
    fall itself.
    """
    scene = BloomScene(agc=True, halo_diameter_px=30.0)
    found = followed(scene, np.random.default_rng(seed))
    assert all(flags_of(found, f"point-{number}") == {"agc"} for number in (1, 2, 3))
    assert not flags_of(found, "point-0")
    row = noiseless_frame(scene, LEVELS[0])[:, 0]
    for number, overload in enumerate(LEVELS[1:], start=1):
        (fall,) = [
            one for one in found.measurements if one.stack == f"point-{number}" and one.unit == "dB"
        ]
        dimmed = noiseless_frame(scene, overload, faintest=LEVELS[0])[:, 0]
        true = 20.0 * np.log10(np.median(row - scene.dark_dn) / np.median(dimmed - scene.dark_dn))
        assert fall.status == "ok" and "at least" in fall.notes[0]
        assert abs(fall.value - true) < 4.0 * 0.5 * (fall.interval68[1] - fall.interval68[0])


def test_glare_is_no_gain_that_rises(seed):
    found = followed(BloomScene(glare_fraction=0.3), np.random.default_rng(seed), (0.7, 1e4))
    (fall,) = [one for one in found.measurements if one.unit == "dB"]
    assert fall.status == "refused" and "the source's own light" in fall.reason


@pytest.mark.parametrize("motion_px", [0.2, 4.0, 10.0])
def test_a_source_that_moves_drifts(seed, motion_px):
    found = followed(BloomScene(motion_px=motion_px), np.random.default_rng(seed))
    drifts = [
        check for checks in found.findings.values() for check in checks if check.flag == "drift"
    ]
    assert len(drifts) >= 3
    # Seven steps move the source by as many times its motion; 2 t / pi of it a diameter.
    travel_px = [0.5 * np.pi * check.bound for check in drifts if check.bound is not None]
    assert motion_px > 1.0 or travel_px == pytest.approx(
        [7.0 * motion_px] * len(travel_px), rel=0.2
    )


@pytest.mark.parametrize("off_dn", [-3.0, 3.0, 6.0])
def test_darks_of_another_level_do_not_fit(seed, off_dn):
    """Noise knows where darkness is, even where the wrong dark leaves the background above it."""
    found = followed(BloomScene(wrong_dark_dn=off_dn), np.random.default_rng(seed))
    assert all("dark-mismatch" in flags_of(found, label) for label in found.findings)


def going_out(rng, decay_s, *, frames=24, lit=8, phase=0.4, stamps=True) -> Any:
    """A source that goes out a share of a frame after the stamp of its last full one, and fades
    like an exponential.
    """
    scene = BloomScene(frames=frames, halo_fraction=0.3)
    faint = bloom_session(replace(scene, frames=8), (0.7,), rng)
    # So bright that noise is far less than a hundredth of it.
    picture = noiseless_frame(scene, 100.0) - scene.dark_dn - scene.background_dn
    times = FRAME_S * np.arange(frames)
    out = times[lit - 1] + phase * FRAME_S
    left = np.where(times <= out, 1.0, np.exp(-(times - out) / decay_s))
    mean = left[:, None, None] * picture + scene.background_dn
    noisy = scene.dark_dn + 0.8 * rng.poisson(mean / 0.8) + 0.6 * rng.standard_normal(mean.shape)
    data = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    held = FrameStack(data=data, time_s=times if stamps else np.empty(0), full_scale_dn=255.0)
    entry: Any = faint.stack("point-0")
    bright = stack_in_memory(
        "point", held, replace(entry.conditions, illuminance_lux=4e-5), label="fading"
    )
    series = replace(faint, stacks=(*faint.stacks, bright))
    return check_consistency(series, read_point_stacks(series, context=QUICK), QUICK, method="test")


def test_recovery_is_timed_from_a_source_that_goes_out(seed):
    """Time constant t: ln 10 t and ln 100 t, as often as promised over all places of the going out
    between two frames.

    At one place an interval holds always or, within a fortieth of a frame from its ends, never.
    """
    rng = np.random.default_rng(seed)
    sources = 12
    held: dict[float, list[bool]] = {0.1: [], 0.01: []}
    error_frames: dict[float, list[float]] = {0.1: [], 0.01: []}
    for number, phase in enumerate(rng.random(sources)):
        decay_s = (0.06, 0.03)[number % 2]
        found = going_out(rng, decay_s, phase=phase)
        assert flags_of(found, "fading") == {"lag"}
        for measured, share in zip(
            (m for m in found.measurements if m.unit == "s"), held, strict=True
        ):
            assert measured.status == "ok", measured
            true_s, (low_s, high_s) = -np.log(share) * decay_s, measured.interval95
            held[share].append(low_s <= true_s <= high_s)
            error_frames[share].append((measured.value - true_s) / FRAME_S)
            assert high_s - low_s < 3.0 * FRAME_S
    for share, errors in error_frames.items():
        assert np.mean(held[share]) > 0.95 - 4.5 * np.sqrt(0.95 * 0.05 / sources), share
        # Evenly spread over a frame, the going out errs by a frame over the root of 12.
        assert abs(np.mean(errors)) < 4.5 / np.sqrt(12.0 * sources), share


def test_recovery_says_what_it_lacks(seed):
    rng = np.random.default_rng(seed)
    reasons = [
        [one.reason for one in found.measurements if one.unit == "s"]
        for found in (
            followed(BloomScene(), rng, (0.7, 10.0)),
            going_out(rng, 0.06, stamps=False),
            going_out(rng, 1.0),
        )
    ]
    assert all("no stack shows" in reason for reason in reasons[0]) and len(reasons[0]) == 2
    assert all("times of the frames" in reason for reason in reasons[1])
    assert all(
        "of the light is left" in reason or "no stack shows" in reason for reason in reasons[2]
    )
