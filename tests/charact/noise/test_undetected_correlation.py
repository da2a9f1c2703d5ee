"""What lowers a variance without showing in it is found, or is in the interval, or is said to be beyond the frames."""

import numpy as np
import pytest

from charact import noise
from charact.method import Context
from charact.noise.gain.undetected_correlation import UndetectedEffect, allowance_of
from charact.noise.stack.pixels import lower_neighbour, pixel_sums, right_neighbour, successor_correlation
from charact.noise.stack.spectrum import NO_BINS
from charact.noise.stack.temporal import order_of
from labdata.conditions import Conditions
from labdata.frames import FrameStack

QUICK = Context(seed=1, quick=True)
ELECTRONS = (400.0, 1500.0, 4000.0)
METHODS = ("covariance-sum", "variance")


def one(result, quantity, unit=None):
    return next(m for m in result.find(quantity) if unit in (None, m.unit))


def errors(measurement, truth) -> float:
    low, high = measurement.interval68
    return (measurement.value - truth) / (0.5 * (high - low))


@pytest.fixture
def ccd(pulses):
    """A camera without intensifier, K = 0.5 DN."""
    return lambda **more: pulses(gain_dn=0.0, electron_gain_dn=0.5, **more)


@pytest.mark.parametrize("smoothing_px", [0.3, 0.4, 0.7])
def test_a_little_smoothing_lowers_the_variance_and_is_seen(ccd, series, seed, smoothing_px):
    """At 0.3 px a neighbour holds 0.8 % of the noise, and the variance is 3 % low."""
    session = series(ccd(smoothing_px=smoothing_px), np.random.default_rng(seed), ELECTRONS)
    plain = one(noise.measure(session, method="variance", context=QUICK), "system_gain")
    assert plain.value < 0.98 * 0.5
    assert "correlated-noise" in plain.flags
    summed = noise.measure(session, method="covariance-sum", context=QUICK)
    # The gain of the standard is given as it is, with what it lacks and with the one that lacks nothing.
    assert "correlated-noise" in one(summed, "system_gain").flags
    assert one(summed, "system_gain").value < 0.98 * 0.5
    assert abs(errors(one(summed, "covariance_gain"), 0.5)) < 4.5


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("frames", [2, 3, 4, 8])
def test_a_camera_that_hides_nothing_is_not_accused(ccd, series, seed, method, frames):
    session = series(ccd(), np.random.default_rng(seed), (*ELECTRONS, 8000.0), frames=frames)
    gain = one(noise.measure(session, method=method, context=QUICK), "system_gain")
    assert gain.status == "ok"
    assert abs(errors(gain, 0.5)) < 4.5
    assert (gain.interval68[1] - gain.interval68[0]) / 2 < 0.04 * 0.5


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("share", "frames"), [(0.05, 8), (0.2, 4), (0.2, 3), (0.2, 2), (0.8, 2), (0.8, 16)])
def test_light_that_stays_in_the_next_frames_never_passes_unseen(pulses, keeping, series, seed, method, share, frames):
    session = series(pulses(memory=keeping(share)), np.random.default_rng(seed), (5.0, 15.0, 30.0), frames=frames)
    result = noise.measure(session, method=method, context=QUICK)
    gain = one(result, "system_gain")
    assert gain.status == "refused" or "lag" in gain.flags
    for found, truth in ((m, pulses().covariance_gain_dn) for m in result.find("covariance_gain")):
        assert found.status != "ok" or abs(errors(found, truth)) < 4.5


@pytest.mark.parametrize("method", METHODS)
def test_frames_that_come_twice_are_lag(ccd, series, in_memory, seed, method):
    session = series(ccd(), np.random.default_rng(seed), ELECTRONS, frames=4)
    twice = in_memory([
        (s.label, s.kind, FrameStack(data=np.repeat(s.read().data, 2, axis=0)), s.conditions) for s in session.stacks
    ])  # fmt: skip
    assert "lag" in one(noise.measure(twice, method=method, context=QUICK), "system_gain").flags


def test_what_a_handful_of_pixels_cannot_exclude_is_in_the_interval(ccd, series, seed):
    session = series(ccd(shape=(6, 8)), np.random.default_rng(seed), ELECTRONS)
    gain = one(noise.measure(session, method="variance", context=QUICK), "system_gain")
    assert gain.status == "ok" and gain.interval95[0] < 0.5 < gain.interval95[1]
    assert np.ptp(gain.interval95) > 0.1 * gain.value


@pytest.mark.parametrize("method", METHODS)
def test_a_bent_transfer_curve_is_said_to_be_bent(ccd, series, in_memory, seed, method):
    """A response 8 % low at the top bends the variance over the signal by 20 %."""
    session = series(ccd(bend_per_dn=2e-5), np.random.default_rng(seed), (1000.0, 3000.0, 5000.0, 8000.0))
    unknown = in_memory([(s.label, s.kind, s.read(), Conditions()) for s in session.stacks])
    gain = one(noise.measure(unknown, method=method, context=QUICK), "system_gain")
    assert gain.value < 0.95 * 0.5
    assert "nonlinear" in gain.flags


