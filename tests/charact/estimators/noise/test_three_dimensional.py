"""The seven components of 3-D noise, on cubes whose components are known because they are drawn
here.
"""

import tracemalloc

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from charact.estimators import noise
from charact.frames import components
from charact.frames.contrasts import contrasts
from charact.method import Context
from labdata import Conditions, FrameStack
from tests.truth.counted_pulses import QUICK, Pulses, flat_series, session_of

NAMES = ("t", "v", "h", "tv", "th", "vh", "tvh")
CUBES = 40
# 95 % of 40, less four standard errors.
LEAST_HELD = 33
MARGIN = 12


def kept(rng, shape, lag):
    """White noise that keeps a share from frame to frame."""
    out = rng.standard_normal(shape)
    for frame in range(1, len(out)):
        out[frame] = lag * out[frame - 1] + np.sqrt(1.0 - lag**2) * out[frame]
    return out


def blurred(image, blur_px):
    """Noise blurred in each frame, its variance restored; the margin is cut off."""
    power = float(np.sum(gaussian_filter1d(np.eye(1, 61, 30)[0], blur_px) ** 2))
    inner = np.s_[:, MARGIN:-MARGIN, MARGIN:-MARGIN]
    return (gaussian_filter(image, (0, blur_px, blur_px)) / power)[inner]


def cube(rng, shape, sd, *, blur_px=0.0, lag=0.0):
    """All seven components at once about 1000 DN; `sd` in the order of NAMES, DN."""
    margin = 2 * MARGIN if blur_px else 0
    random = kept(rng, (shape[0], shape[1] + margin, shape[2] + margin), lag)
    out = 1000.0 + sd[6] * (blurred(random, blur_px) if blur_px else random)
    for share, own in zip(
        sd[:6], ((1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1)), strict=True
    ):
        out += share * rng.standard_normal(
            [length if axis else 1 for length, axis in zip(shape, own, strict=True)]
        )
    return out


def two_fields(rng, shape, sd):
    """Interlaced frames: each field a cube of its own, at a level of its own."""
    out = np.empty((shape[0], 2 * shape[1], shape[2]))
    out[:, 0::2], out[:, 1::2] = cube(rng, shape, sd), 7.0 + cube(rng, shape, sd)
    return out


def of(frames, *, interlaced=False):
    return components.components(
        contrasts(FrameStack(data=np.asarray(frames, np.float32)), interlaced=interlaced)
    )


def trials(rng, make, sd, *, interlaced=False):
    """Estimates, shape (cube, component), and how many 95 % intervals hold the truth, shape
    (component,).
    """
    found, held = np.empty((CUBES, 7)), np.zeros(7, int)
    for trial in range(CUBES):
        parts = of(make(rng), interlaced=interlaced)
        for i, name in enumerate(NAMES):
            low, high = np.quantile(np.maximum(parts[name].draws(rng, 2000), 0.0), [0.025, 0.975])
            found[trial, i] = parts[name].variance_dn2
            held[i] += low <= sd[i] ** 2 <= high
    return found, held


def pulls(found, sd):
    """Mean error of the variances in standard errors, shape (component,)."""
    return (found.mean(axis=0) - np.square(sd)) / (found.std(axis=0, ddof=1) / np.sqrt(len(found)))


def measured(in_memory, frames, *, context=QUICK, **stamps):
    """The seven measurements of one flat, by name."""
    stack = FrameStack(data=frames, **stamps)
    result = noise.measure(
        in_memory([("flat", "flat", stack, Conditions())]), method="variance", context=context
    )
    return {name: result.find(f"noise_{name}", stack="flat")[0] for name in NAMES}


@pytest.mark.parametrize(
    ("shape", "sd"),
    [
        ((20, 32, 48), (0.8, 1.2, 1.0, 0.7, 0.5, 1.5, 2.0)),
        ((16, 40, 56), (0.2, 0.2, 0.3, 0.2, 0.2, 0.4, 2.0)),
    ],
)
def test_seven_components_at_once_are_unbiased_and_their_intervals_hold(seed, shape, sd):
    rng = np.random.default_rng(seed)
    found, held = trials(rng, lambda rng: cube(rng, shape, sd), sd)
    assert np.abs(pulls(found, sd)).max() < 3.5
    assert held.min() >= LEAST_HELD


def test_a_component_that_is_not_there_is_estimated_as_often_below_zero_as_above(seed):
    """Nothing is cut at zero before it is averaged, and the upper bound holds."""
    sd = (0.0, 0.5, 0.5, 0.0, 0.0, 0.0, 2.0)
    found, held = trials(np.random.default_rng(seed), lambda rng: cube(rng, (12, 32, 40), sd), sd)
    assert np.abs(pulls(found, sd)).max() < 3.5
    assert held.min() >= LEAST_HELD
    below = (found[:, [0, 3, 4, 5]] < 0).sum(axis=0)
    # Estimates of nothing are skewed: a little more than half of them lie below zero.
    assert 0.2 * CUBES < below.min() <= below.max() < 0.87 * CUBES


