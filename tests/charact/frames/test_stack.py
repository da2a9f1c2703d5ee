"""A stack: clipping, rounding, lag and the law of its noise, each computed once."""

import numpy as np
import pytest

from charact.estimators.mtf.point.parametric_noise import dark_sd_from_histogram
from charact.estimators.mtf.point.thresholds import ACCURACY as POINT_ACCURACY
from charact.frames import CLIPPING, NoiseLaw, Stack, image_lag_model, is_clipped, rounding_shifts
from labdata import FrameStack, load_sensor
from labdata.errors import BadInput
from tests.truth import EdgeScene, TrueBlur

# What a stack of frames holds, whatever its number of frames.


TOP_DN = 4095


def star(frames: int, rng: np.random.Generator, *, peak_dn: float) -> Stack:
    """Frames of a Gaussian source of 1.2 px with photon noise, cut off at 12 bits."""
    row, col = np.mgrid[:48, :48]
    light = 100.0 + peak_dn * np.exp(-((row - 23.6) ** 2 + (col - 24.2) ** 2) / 2.88)
    drawn = rng.poisson(light, (frames, 48, 48))
    return Stack(frames=FrameStack(data=np.minimum(drawn, TOP_DN).astype(np.uint16)))


@pytest.mark.parametrize("frames", [1, 2, 4])
def test_the_ceiling_of_a_clipped_star_does_not_depend_on_the_number_of_frames(frames, seed):
    rng = np.random.default_rng(seed)
    assert star(frames, rng, peak_dn=5500.0).ceiling_dn == TOP_DN
    assert star(frames, rng, peak_dn=3000.0).ceiling_dn is None


def test_single_pixels_at_the_highest_code_are_no_plateau(seed):
    data = np.random.default_rng(seed).integers(90, 110, (3, 48, 48)).astype(np.uint16)
    data[0, 10, 10] = data[1, 30, 20] = data[2, 10, 12] = TOP_DN
    assert Stack(frames=FrameStack(data=data)).ceiling_dn is None
    data[2, 10, 11] = TOP_DN
    assert Stack(frames=FrameStack(data=data)).ceiling_dn == TOP_DN


def test_a_stated_full_scale_precedes_what_the_file_says_and_that_what_the_frames_show():
    data = np.full((1, 8, 8), TOP_DN, np.uint16)
    of_file = FrameStack(data=data, full_scale_dn=16383.0)
    assert Stack(frames=FrameStack(data=data)).ceiling_dn == TOP_DN
    assert Stack(frames=of_file).ceiling_dn == 16383.0
    assert Stack(frames=of_file, stated_full_scale_dn=65535.0).ceiling_dn == 65535.0


def test_the_top_of_unclipped_frames_is_their_highest_value(seed):
    stack = star(2, np.random.default_rng(seed), peak_dn=3000.0)
    assert stack.top_dn == stack.data.max()
    assert stack.often_full().sum() == 1
    assert not stack.is_clipped()


# Pixels that pile up at a code: told at any code where noise is cut off, not where a plateau is
# still.


EDGE = EdgeScene(dark_dn=60.3, bright_dn=210.3, frames=4, shot_share=0.5)


def edge(noise_dn, **knobs):
    scene = {**vars(EDGE), "snr": 150.0 / noise_dn, **knobs}
    return EdgeScene(**scene)


@pytest.mark.parametrize("frames", [1, 4])
@pytest.mark.parametrize("over_sd", [-0.7, 0.0, 1.0])
@pytest.mark.parametrize("noise_dn", [3.0, 8.0])
def test_noise_cut_off_at_any_code_is_clipped(frames, over_sd, noise_dn, seed):
    """The lowest code from 0.7 deviations below the dark side to one above it; only 0 and 16 were
    looked at.
    """
    scene = edge(noise_dn, frames=frames, floor_dn=float(round(60.3 + over_sd * noise_dn)))
    assert is_clipped(scene.frames_drawn(np.random.default_rng(seed)).data, 255.0)


@pytest.mark.parametrize("frames", [1, 4])
def test_a_bright_side_cut_off_is_clipped_too(frames, seed):
    data = edge(6.0, frames=frames).frames_drawn(np.random.default_rng(seed)).data
    assert is_clipped(np.minimum(data, 210), 255.0)


