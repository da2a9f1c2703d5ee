"""How much of each pixel a polygon covers: exact areas, by its outline's way through the pixels."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
# Shares that are smaller than this part of the largest are rounding.
ROUNDING = 1e-9


def coverage(row: Array, col: Array, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return the share of each pixel that a polygon covers, shape (row, col).

    Parameters
    ----------
    row, col
        Its corners in turn, whole numbers at the corners of pixels, shape (corner,).
    shape
        Pixels, from (0, 0) on; the polygon may reach beyond.

    Notes
    -----
    Green's theorem: each piece of the outline within a pixel adds its height times what lies to its right in the pixel,
    and its whole height to all pixels to the right.
    """
    place = np.clip(np.stack([row, col], axis=1) + 0.0, -1.0, np.add(shape, 1.0))
    start, end = _pieces(place)
    middle, rise = 0.5 * (start + end), (end - start)[:, 0]
    line = np.floor(middle[:, 0]).astype(np.int64)
    inside = (line >= 0) & (line < shape[0]) & (middle[:, 1] < shape[1])
    line, at, rise = line[inside], np.maximum(middle[inside, 1], 0.0), rise[inside]
    pixel = np.floor(at).astype(np.int64)
    height = np.zeros((shape[0], shape[1] + 1))
    np.add.at(height, (line, pixel), rise * (pixel + 1.0 - at))
    np.add.at(height, (line, pixel + 1), rise * (at - pixel))
    share = np.abs(np.cumsum(height, axis=1)[:, :-1])
    # Sums of what cancels leave a hair.
    return np.where(share > ROUNDING * share.max(initial=0.0), np.minimum(share, 1.0), 0.0)


def _pieces(corner: Array) -> tuple[Array, Array]:
    """Cut the sides of a polygon (corner, 2) where they cross whole numbers: starts and ends, shape (piece, 2)."""
    side = np.roll(corner, -1, axis=0) - corner
    edge, along = [np.arange(len(corner))], [np.zeros(len(corner))]
    for axis in (0, 1):
        low, high = np.sort([corner[:, axis], corner[:, axis] + side[:, axis]], axis=0)
        first = np.floor(low) + 1.0
        count = np.maximum(np.ceil(high) - first, 0.0).astype(np.int64)
        which = np.repeat(np.arange(len(corner)), count)
        line = first[which] + np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
        edge.append(which)
        along.append((line - corner[which, axis]) / side[which, axis])
    which, share = np.concatenate(edge), np.concatenate(along)
    order = np.lexsort((share, which))
    start = corner[which[order]] + share[order, None] * side[which[order]]
    return start, np.roll(start, -1, axis=0)
