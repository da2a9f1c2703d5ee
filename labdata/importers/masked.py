"""Pixels that are not finite: a border of them is cut off, a few inside are filled from their neighbours.

Calibrated and resampled pictures mark pixels without data with NaN, mostly along their borders.
"""

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.frames import blocks
from labdata.importers.thresholds import MOST_MASKED


def without_gaps(data: NDArray, name: str) -> tuple[NDArray, tuple[int, int], tuple[str, ...]]:
    """Return frames of finite pixels, where in the picture they begin (row, col), and notes of what was done.

    Parameters
    ----------
    data
        Pixels, shape (frame, row, col, ...).
    name
        The file, for sentences.

    Raises
    ------
    BadInput
        If more than 0.5 % of the pixels inside the border are not finite.
    """
    if data.dtype.kind != "f":
        return data, (0, 0), ()
    gaps = np.zeros(data.shape[1:3], bool)
    for block in blocks(data):
        gaps |= ~np.isfinite(block).all(axis=(0, *range(3, data.ndim)))
    if not gaps.any():
        return data, (0, 0), ()
    top, bottom, left, right = _inside(_gaps_at_border(gaps))
    rows, cols = data.shape[1:3]
    notes = []
    if bottom - top < rows or right - left < cols:
        notes.append(
            f"a border that is not finite was cut off: rows {top} to {bottom - 1} of {rows} and columns {left} to "
            f"{right - 1} of {cols} are measured; regions count from the file's first row and column"
        )
    data, gaps = data[:, top:bottom, left:right], gaps[top:bottom, left:right]
    count = int(np.count_nonzero(gaps))
    if count > MOST_MASKED * gaps.size or not gaps.size:
        bad = sum(int(np.count_nonzero(~np.isfinite(block))) for block in blocks(data))
        raise BadInput(
            f"every pixel must be finite, but for a border and {100 * MOST_MASKED:g} % inside it, got {bad} that are "
            f"NaN or infinite of {data.size}"
        )
    if count:
        data = _fill_gaps(data, gaps)
        notes.append(f"{count} pixels inside the picture are not finite and were filled from their neighbours")
    return data, (top, left), tuple(notes)


def _gaps_at_border(gaps: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return those gaps that hang together with one at the picture's border along more than a single pixel."""
    from scipy.ndimage import label

    numbers = np.empty(gaps.shape, np.int32)
    label(gaps, np.ones((3, 3), int), numbers)
    outer = np.unique(np.concatenate([numbers[0], numbers[-1], numbers[:, 0], numbers[:, -1]]))
    sizes = np.bincount(numbers.ravel())
    return np.isin(numbers, outer[(outer > 0) & (sizes[outer] > 1)])


def _inside(gaps: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Return the rows and columns that remain when border lines with gaps are taken off, the worst first."""
    top, left = 0, 0
    bottom, right = gaps.shape
    while top < bottom and left < right and (inner := gaps[top:bottom, left:right]).any():
        lines = (inner[0].mean(), inner[-1].mean(), inner[:, 0].mean(), inner[:, -1].mean())
        worst = int(np.argmax(lines))
        if lines[worst] == 0.0:  # a bay of gaps that a taken line had joined to the border
            break
        top, bottom = top + (worst == 0), bottom - (worst == 1)
        left, right = left + (worst == 2), right - (worst == 3)
    return top, bottom, left, right


def _fill_gaps(data: NDArray, gaps: NDArray[np.bool_]) -> NDArray:
    """Return a copy with the gaps set to the median of the finite pixels of the smallest window around each."""
    data = np.array(data)
    rows, cols = gaps.shape
    for row, col in np.argwhere(gaps):
        reach = 1
        while True:
            where = np.s_[max(0, row - reach) : row + reach + 1, max(0, col - reach) : col + reach + 1]
            if np.count_nonzero(~gaps[where]) >= 4 or reach > max(rows, cols):
                break
            reach += 1
        around = data[(slice(None), *where)][:, ~gaps[where]]
        data[:, row, col] = np.median(around, axis=1)
    return data
