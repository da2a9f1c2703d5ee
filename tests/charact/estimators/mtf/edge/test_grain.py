"""The noise along an edge: its correlation against sums done plainly, its variances, and the codes
that pile up.
"""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.signal import correlate

from charact.estimators.mtf.edge.pixels.noise_model import MAX_LAG_PX, correlation_of
from charact.frames.clipping import is_clipped
from charact.frames.noise_law import fit_noise_law


@pytest.fixture
def rng(seed) -> np.random.Generator:
    return np.random.default_rng([seed, 23])


@pytest.mark.parametrize("sigma", [0.0, 0.6, 1.2])
def test_noise_blurred_behind_the_gain_has_the_correlation_of_its_blur(rng, sigma):
    """That of the kernel with itself: within four errors at near lags, its sum within 15 % (mean of
    16 fields).
    """
    lag = np.arange(-MAX_LAG_PX, MAX_LAG_PX + 1)
    square = np.add.outer(lag**2, lag**2)
    kernel = gaussian_filter((square == 0) * 1.0, sigma)
    truth = correlate(kernel, kernel, "same") / np.sum(kernel**2)
    fields = [
        correlate(
            rng.standard_normal((160 + 2 * MAX_LAG_PX, 160 + 2 * MAX_LAG_PX)), kernel, "valid"
        )
        for _ in range(16)
    ]
    used = np.ones(fields[0].shape, bool)
    found = np.mean(
        [correlation_of(noise / noise.std(), used, (1.0, 0.1)) for noise in fields], axis=0
    )
    error = np.sqrt(np.sum(truth**2)) / 160.0 / np.sqrt(len(fields))
    near = square <= 9
    assert found[near] == pytest.approx(truth[near], abs=4.0 * error + 0.025)
    assert found.sum() == pytest.approx(truth.sum(), rel=0.15)


@pytest.mark.parametrize(("sigma", "share"), [(0.5, 0.8), (0.9, 0.8)])
def test_no_picture_s_noise_is_far_from_that_of_its_fellows(rng, sigma, share):
    """Sums of the correlation of 250 pictures of one noise, the bins' means taken off as profiles
    take them off.

    None is 8 deviations, told by the quartiles, from the middle: a lag that stood out by chance
    moves a sum by 6 in one picture of 1,500, a fit that ends beside its peak by 10 and more in one
    of 50.
    """
    place = np.add.outer(0.03 * np.arange(120), np.arange(110))
    bins = np.rint(4.0 * place).astype(int)
    count = np.maximum(np.bincount(bins.ravel()), 1)
    used, sums = np.ones(place.shape, bool), []
    for _ in range(250):
        noise = gaussian_filter(rng.standard_normal(place.shape), sigma, mode="wrap")
        noise = np.sqrt(share) * noise / noise.std() + np.sqrt(1.0 - share) * rng.standard_normal(
            place.shape
        )
        noise -= (np.bincount(bins.ravel(), noise.ravel()) / count)[bins]
        sums.append(correlation_of(noise / noise.std(), used, (1.0, 0.03)).sum())
    low, middle, high = np.quantile(np.log(sums), [0.25, 0.5, 0.75])
    away = (np.log(sums) - middle) / ((high - low) / 1.349)
    assert np.abs(away).max() < 8.0


def test_no_chance_takes_noise_away_at_any_frequency(rng):
    """The power of noise blurred by 0.9 px and a tenth white, estimated in 300 pictures: 0.1 at
    least.

    A lag of 0.1 that stands out by chance would leave less than nothing at some frequency, as in
    one picture of ten.
    """
    used, least = np.ones((79, 85), bool), []
    for _ in range(300):
        noise = gaussian_filter(rng.standard_normal(used.shape), 0.9, mode="wrap")
        noise = np.sqrt(0.9) * noise / noise.std() + np.sqrt(0.1) * rng.standard_normal(used.shape)
        found = correlation_of(noise / noise.std(), used, (1.0, 0.1))
        beyond = (64 - found.shape[0]) // 2
        whole = np.pad(found, (beyond + 1, beyond))
        least.append(np.fft.fft2(np.fft.ifftshift(whole)).real.min())
    assert min(least) > 0.0


def variances(residual, level, used):
    return fit_noise_law(level[used], residual[used] ** 2, 1.0, 1e-6).variance(np.array([0.0, 1.0]))


def test_variances_of_both_sides_are_those_of_the_noise(rng):
    level = np.repeat([0.0, 1.0], 80) * np.ones((150, 1))
    residual = rng.standard_normal(level.shape) * np.where(level > 0, 3.0, 1.0)
    used = rng.random(level.shape) < 0.8
    dark, bright = variances(residual, level, used)
    count = used.sum() / 2
    assert dark == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / count))
    assert bright == pytest.approx(9.0, abs=36.0 * np.sqrt(2.0 / count))


def test_one_wild_pixel_hardly_moves_the_variances(rng):
    level = np.repeat([0.0, 1.0], 80) * np.ones((150, 1))
    residual = rng.standard_normal(level.shape)
    used = np.ones(level.shape, bool)
    before = variances(residual, level, used)
    residual[3, 4] = 300.0
    assert variances(residual, level, used) == pytest.approx(before, rel=0.06)


@pytest.mark.parametrize("kind", [np.uint16, np.float64])
@pytest.mark.parametrize("ceiling", [np.inf, 130.0, 110.0, 101.0])
def test_frames_clipped_a_little_and_much_are_told(rng, kind, ceiling):
    data = np.minimum(np.rint(rng.normal(100.0, 12.0, (1, 60, 60))), ceiling).astype(kind)
    assert is_clipped(data, min(ceiling, 4095.0)) == np.isfinite(ceiling)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("lag", [0.0, 0.3])
def test_fields_exposed_apart_share_what_lingers(rng, axis, lag):
    """Two exposures of blurred noise on alternate lines, one with a share of the other:
    correlations as drawn.
    """
    lags, sigma = np.arange(-MAX_LAG_PX, MAX_LAG_PX + 1), 0.8
    kernel = gaussian_filter((np.add.outer(lags**2, lags**2) == 0) * 1.0, sigma)
    truth = correlate(kernel, kernel, "same") / np.sum(kernel**2)
    one, fresh = (correlate(rng.standard_normal((228, 228)), kernel, "valid") for _ in range(2))
    other = lag * one + np.sqrt(1.0 - lag**2) * fresh
    lines = np.arange(200).reshape((-1, 1) if axis == 0 else (1, -1)) % 2 == 1
    noise = np.where(lines, other, one)
    found = correlation_of(noise / noise.std(), np.ones(noise.shape, bool), (1.0, 0.1), axis)
    between = np.broadcast_to((lags[:, None] if axis == 0 else lags) % 2 == 1, truth.shape)
    truth = np.where(between, lag * truth, truth)
    near = np.ix_(np.abs(lags) <= 3, np.abs(lags) <= 3)
    error = np.sqrt(np.sum(truth**2)) / 200.0
    assert found[near] == pytest.approx(truth[near], abs=4.0 * error)
    assert found.sum() == pytest.approx(truth.sum(), rel=0.15)
    assert found.sum() != pytest.approx(
        correlation_of(noise / noise.std(), lines | True, (1.0, 0.1)).sum(), rel=0.01
    )
