"""A weighted sum of images, compiled: one pass over memory, always added in the same order."""

import numpy as np
from numba import njit
from numpy.typing import NDArray


def sum_weighted_images(
    images: NDArray, order: NDArray[np.integer], weights: NDArray[np.floating]
) -> NDArray[np.float32]:
    """Return sum_k weights[k] images[order[k]], shape (row, col).

    Parameters
    ----------
    images
        Shape (image, row, col).
    order
        Which images, in the order in which they are added, shape (k,).
    weights
        Shape (k,).
    """
    total = np.zeros(images.shape[1:], np.float32)
    _add(np.ascontiguousarray(images, np.float32), order.astype(np.int64), weights.astype(np.float32), total)
    return total


@njit(cache=True)
def _add(images, order, weights, total):
    for row in range(total.shape[0]):
        line = total[row]
        for k in range(order.size):
            weight = weights[k]
            image = images[order[k], row]
            for col in range(line.size):
                line[col] += weight * image[col]