@pytest.mark.parametrize("frames", [1, 8])
@pytest.mark.parametrize("noise_dn", [0.1, 0.3, 0.6, 1.0, 3.0])
@pytest.mark.parametrize("size", [16, 70])
def test_quiet_plateaus_are_not(frames, noise_dn, size, seed):
    """Sharp, with a halo and with a tube's tail; noise from a tenth of a code to three."""
    blurs = (
        TrueBlur(sigma_px=0.3),
        TrueBlur(halo_share=0.2, halo_px=30.0),
        TrueBlur(form="exponential", frequency_cy_per_px=0.2),
    )
    for blur in blurs:
        scene = edge(noise_dn, frames=frames, rows=size, cols=size, blur=blur)
        assert not is_clipped(scene.frames_drawn(np.random.default_rng(seed)).data, 255.0)


# How long a screen remembers: what sums and pixels of frames are worth, against pulses drawn one
# moment at a time.


SHEET = load_sensor("pulnix-ag5745ef3")
FRAMES, MOMENTS, WARM_UP, SERIES = 12, 10, 30, 4000


@pytest.fixture(scope="module")
def fields(seed):
    """Light of even and odd fields, shape (series, frame, 2): white arrivals, each fading by two
    exponentials.
    """
    rng, phosphor = np.random.default_rng([seed, 61]), SHEET.phosphor
    period_ms = 1e3 / float(SHEET.video.field_rate_hz)
    end = np.arange(1, WARM_UP + 1)[:, None] * period_ms
    since = end - (np.arange(MOMENTS) + 0.5) / MOMENTS * period_ms
    fast, tau = (
        float(phosphor.fast_fraction),
        (float(phosphor.fast_decay_ms), float(phosphor.slow_decay_ms)),
    )
    weight = np.array([fast * tau[0], (1.0 - fast) * tau[1]])
    left = (
        weight[0] * np.exp(-since / tau[0]) + weight[1] * np.exp(-since / tau[1])
    ) / weight.sum()
    shares = -np.diff(left, axis=0, prepend=1.0)
    count = 2 * FRAMES
    arrivals = rng.standard_normal((SERIES, count + WARM_UP - 1, MOMENTS))
    light = sum(
        arrivals[:, WARM_UP - 1 - k : WARM_UP - 1 - k + count] @ shares[k] for k in range(WARM_UP)
    )
    return light.reshape(SERIES, FRAMES, 2)


def worth(series):
    """Variance of the mean of frames over that of as many fresh ones with the scatter seen."""
    return series.mean(axis=1).var() / (series.var(axis=1, ddof=1).mean() / FRAMES)


def test_sums_of_both_fields_and_pixels_of_one_are_widened_as_the_screen_says(fields):
    """Within four standard errors of the ratio of two variances, root of 2/4000 and little more."""
    memory = image_lag_model(SHEET, FRAMES, interlaced=True)
    assert worth(fields[:, :, 0]) == pytest.approx(memory.widening, rel=4.0 * 0.025)
    assert worth(fields.sum(axis=2)) == pytest.approx(memory.widening_of_sums, rel=4.0 * 0.025)
    assert memory.widening_of_sums > 1.2 * memory.widening


def test_a_camera_without_a_screen_remembers_nothing():
    memory = image_lag_model(None, FRAMES, interlaced=False)
    assert memory.widening == memory.widening_of_sums == pytest.approx(1.0)


def test_rows_of_one_exposure_share_their_pulses_whatever_their_parity():
    """Without fields the row above is of the same exposure: what two of its pixels share is what
    pixels of a row do.
    """
    for sensor in (None, SHEET):
        memory = image_lag_model(sensor, FRAMES, interlaced=False)
        assert (memory.mean_other, memory.frame_other) == (memory.mean_same, memory.frame_same)


# One law of noise against signal.


LAW = NoiseLaw(gain_dn=2.0, read_dn=3.0, bend=-1e-4, pattern=4e-4)


