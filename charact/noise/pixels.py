"""Statistics of single pixels and of neighbours, with errors from the scatter of blocks of the image."""

import numpy as np
from numpy.typing import NDArray

from charact.noise.fields import Exposures

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
    """Return the correlation of pixels next to each other in a row, and its standard error."""
    if change.shape[2] < 2:
        return 0.0, 1.0
    power = _block_means(np.einsum("trc,trc->rc", change[..., :-1], change[..., :-1]))
    beside = _block_means(np.einsum("trc,trc->rc", change[..., :-1], change[..., 1:]))
    ratio = beside / np.maximum(power, 1e-12)
    error = ratio.std(ddof=1) / np.sqrt(power.size) if power.size > 1 else 1.0
    # Taking the mean of N pixels away makes white noise anticorrelated by 1/(N - 1).
    own = 1.0 / max(change[0].size - 1, 1)
    return float(beside.mean() / max(float(power.mean()), 1e-12)) + own, float(error)


def _block_means(image: NDArray) -> Array:
    """Means over the blocks of an image."""
    rows, cols = image.shape
    row_cuts = np.linspace(0, rows, min(BLOCKS[0], rows) + 1).astype(int)
    col_cuts = np.linspace(0, cols, min(BLOCKS[1], cols) + 1).astype(int)
    total = np.add.reduceat(np.add.reduceat(image.astype(np.float64), row_cuts[:-1], axis=0), col_cuts[:-1], axis=1)
    return total / np.outer(np.diff(row_cuts), np.diff(col_cuts))


def fixed_pattern(shots: Exposures, apart: int) -> tuple[float, float]:
    """Return the variance over the image of what does not change in time, and its standard error.

    The mean covariance over the image of two exposures of the same rows: their temporal noise is not alike, so none
    of it has to be known and subtracted. Exposures nearer in time than `apart` may share the glow of the screen.
    """
    flat = shots.image.reshape(len(shots.image), -1)
    flat = flat - flat.mean(axis=1, keepdims=True)
    size = flat.shape[1]
    products: list[float] = []
    square: list[float] = []
    for parity in np.unique(shots.parity):
        same = np.flatnonzero(shots.parity == parity)
        gram = (flat[same] @ flat[same].T).astype(np.float64) / size
        distance = np.abs(shots.time[same][:, None] - shots.time[same])
        far = (distance >= min(apart, int(distance.max()))) & (distance > 0)
        common = float(gram[far].mean())
        noise = max(float(np.trace(gram)) / len(same) - common, 0.0) / len(same)
        products.append(common)
        square.append((4.0 * max(common, 0.0) * noise + 2.0 * noise**2) / size)
    return float(np.mean(products)), float(np.sqrt(np.sum(square)) / len(square))
