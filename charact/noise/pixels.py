"""Statistics of single pixels and of neighbours, with errors from the scatter of blocks of the image."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Blocks of the image (rows, columns) whose scatter gives the uncertainty of its variance.
BLOCKS = (6, 8)


def products_of(change: NDArray[np.float32], parity: NDArray[np.int64]) -> Array:
    """Return the mean product of exposures of equal parity, shape (exposure, exposure); 0 across parities."""
    flat = change.reshape(len(change), -1)
    out = np.zeros((len(change), len(change)))
    for value in np.unique(parity):
        same = np.flatnonzero(parity == value)
        out[np.ix_(same, same)] = (flat[same] @ flat[same].T) / flat.shape[1]
    return out


def variance_error(change: NDArray[np.float32], image: NDArray[np.float32], variance: float) -> float:
    """Return the standard error of the mean variance, from blocks of the image, each at the level of the whole."""
    power = _block_means(np.einsum("trc,trc->rc", change, change))
    level = _block_means(image.mean(axis=0, dtype=np.float64))
    # A block that is darker is also quieter.
    even = power * (level.mean() / level if level.min() > 0.5 * level.mean() else 1.0)
    if power.size < 2:
        return variance
    return float(variance * even.std(ddof=1) / max(float(even.mean()), 1e-12) / np.sqrt(power.size))


def neighbours(change: NDArray[np.float32]) -> tuple[float, float]:
    """Return the correlation of pixels next to each other in a row, and its standard error.

    Nothing, and known to be nothing, where a row has a single pixel.
    """
    if change.shape[2] < 2:
        return 0.0, 0.0
    power = _block_means(np.einsum("trc,trc->rc", change[..., :-1], change[..., :-1]))
    beside = _block_means(np.einsum("trc,trc->rc", change[..., :-1], change[..., 1:]))
    ratio = beside / np.maximum(power, 1e-12)
    error = ratio.std(ddof=1) / np.sqrt(power.size) if power.size > 1 else 1.0
    # Taking the mean of N pixels away makes white noise anticorrelated by 1/(N - 1).
    own = 1.0 / max(change[0].size - 1, 1)
    return float(beside.mean() / max(float(power.mean()), 1e-12)) + own, float(error)


def successors(change: NDArray[np.float32], time: NDArray[np.int64], parity: NDArray[np.int64]) -> tuple[float, float]:
    """Return by how much exposures nearest in time correlate beyond the others, and its standard error.

    Centred exposures add up to nothing, so that what all pairs share follows from the variance: the contrast of near
    and far pairs needs the near ones alone, and neither centring nor the fixed pattern has a part in it. Two exposures
    of the same rows have no contrast; their error is infinite.
    """
    near, pairs, others = np.zeros(change.shape[1:]), 0, 0
    for value in np.unique(parity):
        same = np.flatnonzero(parity == value)
        first, second = _nearest(time[same])
        near += np.einsum("trc,trc->rc", change[same[first]], change[same[second]])
        pairs += len(first)
        others += len(same) * (len(same) - 1) // 2 - len(first)
    power = _block_means(np.einsum("trc,trc->rc", change, change))
    freedom = len(change) - len(np.unique(parity))
    if not others or power.mean() <= 0 or power.size < 2:
        return 0.0, np.inf
    beside = _block_means(near)
    contrast = (beside / pairs + (0.5 * power + beside) / others) * freedom / power.mean()
    return float(contrast.mean()), float(contrast.std(ddof=1) / np.sqrt(power.size))


def _nearest(time: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices of the pairs that lie the least time apart."""
    distance = np.abs(time[:, None] - time)
    upper = np.triu(np.ones_like(distance, bool), 1)
    first, second = np.nonzero(upper & (distance == distance[upper].min()))
    return first, second


def _block_means(image: NDArray) -> Array:
    """Means over the blocks of an image."""
    rows, cols = image.shape
    row_cuts = np.linspace(0, rows, min(BLOCKS[0], rows) + 1).astype(int)
    col_cuts = np.linspace(0, cols, min(BLOCKS[1], cols) + 1).astype(int)
    total = np.add.reduceat(np.add.reduceat(image.astype(np.float64), row_cuts[:-1], axis=0), col_cuts[:-1], axis=1)
    return total / np.outer(np.diff(row_cuts), np.diff(col_cuts))