def test_codes_that_pile_up_are_the_end_of_the_range_though_nobody_told(ccd, series, in_memory, seed):
    """A camera of 12 bits in words of 16: the topmost level is cut at 4095."""
    camera = ccd(full_scale_dn=4095.0)
    session = series(camera, np.random.default_rng(seed), (1500.0, 3000.0, 5000.0, 7930.0), frames=6)
    untold = in_memory([(s.label, s.kind, FrameStack(data=s.read().data), s.conditions) for s in session.stacks])
    result = noise.measure(untold, method="variance", context=QUICK)
    assert result.evidence["photon-transfer"]["fitted"] == [True, True, True, False]
    assert abs(errors(one(result, "system_gain"), 0.5)) < 4.5


def sums_of(image):
    """Sums over the pixels of frames that follow one another."""
    order = order_of(np.arange(len(image)), interlaced=False)
    return pixel_sums(image, order, NO_BINS), order.parity


def test_independent_noise_has_neither_neighbours_nor_successors(seed):
    """All three statistics are unbiased however few frames the mean was taken from."""
    rng = np.random.default_rng(seed)
    for frames in (2, 3, 6):
        sums, parity = sums_of(rng.standard_normal((frames, 96, 128), dtype=np.float32))
        for value, sd in (right_neighbour(sums), lower_neighbour(sums)):
            assert abs(value) < 4.5 * sd
        value, sd = successor_correlation(sums, parity)
        assert (np.isinf(sd) and frames == 2) or abs(value) < 4.5 * sd


def test_successors_are_weighed_against_frames_further_apart(seed):
    """A moving mean of two frames: neighbours in time share half, others nothing."""
    rng = np.random.default_rng(seed)
    white = rng.standard_normal((13, 96, 128), dtype=np.float32)
    value, sd = successor_correlation(*sums_of((white[1:] + white[:-1]) / np.float32(np.sqrt(2.0))))
    # Centring lowers the variance by the mean covariance of all pairs, 11 of 66 sharing a half.
    assert abs(value - 0.5 / (1.0 - 0.5 * 11 / 66)) < 4.5 * sd


def test_sums_over_pixels_are_those_of_plain_arithmetic(seed):
    """Four frames of two fields, each at its own level over unequal pixels: every sum written out."""
    rng = np.random.default_rng(seed)
    rows, cols = 160, 440
    fixed = 50.0 * rng.standard_normal((2 * rows, cols))
    white = 9.0 * rng.standard_normal((4, 2 * rows, cols))
    # Neighbours in a row and in a column of a field share noise.
    noise_dn = white + 0.5 * np.roll(white, 1, axis=2) + 0.5 * np.roll(white, 2, axis=1)
    frames = (fixed + noise_dn + np.arange(4)[:, None, None]).astype(np.float32)
    sums = pixel_sums(frames, order_of(np.arange(4), interlaced=True), NO_BINS)
    image = np.stack([frames[:, 0::2], frames[:, 1::2]], axis=1).reshape(8, rows, cols).astype(float)
    parity = np.arange(8) % 2
    level = image - image.mean(axis=(1, 2), keepdims=True)
    mean = np.stack([level[parity == p].mean(axis=0) for p in (0, 1)])
    change = (level - mean[parity]) * np.sqrt(rows * cols / (rows * cols - 1))
    products = np.einsum("irc,jrc->ij", change, change) / (rows * cols) * (parity[:, None] == parity)
    assert sums.products == pytest.approx(products, rel=1e-5, abs=1e-4)
    assert sums.with_mean == pytest.approx(np.einsum("irc,irc->i", change, mean[parity]) / (rows * cols), abs=1e-3)
    assert sums.mean_square == pytest.approx((mean**2).mean(axis=(1, 2)), rel=1e-5)
    assert sums.mean_dn == pytest.approx(image.mean(axis=(1, 2)), rel=1e-5)
    for block, low, high in ((0, 0, int(rows / 6)), (40, int(rows * 5 / 6), rows)):
        inside = change[:, low:high, :55]
        beside_it, above_it = change[:, low:high, 1:56], change[:, max(low - 1, 0) : high - 1, :55]
        assert sums.power[block] == pytest.approx((inside**2).sum(axis=0).mean(), rel=1e-5)
        assert sums.right[block] == pytest.approx((inside * beside_it).sum(axis=0).mean(), rel=1e-4)
        products = (inside[:, inside.shape[1] - above_it.shape[1] :] * above_it).sum(axis=0).mean()
        assert sums.below[block] == pytest.approx(products, rel=1e-4)
        nearest = sum((inside[i] * inside[i + 2]).mean() for i in range(6))
        assert (sums.near[block], sums.pairs) == (pytest.approx(nearest, rel=1e-3), 6)
        assert sums.level[block] == pytest.approx(image[:, low:high, :55].mean(), rel=1e-4, abs=0.01)


def test_what_a_weak_test_cannot_exclude_is_in_the_interval():
    """A tube glows and blurs, a chip seldom shares anything: what may be there is allowed for in either."""
    none, weak, blind, some = (UndetectedEffect(share=share, sd=sd) for share, sd in
                               ((0.004, 0.002), (0.004, 0.02), (0.02, 0.05), (0.009, 0.002)))  # fmt: skip
    assert allowance_of(none, none, tube=True) == 0.0
    assert allowance_of(none, weak, tube=True) > 0.02
    assert allowance_of(none, none, tube=False) < 0.002
    assert allowance_of(none, weak, tube=False) < 0.008
    assert allowance_of(none, blind, tube=False) > 0.02
    assert allowance_of(some, none, tube=False) == pytest.approx(0.009, abs=0.001)
