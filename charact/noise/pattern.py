"""The fixed pattern: what unequal pixels add to every exposure alike, told from noise that is shared for a while."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.noise.fields import Exposures

Array = NDArray[np.float64]

# Exposures whose spectra tell how far the noise of pixels is independent.
SPECTRA = 8
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


def fixed_pattern(shots: Exposures, change: NDArray[np.float32], least: int) -> Pattern:
    """Return the variance over the image of what does not change in time.

    Parameters
    ----------
    shots
        The exposures.
    change
        Their fluctuations, see `charact.noise.fields`.
    least
        Exposures nearer in time than this are never compared.

    Notes
    -----
    The mean covariance over the image of two exposures of the same rows: their temporal noise is not alike, so none
    of it has to be known and subtracted. Light that lags is alike in exposures near in time. The distance is doubled
    until pairs further apart share no less.
    """
    parts = [_of_rows(shots, change, parity, least) for parity in np.unique(shots.parity)]
    return Pattern(
        variance_dn2=float(np.mean([part.variance_dn2 for part in parts])),
        sd_dn2=float(np.sqrt(np.sum([part.sd_dn2**2 for part in parts])) / len(parts)),
        settled=all(part.settled for part in parts),
    )


def _of_rows(shots: Exposures, change: NDArray[np.float32], parity: int, least: int) -> Pattern:
    """The pattern of the exposures of the same rows."""
    same = np.flatnonzero(shots.parity == parity)
    flat = shots.image[same].reshape(len(same), -1)
    flat = flat - flat.mean(axis=1, keepdims=True, dtype=np.float64).astype(np.float32)
    products = (flat @ flat.T).astype(np.float64) / flat.shape[1]
    distance = np.abs(shots.time[same][:, None] - shots.time[same])
    spread = _spread(shots.image[same], change[same])
    apart, excess = int(distance[distance > 0].min()), [0.0]
    while True:
        found, sd = _mean(products, distance >= apart, spread)
        further = distance >= 2 * apart
        if not further.any():
            rest = _rest(excess)
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


def _rest(excess: list[float]) -> float:
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


def _spread(image: NDArray[np.float32], change: NDArray[np.float32]) -> tuple[float, float]:
    """One over the number of independent pixels: for noise with noise, and for noise with the pattern."""
    count = len(change)
    some = np.linspace(0, count - 1, min(count, SPECTRA)).round().astype(int)
    noise = np.mean([_power(frame) for frame in change[some]], axis=0)
    mean = _power(image.mean(axis=0))
    total = float(noise.sum())
    if total <= 0:
        return 0.0, 0.0
    # The square of a mean over m exponential powers is too large by 1 + 1/m; centring takes one exposure away.
    twice = float((noise**2).sum()) / total**2 / (1.0 + 1.0 / max(1, min(len(some), count - 1)))
    crossed = float((mean * noise).sum()) / (total * max(float(mean.sum()), 1e-30))
    return twice, crossed


def _power(image: NDArray[np.float32]) -> Array:
    """Power of every mode of an image but its mean."""
    power = np.abs(np.fft.fft2(image.astype(np.float64))) ** 2
    power[0, 0] = 0.0
    return power
