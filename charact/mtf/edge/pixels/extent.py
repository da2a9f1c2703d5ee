"""How far an edge reaches in a frame that shows more than an edge: its rows and its plateaus, until something else."""

import numpy as np
from numpy.typing import NDArray

from charact.mtf.edge.pixels.line import EdgeLine
from charact.mtf.mean_frame import OrientedFrame, Region
from charact.robust import NORMAL, median

Array = NDArray[np.float64]

# The step is taken between these distances on both sides of the line, px.
NEAR_PX, FAR_PX = 3.0, 9.0
MIN_ROWS = 12


def edge_extent(picture: OrientedFrame, line: EdgeLine) -> Region | None:
    """Return ROW, COL, HEIGHT, WIDTH of the original frame that hold one edge and its plateaus; None: all of it.

    Rows belong to the edge as long as the step across the line stands there; plateaus end where the mean profile of
    these rows leaves its level by a third of the step.
    """
    rows, cols = picture.value.shape
    across = line.across((rows, cols))
    size = max(4, rows // 64)
    step, error = _steps(picture.value, across, size)
    reference = _reference(step)
    if not reference > 0:
        return None
    missing = ~np.isfinite(step) | (step < 0.5 * reference - 3.0 * error)
    first, last = _longest_run(~missing)
    if (last - first) * size < MIN_ROWS:
        return None
    whole_rows = last - first >= len(step) - 1
    inset = 2 * size + 4
    top, bottom = (0, rows) if whole_rows else (first * size + inset, min(last * size, rows) - inset)
    if bottom - top < MIN_ROWS:
        return None
    left, right = _plateaus(picture.value[top:bottom], across[top:bottom], reference, error)
    middle = line.position + line.slope * (np.array([top, bottom - 1]) - (rows - 1) / 2)
    low = int(np.floor(max(middle.min() - left, 0.0)))
    high = int(np.ceil(min(middle.max() + right + 1.0, float(cols))))
    if (top, bottom, low, high) == (0, rows, 0, cols):
        return None
    return original_region(picture, (top, low, bottom - top, high - low))


def _reference(step: Array) -> float:
    """Return the usual step of the blocks that hold the edge; 0 where no block brightens."""
    finite = step[np.isfinite(step)]
    if not finite.size or not finite.max() > 0:
        return 0.0
    return median(finite[finite > 0.5 * finite.max()])


def original_region(picture: OrientedFrame, region: Region) -> Region:
    """Return a region of an upright picture in its original frame."""
    row, col, height, width = region
    if picture.mirrored:
        col = picture.value.shape[1] - col - width
    return (col, row, width, height) if picture.transposed else (row, col, height, width)


def _steps(value: Array, across: Array, size: int) -> tuple[Array, float]:
    """Return the step of each block of rows and the noise of one, NaN where a side lies outside the frame."""
    count = len(value) // size
    sides = []
    for inside in ((across > NEAR_PX) & (across < FAR_PX), (across < -NEAR_PX) & (across > -FAR_PX)):
        number = inside.sum(axis=1).astype(float)
        total = np.where(inside, value, 0.0).sum(axis=1)
        blocks = number[: count * size].reshape(count, size).sum(axis=1)
        means = total[: count * size].reshape(count, size).sum(axis=1) / np.maximum(blocks, 1.0)
        sides.append(np.where(blocks >= size * (FAR_PX - NEAR_PX - 2.0), means, np.nan))
    step = sides[0] - sides[1]
    finite = step[np.isfinite(step)]
    error = NORMAL * median(np.abs(np.diff(finite))) / np.sqrt(2.0) if finite.size > 3 else 0.0
    return step, error


def _longest_run(good: NDArray[np.bool_]) -> tuple[int, int]:
    """Return the first and one past the last index of the longest run, single gaps closed."""
    closed = good.copy()
    closed[1:-1] |= good[:-2] & good[2:]
    borders = np.flatnonzero(np.diff(np.concatenate([[0], closed.astype(int), [0]])))
    starts, ends = borders[::2], borders[1::2]
    if not starts.size:
        return 0, 0
    best = int(np.argmax(ends - starts))
    return int(starts[best]), int(ends[best])


def _plateaus(value: Array, across: Array, step: float, error: float) -> tuple[float, float]:
    """Return how far both plateaus reach, px; infinite where nothing interrupts them."""
    cell = np.floor(across / 2.0).astype(np.int64)
    low = int(cell.min())
    count = np.bincount((cell - low).ravel())
    mean = np.bincount((cell - low).ravel(), weights=value.ravel()) / np.maximum(count, 1)
    enough = count > 0.3 * median(count)
    reach = []
    for sign in (-1, 1):
        places = np.arange(3, 400) * sign - (1 if sign < 0 else 0) - low
        places = places[(places >= 0) & (places < mean.size)]
        places = places[enough[places]]
        if places.size < 6:
            reach.append(np.inf)
            continue
        # The level wanders with the light: it is compared with what it was a little before.
        levels = mean[places]
        before = _running_median(levels, 12)
        away = np.abs(levels - before) > 0.3 * step + 3.0 * error
        reach.append(2.0 * (3 + int(np.argmax(away)) - 4) if away.any() else np.inf)
    return reach[0], reach[1]


def _running_median(values: Array, back: int) -> Array:
    """Return the median of each value and of up to so many before it."""
    windows = np.sort(
        np.lib.stride_tricks.sliding_window_view(np.concatenate([np.full(back, np.inf), values]), back + 1)
    )
    count = np.minimum(np.arange(values.size) + 1, back + 1)
    each = np.arange(values.size)
    return 0.5 * (windows[each, (count - 1) // 2] + windows[each, count // 2])
