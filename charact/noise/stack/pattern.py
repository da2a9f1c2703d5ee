"""The fixed pattern: what unequal pixels add to every exposure alike, told from noise that is shared for a while."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.noise.stack.exposure_order import Order
from charact.noise.stack.pixels import PixelSums

Array = NDArray[np.float64]

# Near pairs that share more than far ones, beyond so many standard errors and this share of all, still share noise.
SIGNIFICANT = 3.0
SHARE = 0.02
# What may be left of it beyond the last pairs, share of the variance; it is in the standard error too.
LEFT = 0.1


@dataclass(frozen=True, kw_only=True)
class Pattern:
    """Variance over the image of what does not change in time.

    Parameters
    ----------
    variance_dn2, sd_dn2
        The variance and its standard error, DN^2.
    settled
        Whether pairs of exposures further apart share no less: where they do, noise that fades passes for pattern.
    """

    variance_dn2: float
    sd_dn2: float
    settled: bool


def measure_fixed_pattern(order: Order, sums: PixelSums, least: int) -> Pattern:
    """Return the variance over the image of what does not change in time.

    Parameters
    ----------
    order
        Order of the exposures.
    sums
        Products of their pixels.
    least
        Exposures nearer in time than this are never compared.

    Notes
    -----
    The mean covariance over the image of two exposures of the same rows: their temporal noise is not alike, so none
    of it has to be known and subtracted. Light that lags is alike in exposures near in time. The distance is doubled
    until pairs further apart share no less.
    """
    parts = [_field_pattern(order, sums, int(parity), least) for parity in np.unique(order.parity)]
    return Pattern(
        variance_dn2=float(np.mean([part.variance_dn2 for part in parts])),
        sd_dn2=float(np.sqrt(np.sum([part.sd_dn2**2 for part in parts])) / len(parts)),
        settled=all(part.settled for part in parts),
    )


def _field_pattern(order: Order, sums: PixelSums, parity: int, least: int) -> Pattern:
    """The pattern of the exposures of the same rows."""
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
            return Pattern(variance_dn2=found, sd_dn2=float(np.hypot(sd, rest)), settled=rest <= LEFT * abs(found))
        beside = (distance >= apart) & ~further
        if not beside.any():
            apart *= 2
            continue
        near, near_sd = _mean(products, beside, spread)
        far, far_sd = _mean(products, further, spread)
        noise = float(np.hypot(near_sd, far_sd))
        alike = near - far <= SIGNIFICANT * noise + 0.5 * SHARE * abs(far)
        # What near pairs may still share is part of the error, as much as they are of all pairs.
        unseen = (max(near - far, 0.0) + noise) * float(beside.sum() / (distance >= apart).sum())
        if alike and apart >= least and (not any(excess) or unseen <= LEFT * abs(found)):
            return Pattern(variance_dn2=found, sd_dn2=float(np.hypot(sd, unseen)), settled=True)
        excess.append(0.0 if alike and not any(excess) else max(near - far, noise))
        apart *= 2


def _remaining_correlation(excess: list[float]) -> float:
    """What is still shared beyond the last distance, if the excess goes on falling by the ratio of the last two."""
    before, last = ([np.nan, *excess])[-2:]
    if last <= 0:
        return 0.0
    return float(last**2 / before) if before > last else np.inf


def _mean(products: Array, chosen: NDArray[np.bool_], spread: tuple[float, float]) -> tuple[float, float]:
    """Mean product over the chosen pairs and its standard error, for noise of the spread given."""
    weight = chosen / chosen.sum()
    common = float((weight * products).sum())
    noise = products - common
    both = weight @ noise
    twice, crossed = spread
    square = 2.0 * max(float(np.trace(both @ both)), 0.0) * twice
    square += 4.0 * max(common, 0.0) * max(float((both @ weight).sum()), 0.0) * crossed
    return common, float(np.sqrt(square))


def _spread(sums: PixelSums, parity: int) -> tuple[float, float]:
    """One over the number of independent pixels: for noise with noise, and for noise with the pattern.

    The middle of the image speaks for all of it; what its mean image lacks of the whole one's variance is shading,
    and lies at the lowest frequencies.
    """
    middle, pixels = sums.middle[parity], sums.size[0] * sums.size[1]
    noise, mean = np.mean([_power(image) for image in middle], axis=0), _power(sums.mean_middle[parity])
    level = float(noise.mean())
    if level <= 0:
        return 0.0, 0.0
    # The square of a mean over m exponential powers is too large by 1 + 1/m.
    twice = float(np.mean(noise**2)) / level**2 / (1.0 + 1.0 / len(middle))
    lowest = np.delete(
        noise[np.ix_(*([0, min(1, n - 1), -1][:most] for n, most in zip(noise.shape, (3, 2), strict=True)))], 0
    )
    own = float(mean.mean()) / middle[0].size
    shading = max(sums.mean_square[parity] - own, 0.0)
    alike = own * float(np.mean(mean * noise)) / max(float(mean.mean()), 1e-30) + shading * float(lowest.mean())
    return twice / pixels, alike / max((own + shading) * level, 1e-30) / pixels


def _power(image: NDArray[np.float32]) -> Array:
    """Power of every mode of an image but its mean, half of the plane."""
    from scipy import fft

    modes = np.asarray(fft.rfft2(image, workers=1), np.complex64)
    power = modes.real.astype(np.float64) ** 2 + modes.imag.astype(np.float64) ** 2
    power[0, 0] = 0.0
    return power