def test_noise_shared_by_neighbours_is_no_noise_of_rows_or_columns(seed):
    """Blurred noise leaves more in the mean of a row than white noise: the plain analysis calls
    that row noise.
    """
    sd = (0.1, 0.2, 0.2, 0.0, 0.0, 0.2, 2.0)
    rng = np.random.default_rng(seed)
    found, held = trials(rng, lambda rng: cube(rng, (8, 72, 96), sd, blur_px=1.0), sd)
    assert held.min() >= LEAST_HELD
    plain = (3.54 - 1.0) * sd[6] ** 2 / np.array([96, 72])
    assert (np.abs(found[:, 3:5].mean(axis=0)) < 0.08 * plain).all()


@pytest.mark.parametrize(("frames", "lag"), [(16, 0.3), (16, 0.6), (64, 0.6), (12, 0.9)])
def test_noise_that_lasts_is_no_fixed_pattern_or_flagged(seed, frames, lag):
    rng = np.random.default_rng(seed)
    sd = (0.0, 0.2, 0.2, 0.0, 0.0, 0.3, 3.0)
    for _ in range(2):
        found = measured(session_of, cube(rng, (frames, 64, 80), sd, lag=lag).astype(np.float32))
        for name, truth in zip(NAMES, sd, strict=True):
            low, high = found[name].interval95
            outside = max(low - truth, truth - high, 0.0)
            assert "lag" in found[name].flags or outside <= 0.5 * (high - low), name
        assert ("lag" in found["vh"].flags) == (lag > 0.5 and frames < 64)


def test_fields_are_cubes_of_their_own(seed):
    sd = (0.5, 0.5, 0.5, 0.3, 0.3, 0.5, 2.0)
    rng = np.random.default_rng(seed)
    found, held = trials(rng, lambda rng: two_fields(rng, (10, 20, 40), sd), sd, interlaced=True)
    assert np.abs(pulls(found, sd)).max() < 3.5
    assert held.min() >= LEAST_HELD


def test_fields_that_were_not_taken_apart_are_seen(seed):
    rng = np.random.default_rng(seed)
    frames = two_fields(rng, (12, 32, 64), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)).astype(np.float32)
    assert "interlace-motion" in measured(session_of, frames)["v"].flags
    split = measured(session_of, frames, context=Context(seed=1, quick=True, interlaced=True))
    assert split["v"].status == "ok"
    frames[:, 0::2] += rng.standard_normal((12, 1, 1))
    assert "interlace-motion" in measured(session_of, frames)["tv"].flags


@pytest.mark.parametrize("kind", [np.uint16, np.float64])
def test_a_strong_fixed_pattern_leaves_what_changes_in_time_alone(seed, kind):
    """Shading ten thousand times the noise: single precision suffices because the first frame is
    taken off.
    """
    rng = np.random.default_rng(seed)
    still = np.rint(cube(rng, (13, 40, 48), (0.5, 0.0, 0.0, 0.5, 0.5, 0.0, 2.0)))
    shading = np.rint(
        20000.0 * np.outer(np.linspace(1, 2, 40) ** 2, np.linspace(1.0, 0.5, 48)) / 4.0
    )
    plain, shaded = (
        components.components(contrasts(FrameStack(data=frames.astype(kind)), interlaced=False))
        for frames in (still, still + shading)
    )
    for name in ("t", "tv", "th", "tvh"):
        assert shaded[name].variance_dn2 == pytest.approx(
            plain[name].variance_dn2, rel=1e-3, abs=1e-4
        )


def test_smooth_shading_is_neither_row_nor_column_noise(seed):
    rng = np.random.default_rng(seed)
    sd = (0.2, 0.5, 0.5, 0.2, 0.2, 0.5, 2.0)
    row, col = np.linspace(-1, 1, 96)[:, None], np.linspace(-1, 1, 128)
    shading = 300.0 * (1.0 - 0.2 * (row**2 + col**2) + 0.02 * (row**2 + col**2) ** 2 + 0.1 * row)
    found = measured(session_of, (cube(rng, (16, 96, 128), sd) + shading).astype(np.float32))
    for name, truth in zip(NAMES, sd, strict=True):
        low, high = found[name].interval95
        assert found[name].status == "ok"
        assert max(low - truth, truth - high) < 0.5 * (high - low), name


def test_memory_does_not_grow_to_a_second_cube(seed):
    frames = np.random.default_rng(seed).integers(0, 4000, (256, 64, 96), dtype=np.uint16)
    stack = FrameStack(data=frames)
    tracemalloc.start()
    components.components(contrasts(stack, interlaced=False))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 0.7 * frames.size * 8


