"""A picture projected along many slopes, compiled: where its strongest straight step is."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Slopes among which the strongest step is looked for, and their distance, px per row.
SLOPES = np.tan(np.deg2rad(np.arange(-48.0, 49.0, 2.0)))
SLOPE_STEP = 0.035
# Share of the pixels of a full side that each side of a step must have.
MIN_SIDE = 0.1


def strongest_step(value: Array) -> tuple[float, float, float]:
    """Return the largest weighted step of the profiles projected along all slopes: signed, its place and its slope."""
    return _strongest_step(np.ascontiguousarray(value), SLOPES)


@njit(cache=True)
def _strongest_step(value: Array, slopes: Array) -> tuple[float, float, float]:
    best, place, along = 0.0, 0.0, 0.0
    for slope in slopes:
        first, total, count = _running_sums(value, slope)
        score, cut = _largest_step(total, count, min(value.shape))
        if abs(score) > abs(best):
            best, place, along = score, cut - 0.5 + first, slope
    return best, place, along


@njit(cache=True)
def _running_sums(value: Array, slope: float) -> tuple[float, Array, Array]:
    """Return the first cell's place, and running sums of the pixels projected along a slope and of their number."""
    rows, cols = value.shape
    middle = 0.5 * (rows - 1)
    first = -abs(slope) * middle
    size = int(np.rint(cols - 1 - 2.0 * first)) + 1
    total, count = np.zeros(size + 1), np.zeros(size + 1)
    for row in range(rows):
        begin = int(np.rint(-slope * (row - middle) - first)) + 1
        for col in range(cols):
            total[begin + col] += value[row, col]
            count[begin + col] += 1.0
    for cell in range(size):
        total[cell + 1] += total[cell]
        count[cell + 1] += count[cell]
    return first, total, count


@njit(cache=True)
def _largest_step(total: Array, count: Array, side: int) -> tuple[float, float]:
    """Return the largest step between neighbouring stretches of a profile, weighted by its pixels, and its cell."""
    size, reach = total.size - 1, max(3, side // 6)
    best, at = 0.0, 0.0
    for cut in range(2, size - 1):
        low, high = max(cut - reach, 0), min(cut + reach, size)
        left, right = count[cut] - count[low], count[high] - count[cut]
        if min(left, right) <= MIN_SIDE * reach * side:
            continue
        step = (total[high] - total[cut]) / right - (total[cut] - total[low]) / left
        score = step * np.sqrt(left * right / (left + right))
        if abs(score) > abs(best):
            best, at = score, float(cut)
    return best, at
