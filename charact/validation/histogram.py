"""Grey levels of flats, measured against simulated: the shape of the noise beyond its variance.

Pixels share noise, so that only pixels far apart in the picture, each of its own frame, are drawn; their means are
matched, so that the light meter's error is no part of it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STRIDE = 8


@dataclass(frozen=True, kw_only=True)
class Distance:
    """Distance of two samples of grey levels.

    Parameters
    ----------
    kolmogorov
        Largest difference of the distribution functions, dimensionless.
    wasserstein_sd
        Mean shift that turns one sample into the other, in standard deviations of the measured one.
    p_value
        Probability of a Kolmogorov distance at least as large, dimensionless.
    """

    kolmogorov: float
    wasserstein_sd: float
    p_value: float


def sample_of(frames: NDArray, rng: np.random.Generator) -> Array:
    """Return pixels (n,) so far apart that they are independent, rounding smoothed out, less their mean, DN.

    Every second frame gives a lattice of pixels, and lattices of neighbouring frames lie between each other: neither
    blur, nor the screen's decay, nor the fixed pattern ties two of them together.
    """
    row, col = (int(rng.integers(STRIDE)) for _ in range(2))
    parts = []
    for place, frame in enumerate(frames[::2]):
        shift = STRIDE // 2 * (place % 2)
        top, left = (row + shift) % STRIDE, (col + STRIDE // 2 * (place // 2 % 2)) % STRIDE
        parts.append(frame[top::STRIDE, left::STRIDE].astype(float).ravel())
    apart = np.concatenate(parts)
    apart += rng.uniform(-0.5, 0.5, apart.size)
    return apart - apart.mean()


def distance(measured: Array, simulated: Array) -> Distance:
    """Return the distance of two samples with matched means, by Kolmogorov and Smirnov's two-sample test."""
    from scipy.stats import ks_2samp, wasserstein_distance

    found = ks_2samp(measured, simulated)
    return Distance(
        kolmogorov=float(found.statistic),  # type: ignore[union-attr]
        wasserstein_sd=float(wasserstein_distance(measured, simulated) / measured.std()),
        p_value=float(found.pvalue),  # type: ignore[union-attr]
    )