def test_drift_and_flicker_are_named(seed):
    rng = np.random.default_rng(seed)
    steady = cube(rng, (64, 32, 48), (0.2, 0.2, 0.2, 0.2, 0.2, 0.2, 2.0)).astype(np.float32)
    frame = np.arange(64, dtype=np.float32)[:, None, None]
    assert measured(session_of, steady)["t"].status == "ok"
    assert measured(session_of, steady + 0.05 * frame)["t"].flags == ("drift",)
    flicker = 2.0 * np.sin(2 * np.pi * 7.0 * frame / 25.0)
    found = measured(session_of, steady + flicker, time_s=np.arange(64) / 25.0)["t"]
    assert found.flags == ("flicker",)
    assert "7.0" in " ".join(found.notes)
    assert abs(found.value - np.hypot(2.0 / np.sqrt(2.0), 0.2)) < 0.1


def test_what_is_not_seen_is_reported_with_its_limit(seed):
    """A negative estimate is no number below its interval: it is none, with what may still be
    there.
    """
    rng = np.random.default_rng(seed)
    notes = []
    for _ in range(6):
        found = measured(session_of, cube(rng, (8, 32, 40), (0.0,) * 6 + (2.0,)).astype(np.float32))
        for name in NAMES[:6]:
            m = found[name]
            (low95, high95), (low68, high68) = m.interval95, m.interval68
            assert 0 <= low95 <= low68 <= m.value <= high68 <= high95
            assert high95 > 0
            if low95 == 0:
                notes.append(" ".join(m.notes))
    assert len(notes) > 24
    assert all("detected" in note and "at most" in note for note in notes)


def test_cut_and_coarse_codes_are_named_and_the_truth_is_in_the_interval(seed):
    rng = np.random.default_rng(seed)
    frames = cube(rng, (16, 48, 64), (0.0,) * 6 + (4.0,)) - 1000.0
    cut = measured(session_of, np.clip(np.rint(frames + 6.0), 0, None).astype(np.uint16))
    assert all(any(note.startswith("clipped: ") for note in m.notes) for m in cut.values())
    coarse = measured(session_of, np.rint(frames / 12.0 + 50.0).astype(np.uint16))
    assert all("quantised" in m.flags for name, m in coarse.items() if name != "tvh")
    for found, truth_dn in ((cut["tvh"], 4.0), (coarse["tvh"], np.hypot(4.0 / 12.0, 12**-0.5))):
        low, high = found.interval95
        assert found.status == "ok" and low < truth_dn < high


@pytest.mark.parametrize("method", ["variance", "covariance-sum"])
def test_every_long_stack_has_its_seven_and_short_ones_say_why_not(seed, method):
    camera = Pulses(gain_dn=0.0, electron_gain_dn=0.5, shape=(96, 128))
    session = flat_series(
        camera, np.random.default_rng(seed), (200.0, 800.0), frames=8, dark_frames=4
    )
    result = noise.measure(session, method=method, context=QUICK)
    for name in NAMES:
        assert [m.stack for m in result.find(f"noise_{name}")] == ["flat-0", "flat-1"]
    first, second = result.find("noise_tvh")
    low, high = second.interval68
    assert abs(second.value - np.sqrt(0.5**2 * 800.0 + 2.0**2 + 1 / 12)) < 4.5 * 0.5 * (high - low)
    assert first.unit == "DN"
    short = noise.measure(
        flat_series(camera, np.random.default_rng(seed), (200.0,), frames=4, dark_frames=4),
        method=method,
        context=QUICK,
    )
    assert [m.status for name in NAMES for m in short.find(f"noise_{name}")] == ["refused"] * 7


def test_rare_pulses_make_the_random_noise_less_certain_than_normal_noise_would(seed):
    """One photoelectron in fifty pixels, exponential pulse heights: the fourth moment is far from
    the normal law's.
    """
    camera, rng = Pulses(gain_dn=20.0, shape=(64, 80)), np.random.default_rng(seed)
    variance = (
        0.02 * 2.0 * camera.gain_dn**2
        + 0.05 * 0.02 * camera.gain_dn
        + camera.read_noise_dn**2
        + 1 / 12
    )
    held, narrow = 0, 0
    for _ in range(30):
        part = of(camera.frames(rng, 0.02, 12).data)["tvh"]
        low, high = np.quantile(part.draws(rng, 2000), [0.025, 0.975])
        held += low <= variance <= high
        narrow += abs(part.variance_dn2 - variance) < 1.96 * variance * np.sqrt(
            2.0 / (11 * 63 * 79)
        )
    # 95 % of 30, less four standard errors.
    assert held >= 24 > 21 > narrow
