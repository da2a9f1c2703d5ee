"""The noise along an edge: its correlation against sums done plainly, its variances, and the codes
that pile up.
"""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from charact.estimators.mtf.edge.pixels import noise_model


@pytest.fixture
def rng(seed) -> np.random.Generator:
    return np.random.default_rng([seed, 23])


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
        sums.append(noise_model.correlation_of(noise / noise.std(), used, (1.0, 0.03)).sum())
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
        found = noise_model.correlation_of(noise / noise.std(), used, (1.0, 0.1))
        beyond = (64 - found.shape[0]) // 2
        whole = np.pad(found, (beyond + 1, beyond))
        least.append(np.fft.fft2(np.fft.ifftshift(whole)).real.min())
    assert min(least) > 0.0
