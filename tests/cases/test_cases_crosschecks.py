"""Stacks that contradict each other: averaged darks, black levels that change, filtered noise,
tracks. Shared inputs, and siblings drawn here.
"""

import re

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, median_filter, uniform_filter

from charact.estimators import noise
from labdata import Conditions, FrameStack
from tests.truth.counted_pulses import QUICK, one, session_of

GAIN, READ_E, BLACK_DN = 0.4, 5.0, 100.0
# Read noise and the rounding of single frames, DN.
NOISE_DN = np.hypot(GAIN * READ_E, 12.0**-0.5)
LEVELS_E = (250.0, 800.0, 2000.0, 4000.0, 6000.0)


def frames_of(rng, electrons, count, size=(160, 200), gain=GAIN):
    """Draw frames of a plain digital camera, shape (frame, row, col), DN."""
    charge = rng.poisson(electrons, (count, *size)) + READ_E * rng.standard_normal((count, *size))
    return np.rint(BLACK_DN + gain * charge)


def unchanged(data):
    return data


def measured(rng, *, dark=unchanged, flat=unchanged, dark_frames=2, flat_frames=2, **more):
    """Measure darks and flats of the camera, each after a function of its frames."""
    stacks = [("dark", "dark", dark(frames_of(rng, 0.0, dark_frames, **more)), Conditions())]
    stacks += [
        (f"flat-{n}", "flat", flat(frames_of(rng, level, flat_frames, **more)), Conditions())
        for n, level in enumerate(LEVELS_E)
    ]
    session = session_of(
        [
            (label, kind, FrameStack(data=data.astype(np.float32)), conditions)
            for label, kind, data, conditions in stacks
        ]
    )
    return noise.measure(session, context=QUICK)


def holds(measurement, truth):
    """Whether a number is ok and its interval holds the truth."""
    assert measurement.status == "ok", measurement.notes
    low, high = measurement.interval95
    assert low <= truth <= high, (low, truth, high)


def never_silent(measurement, truth):
    """Whether a number is not ok where its interval excludes the truth."""
    if measurement.status == "ok":
        holds(measurement, truth)


def notes_on(result, flag):
    return {note for m in result.measurements for note in m.notes if note.startswith(f"{flag}: ")}


def means_of(n):
    return lambda data: data.reshape(-1, n, *data.shape[1:]).mean(axis=1)


def test_averaged_darks_give_the_noise_of_single_frames(case):
    result = case("v1-master-darks")
    read = one(result, "read_noise", "DN")
    # 5 e- at 0.40 DN/e-, and the steps of the digitiser.
    assert read.value == pytest.approx(np.hypot(2.0, 12.0**-0.5), rel=0.02)
    holds(one(result, "read_noise", "e-"), 5.0)
    holds(one(result, "system_gain"), 0.40)
    assert any("mean of 16" in note for note in read.notes)


@pytest.mark.parametrize("n", [2, 10, 25])
def test_the_steps_of_means_say_of_how_many(seed, n):
    result = measured(np.random.default_rng(seed), dark=means_of(n), dark_frames=2 * n)
    holds(one(result, "read_noise", "DN"), NOISE_DN)
    holds(one(result, "read_noise", "e-"), READ_E)
    holds(one(result, "system_gain"), GAIN)
    assert any(f"mean of {n}:" in note for note in one(result, "read_noise", "DN").notes)


@pytest.mark.parametrize("n", [4, 9])
def test_averaged_flats_under_single_darks_give_the_gain_of_single_frames(seed, n):
    result = measured(np.random.default_rng(seed), flat=means_of(n), flat_frames=2 * n)
    holds(one(result, "system_gain"), GAIN)
    holds(one(result, "read_noise", "e-"), READ_E)


@pytest.mark.parametrize(
    "combined",
    [
        lambda data: np.rint(means_of(16)(data)),
        lambda data: np.median(data.reshape(-1, 9, *data.shape[1:]), axis=1),
        lambda data: np.einsum(
            "tnij,n->tij",
            data.reshape(-1, 9, *data.shape[1:]),
            np.sqrt(np.arange(1.0, 10.0)) / 19.306,
        ),
    ],
    ids=["rounded", "median", "weighted"],
)
def test_darks_quieter_than_flats_at_no_light_are_no_read_noise(seed, combined):
    """Without steps the intercept of the flats contradicts the darks."""
    result = measured(np.random.default_rng(seed), dark=combined, dark_frames=144, flat_frames=6)
    for unit, truth in (("DN", NOISE_DN), ("e-", READ_E)):
        read = one(result, "read_noise", unit)
        assert "dark-mismatch" in read.flags, unit
        never_silent(read, truth)
    (note,) = {note for note in one(result, "read_noise", "DN").notes if "no light" in note}
    numbers = re.search(r"at no light (\S+) ± (\S+) DN2", note)
    assert numbers is not None and "darks are quieter" in note
    at_no_light, half = (float(number) for number in numbers.groups())
    assert abs(at_no_light - NOISE_DN**2) < 1.5 * half


def test_single_darks_agree_with_their_flats(seed):
    for n in range(4):
        result = measured(np.random.default_rng([seed, n]), size=(96, 128))
        assert not notes_on(result, "dark-mismatch") and not notes_on(result, "drift")
        assert one(result, "read_noise", "DN").status == "ok"


