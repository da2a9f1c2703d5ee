"""Temporal noise on the dark and bright plateaus and on the slopes of a target.

Noise is taken from frame differences where there are several frames: fixed patterns and lamp flicker are then excluded.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Least pixels of a side.
MIN_PIXELS = 50
# Lags along a row: of neighbours, and of pixels so far apart that only what a row has in common ties them.
LAGS_PX = (1, 8, 9, 10)


@dataclass(frozen=True, kw_only=True)
class PlateauNoise:
    """Noise of one plateau of a target.

    Parameters
    ----------
    level
        Mean of its pixels, DN.
    variance, scatter
        Mean variance of a pixel, DN^2, and its relative standard uncertainty.
    covariance, covariance_sd
        Mean covariance of neighbours along a row less that of distant pixels, and its standard uncertainty, DN^2.
    """

    level: float
    variance: float
    scatter: float
    covariance: float
    covariance_sd: float


Sides = tuple[PlateauNoise, PlateauNoise]


def plateau_noise(frames: Array, expected: Array, sides: NDArray[np.int64], *, along: int, tied: float) -> Sides | None:
    """Return the noise of the dark and of the bright plateau; None if a plateau has too few pixels.

    Parameters
    ----------
    frames
        Shape (frame, row, col), DN.
    expected
        Model of a single frame, shape (row, col), DN.
    sides
        0 for excluded pixels, 1 on the dark and 2 on the bright plateau, shape (row, col).
    along
        Axis of a frame along which neighbours belong to one field: 0 down its rows, 1 along them.
    tied
        Sum of the noise correlations: variance factor of averages relative to independent pixels.

    Notes
    -----
    The mean of a plateau in each frame and, of several frames, the mean of each pixel are subtracted. Uncertainties
    follow from the scatter of the pixels, which includes heavy-tailed pulses, and from their correlation.
    """
    mean = frames.mean(axis=0) if len(frames) > 1 else expected
    sums = _sum_products(frames, mean, sides, 1 - along, along)
    if sums[:, 0].min() < MIN_PIXELS:
        return None
    free = max(len(frames) - 1, 1)
    dark, bright = (_side(one / np.array([1, 1, *([free, free**2] * 2), 1, free, 1]), max(tied, 1.0)) for one in sums)
    return dark, bright


def _side(sums: Array, tied: float) -> PlateauNoise:
    """Return the noise of a plateau from the sums over its pixels and pairs."""
    pixels, level, variances, squares, near, near_squares, pairs, far, far_pairs = sums.tolist()
    variance, covariance = variances / pixels, near / max(pairs, 1.0)
    scatter = max(squares / pixels - variance**2, 0.0)
    error = max(near_squares / max(pairs, 1.0) - covariance**2, 0.0)
    return PlateauNoise(
        level=level / pixels,
        variance=variance,
        scatter=float(np.sqrt(scatter * tied / pixels)) / max(variance, 1e-300),
        covariance=covariance - far / max(far_pairs, 1.0),
        covariance_sd=float(np.sqrt(error * tied / pairs)) if pairs else np.inf,
    )


@njit(cache=True)
def _sum_products(values: Array, mean: Array, sides: NDArray[np.int64], down: int, across: int) -> Array:
    """Return sums over both plateaus, shape (side, 9).

    Number of pixels, sum of values; sums of squares and of squares squared; sums of neighbours' products and of those
    squared, number of neighbours; sum of distant pixels' products, and their number.
    """
    frames, rows, cols = values.shape
    out, left = np.zeros((2, 9)), np.zeros((frames, rows, cols))
    for k in range(frames):
        total, count = np.zeros(3), np.zeros(3)
        for i in range(rows):
            for j in range(cols):
                left[k, i, j] = values[k, i, j] - mean[i, j]
                total[sides[i, j]] += left[k, i, j]
                count[sides[i, j]] += 1.0
        for i in range(rows):
            for j in range(cols):
                left[k, i, j] -= total[sides[i, j]] / count[sides[i, j]]
    for i in range(rows):
        for j in range(cols):
            side = sides[i, j]
            if side == 0:
                continue
            here = out[side - 1]
            square, value = 0.0, 0.0
            for k in range(frames):
                square += left[k, i, j] ** 2
                value += values[k, i, j] / frames
            here[0] += 1.0
            here[1] += value
            here[2] += square
            here[3] += square**2
            for lag in LAGS_PX:
                p, q = i + lag * down, j + lag * across
                if p >= rows or q >= cols or sides[p, q] != side:
                    continue
                product = 0.0
                for k in range(frames):
                    product += left[k, i, j] * left[k, p, q]
                if lag == 1:
                    here[4] += product
                    here[5] += product**2
                    here[6] += 1.0
                else:
                    here[7] += product
                    here[8] += 1.0
    return out