def test_variance_is_read_shot_bend_and_pattern():
    signal = np.array([-5.0, 0.0, 10.0, 1e3])
    shot = np.maximum(signal, 0.0)
    assert LAW.sd(signal) ** 2 == pytest.approx(9.0 + 2.0 * shot - 1e-4 * shot**2)
    assert LAW.sd(signal, pattern=True) ** 2 == pytest.approx(9.0 + 2.0 * shot + 3e-4 * shot**2)


def test_the_signal_at_an_snr_has_that_snr_where_the_pattern_allows_it():
    signal = LAW.signal_at(5.0)
    assert signal / LAW.sd(signal, pattern=True) == pytest.approx(5.0)
    assert LAW.signal_at(1.0 / np.sqrt(3e-4)) == np.inf


def test_draws_of_a_law_have_their_own_noise_at_every_signal():
    draws = NoiseLaw(gain_dn=np.array([[1.0], [4.0]]), read_dn=np.array([[0.0], [2.0]]))
    assert draws.sd(np.array([4.0, 9.0, 16.0])).shape == (2, 3)
    assert draws.sd(4.0)[:, 0] == pytest.approx([2.0, np.sqrt(20.0)])
    assert draws.signal_at(2.0)[0, 0] == pytest.approx(4.0)


def test_power_scales_with_the_law():
    assert LAW.scaled(0.25).sd(0.0) == pytest.approx(1.5)
    with pytest.raises(BadInput, match="read_dn of a noise law must not be negative, got -1"):
        NoiseLaw(gain_dn=1.0, read_dn=-1.0)


# What rounding does to means, told from codes alone, is what rounding of drawn noise does.


@pytest.mark.parametrize("sd", [0.02, 0.2, 0.35])
def test_shifts_are_those_of_rounded_noise(sd: float, seed: int) -> None:
    """Means of a million draws lie no further off than the shifts say, beyond five of their
    standard errors.
    """
    rng = np.random.default_rng(seed)
    level = np.array([10.0, 10.2, 10.37, 10.8])
    drawn = np.rint(level + sd * rng.standard_normal((1_000_000, level.size)))
    shifts = rounding_shifts(level, np.full(level.size, 0.2))
    assert shifts.shape == (CLIPPING.rounding_offsets, level.size)
    true = drawn.mean(axis=0) - level
    error = 5.0 * drawn.std(axis=0) / 1000.0
    assert np.all(np.abs(true) <= np.abs(shifts).max(axis=0) + error)


def test_noise_that_hides_the_steps_leaves_no_shift() -> None:
    assert rounding_shifts(np.array([10.0, 10.3]), np.array([0.6, 2.0])).shape == (0, 2)


def test_shifts_of_all_places_cancel() -> None:
    """Where black lies between two codes is not known: on the average over all places nothing
    moves.

    Without noise the shift is even within half a code; six terms of its series hold 95 % of its
    size.
    """
    shifts = rounding_shifts(np.linspace(20.0, 23.0, 31), np.full(31, 0.1))
    np.testing.assert_allclose(shifts.mean(axis=0), 0.0, atol=1e-12)
    assert shifts.std() == pytest.approx(np.sqrt(1.0 / 12.0), rel=0.06)


@pytest.mark.parametrize("place", [-0.4, 0.0, 0.3])
@pytest.mark.parametrize("sd", [0.6, 1.0, 2.0])
def test_the_noise_of_quiet_pixels_is_told_beside_pulses_of_light(
    sd: float, place: float, seed: int
) -> None:
    """Pulses of several codes in one pixel of twenty hardly move it: within 8 % of 60,000
    values.
    """
    rng = np.random.default_rng(seed)
    values = 12.0 + place + sd * rng.standard_normal(60_000)
    values += np.where(rng.random(values.size) < 0.05, rng.gamma(2.0, 1.5, values.size), 0.0)
    found = dark_sd_from_histogram(np.rint(values).astype(np.uint8))
    assert found == pytest.approx(sd, rel=0.08)
    assert abs(float(np.rint(values).std()) / sd - 1.0) > 0.01


def test_noise_that_rounding_hides_is_taken_for_little() -> None:
    codes = np.full(10_000, 12, np.uint8)
    codes[:500] = 15
    assert dark_sd_from_histogram(codes) == POINT_ACCURACY.hidden_sd_dn