def test_a_step_of_the_black_level_is_named(case):
    result = case("x1-dark-step-8")
    for m in (one(result, "dark_signal"), one(result, "system_gain")):
        (note,) = [note for note in m.notes if note.startswith("drift: ")]
        assert "steps up by 8 DN after frame 12 of 24" in note
    # Darks before and after the step, and the ratio that the flats' black level gives.
    holds(one(result, "dark_signal"), 100.0)
    holds(one(result, "dark_signal"), 108.0)
    (dimmest,) = [m for m in result.find("snr") if m.stack == "flat-00"]
    holds(dimmest, 15.02)
    holds(one(result, "system_gain"), 0.40)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda at: np.where(at < 5, 6.0, 0.0), "steps down by 6"),
        (lambda at: np.where(at < 15, 0.0, -3.0), "steps down by 3"),
        (lambda at: 0.4 * at, "drifts up by"),
    ],
    ids=["down", "late", "ramp"],
)
@pytest.mark.parametrize("kind", ["dark", "flat"])
def test_levels_that_change_are_named_with_frame_and_size(seed, change, words, kind):
    if kind == "flat" and "3" in words:
        pytest.skip("one frame of 16 moves the mean of the dimmest flat by .2 % only")
    shifts = change(np.arange(16.0))[:, None, None]
    result = measured(
        np.random.default_rng(seed),
        dark_frames=16,
        flat_frames=16,
        size=(96, 128),
        **{kind: lambda data: data + shifts},
    )
    drifts = notes_on(result, "drift")
    assert any(words in note for note in drifts)
    if words.startswith("steps"):
        after = 5 if "6" in words else 15
        assert any(f"after frame {after} of 16" in note for note in drifts)
    if kind == "dark":
        dark = one(result, "dark_signal")
        holds(dark, BLACK_DN)
        assert any(words in note for note in dark.notes)
        never_silent(one(result, "system_gain"), GAIN)


def with_tracks(rng, *, level_dn, horizontal=False, number=4, length=12, rim=0.0):
    """Return a function that adds tracks of a level to frames, each in one frame; `rim`: part of
    the charge in the rows above and below.
    """

    def add(data):
        data = data.copy()
        frames, rows, cols = data.shape
        for _ in range(number):
            angle = 0.0 if horizontal else rng.uniform(0.0, np.pi)
            along = np.arange(length)
            row = (rng.uniform(30, rows - 30) + along * np.sin(angle)).astype(int)
            col = (rng.uniform(30, cols - 30) + along * np.cos(angle)).astype(int)
            charge, frame = rng.gamma(9.0, level_dn / 9.0, length), rng.integers(frames)
            data[frame, row, col] += np.rint(charge)
            for step in (-1, 1):
                data[frame, row + step, col] += np.rint(rim * charge)
        return data

    return add


def test_tracks_of_cosmic_rays_leave_both_gains(case):
    result = case("jj1-cosmic-tracks")
    for quantity in ("covariance_gain", "system_gain"):
        holds(one(result, quantity), 0.569)
    assert one(result, "system_gain").value == pytest.approx(0.569, rel=0.02)


@pytest.mark.parametrize(
    ("stacks", "frames", "more"),
    [
        (("dark", "flat"), 2, {"level_dn": 900.0}),
        (("dark",), 2, {"level_dn": 60.0, "number": 12}),
        (("dark", "flat"), 8, {"level_dn": 600.0, "horizontal": True, "length": 25}),
        (("flat",), 4, {"level_dn": 900.0, "number": 8, "rim": 0.02}),
    ],
    ids=["all", "darks", "horizontal", "rims"],
)
def test_tracks_are_hits_as_single_pixels_are(seed, stacks, frames, more):
    rng = np.random.default_rng(seed)
    result = measured(
        rng,
        dark_frames=frames,
        flat_frames=frames,
        **dict.fromkeys(stacks, with_tracks(rng, **more)),
    )
    for quantity, truth in (("system_gain", GAIN), ("covariance_gain", GAIN), ("blur_factor", 1.0)):
        number = one(result, quantity)
        assert number.status == "ok", number.notes
        assert abs(number.value - truth) < 4.5 * np.ptp(number.interval95) / 3.92
    assert one(result, "read_noise", "DN").value == pytest.approx(NOISE_DN, rel=0.02)


def test_a_median_in_the_camera_is_named(case):
    result = case("u1-median-3x3")
    for gain in result.find("covariance_gain"):
        assert "processed" in gain.flags
        assert any("median of 3 x 3" in note for note in gain.notes)


@pytest.mark.parametrize("size", [(3, 3), (5, 5), (1, 3)])
def test_medians_of_every_size_are_processed(seed, size):
    result = measured(
        np.random.default_rng(seed), flat=lambda data: median_filter(data, (1, *size))
    )
    (gain,) = result.find("covariance_gain")
    assert "processed" in gain.flags
    assert any(f"median of {size[0]} x {size[1]}" in note for note in gain.notes)


@pytest.mark.parametrize(
    "smooth",
    [
        unchanged,
        lambda data: np.rint(uniform_filter(data, (1, 3, 3), mode="wrap")),
        lambda data: np.rint(gaussian_filter(data, (0.0, 1.0, 1.0), mode="wrap")),
        lambda data: 7.0 * np.rint(data / 7.0),
    ],
    ids=["raw", "mean", "gaussian", "steps"],
)
def test_linear_smoothing_and_coarse_steps_are_no_median(seed, smooth):
    result = measured(np.random.default_rng(seed), flat=smooth, dark=smooth)
    assert not {note for note in notes_on(result, "processed") if "median" in note}


def test_many_tracks_in_a_long_dark_are_hits_too(seed):
    """Outliers of a twentieth of the pixels, over all frames, are followed along their tracks."""
    rng = np.random.default_rng(seed)
    tracks = with_tracks(rng, level_dn=500.0, number=20, length=15)
    result = measured(rng, dark=tracks, dark_frames=16, size=(80, 96))
    assert one(result, "read_noise", "DN").value == pytest.approx(NOISE_DN, rel=0.02)
