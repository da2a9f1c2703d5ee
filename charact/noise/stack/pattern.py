"""Fixed-pattern noise, separated from slowly varying noise."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.noise.stack.exposure_order import Order
from charact.noise.stack.pixels import PixelSums
from charact.noise.thresholds import STACK

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Pattern:
    """Spatial variance of the fixed pattern.

    Parameters
    ----------
    variance_dn2, sd_dn2
        The variance and its standard error, DN^2.
    settled
        Whether the covariance is independent of the separation of exposures; if not, slow noise counts as pattern.
    """

    variance_dn2: float
    sd_dn2: float
    settled: bool


def measure_fixed_pattern(order: Order, sums: PixelSums, least: int) -> Pattern:
    """Return the spatial variance of the fixed pattern.

    Parameters
    ----------
    order
        Order of the exposures.
    sums
        Products of their pixels.
    least
        Smallest separation of compared exposures.

    Notes
    -----
    The estimate is the mean covariance over the image of two exposures of the same rows, whose temporal noise is
    independent. Image lag correlates exposures near in time, so the separation is doubled until the covariance no
    longer falls.
    """
    parts = [_field_pattern(order, sums, int(parity), least) for parity in np.unique(order.parity)]
    return Pattern(
        variance_dn2=float(np.mean([part.variance_dn2 for part in parts])),
        sd_dn2=float(np.sqrt(np.sum([part.sd_dn2**2 for part in parts])) / len(parts)),
        settled=all(part.settled for part in parts),
    )


def _field_pattern(order: Order, sums: PixelSums, parity: int, least: int) -> Pattern:
    """Return the pattern of the exposures of one parity."""
    same = np.flatnonzero(order.parity == parity)
    cross = sums.with_mean[same]
    products = sums.mean_square[parity] + cross[:, None] + cross + sums.products[np.ix_(same, same)]
    distance = np.abs(order.time[same][:, None] - order.time[same])
    spread = _spread(sums, parity)
    apart, excess = int(distance[distance > 0].min()), [0.0]
    while True:
        found, sd = _mean(products, distance >= apart, spread)
        further = distance >= 2 * apart
        if not further.any():
            rest = _remaining_correlation(excess)
            return Pattern(
                variance_dn2=found, sd_dn2=float(np.hypot(sd, rest)), settled=rest <= STACK.max_slow_noise * abs(found)
            )
        beside = (distance >= apart) & ~further
        if not beside.any():
            apart *= 2
            continue
        near, near_sd = _mean(products, beside, spread)
        far, far_sd = _mean(products, further, spread)
        noise = float(np.hypot(near_sd, far_sd))
        alike = near - far <= STACK.slow_noise_sd * noise + 0.5 * STACK.slow_noise_fraction * abs(far)
        # A possible excess of near pairs adds to the error in proportion to their number.
        unseen = (max(near - far, 0.0) + noise) * float(beside.sum() / (distance >= apart).sum())
        if alike and apart >= least and (not any(excess) or unseen <= STACK.max_slow_noise * abs(found)):
            return Pattern(variance_dn2=found, sd_dn2=float(np.hypot(sd, unseen)), settled=True)
        excess.append(0.0 if alike and not any(excess) else max(near - far, noise))
        apart *= 2


def _remaining_correlation(excess: list[float]) -> float:
    """Return the excess beyond the last separation, extrapolated by the ratio of the last two."""
    before, last = ([np.nan, *excess])[-2:]
    if last <= 0:
        return 0.0
    return float(last**2 / before) if before > last else np.inf


def _mean(products: Array, chosen: NDArray[np.bool_], spread: tuple[float, float]) -> tuple[float, float]:
    """Return the mean product over the chosen pairs and its standard error, for noise of the given spread."""
    weight = chosen / chosen.sum()
    common = float((weight * products).sum())
    noise = products - common
    both = weight @ noise
    twice, crossed = spread
    square = 2.0 * max(float(np.trace(both @ both)), 0.0) * twice
    square += 4.0 * max(common, 0.0) * max(float((both @ weight).sum()), 0.0) * crossed
    return common, float(np.sqrt(square))


def _spread(sums: PixelSums, parity: int) -> tuple[float, float]:
    """Return the inverse number of independent pixels, for noise with noise and for noise with the pattern.

    The image centre represents the image; variance missing from its mean image is shading at the lowest frequencies.
    """
    middle, pixels = sums.middle[parity], sums.size[0] * sums.size[1]
    noise, mean = np.mean([_power(image) for image in middle], axis=0), _power(sums.mean_middle[parity])
    level = float(noise.mean())
    if level <= 0:
        return 0.0, 0.0
    # The mean square of a mean of m exponential powers is biased by 1 + 1/m.
    twice = float(np.mean(noise**2)) / level**2 / (1.0 + 1.0 / len(middle))
    lowest = np.delete(
        noise[np.ix_(*([0, min(1, n - 1), -1][:most] for n, most in zip(noise.shape, (3, 2), strict=True)))], 0
    )
    own = float(mean.mean()) / middle[0].size
    shading = max(sums.mean_square[parity] - own, 0.0)
    alike = own * float(np.mean(mean * noise)) / max(float(mean.mean()), 1e-30) + shading * float(lowest.mean())
    return twice / pixels, alike / max((own + shading) * level, 1e-30) / pixels


def _power(image: NDArray[np.float32]) -> Array:
    """Return the power of every mode of an image except its mean, half plane."""
    from scipy import fft

    modes = np.asarray(fft.rfft2(image, workers=1), np.complex64)
    power = modes.real.astype(np.float64) ** 2 + modes.imag.astype(np.float64) ** 2
    power[0, 0] = 0.0
    return power
