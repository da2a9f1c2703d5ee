"""Frames of a tube's darks and flats that are observed, and means over blocks of them."""

import numpy as np
from numpy.typing import NDArray

from charact.fitting.thresholds import FRAMES
from charact.observables.stack_level import StackLevel
from labdata import Array


def frames_of(level: StackLevel) -> NDArray[np.float32] | None:
    """Return the middle of a stack's successive frames, DN, or None of too few, or of frames that
    were lost.
    """
    if level.entry is None:
        return None
    stack = level.entry.read()
    count = min(len(stack), FRAMES.most_frames)
    if count < FRAMES.least_frames or np.any(np.diff(stack.frame_number[:count]) != 1):
        return None
    rows, columns = stack.data.shape[1:]
    # An even first row keeps the order of the fields.
    top = max(rows - FRAMES.most_rows, 0) // 4 * 2
    first_column = max(columns - FRAMES.most_columns, 0) // 2
    return stack.data[
        :count, top : top + FRAMES.most_rows, first_column : first_column + FRAMES.most_columns
    ].astype(np.float32)


def block_sums(image: NDArray) -> Array:
    """Return the sums of the blocks of an image, shape (block,)."""
    rows, columns = (
        (np.arange(parts) * n) // parts for n, parts in zip(image.shape, FRAMES.blocks, strict=True)
    )
    return np.add.reduceat(
        np.add.reduceat(image.astype(np.float64), rows, axis=0), columns, axis=1
    ).ravel()


def block_means(image: NDArray[np.floating]) -> Array:
    """Return the means of the blocks of an image, shape (block,)."""
    return block_sums(image) / block_sums(np.ones(image.shape))
