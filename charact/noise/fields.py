"""The exposures of a stack in the order of time: whole frames, or the two fields that make each interlaced frame."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from labdata.frames import FrameStack

# Statistics are gathered from runs of at most so many frames: memory stays bounded and slow drift stays outside.
RUN_FRAMES = 32


@dataclass(frozen=True, kw_only=True)
class Exposures:
    """Images exposed one after the other.

    Parameters
    ----------
    image
        Pixel values, shape (exposure, row, col), DN.
    time
        Time of each exposure in units of one exposure's period (a field of interlaced video), shape (exposure,).
    parity
        Which rows of the frame it holds: 0 even, 1 odd; always 0 where frames are exposed whole. Shape (exposure,).
    row_step
        Rows of the frame from one row of the image to the next.
    """

    image: NDArray[np.float32]
    time: NDArray[np.int64]
    parity: NDArray[np.int64]
    row_step: int


def runs_of(stack: FrameStack) -> list[tuple[int, int]]:
    """Return the first and last-plus-one frame of runs of nearly equal length, each of at least two frames."""
    frames = len(stack)
    count = max(1, -(-frames // RUN_FRAMES))
    edges = np.linspace(0, frames, count + 1).round().astype(int)
    return [(int(a), int(b)) for a, b in pairwise(edges)]


def exposures(stack: FrameStack, first: int, last: int, *, interlaced: bool) -> Exposures:
    """Return the exposures of the frames first..last-1; lost frames leave a gap in their times."""
    data = stack.data[first:last]
    number = stack.frame_number[first:last] if len(stack.frame_number) == len(stack) else np.arange(first, last)
    number = np.asarray(number, np.int64) - int(number[0])
    if not interlaced:
        image = data.astype(np.float32)
        return Exposures(image=image, time=number, parity=np.zeros(len(data), np.int64), row_step=1)
    rows = 2 * (data.shape[1] // 2)
    pair = np.stack([data[:, 0:rows:2], data[:, 1:rows:2]], axis=1).astype(np.float32)
    parity = np.tile([0, 1], len(data))
    return Exposures(image=pair.reshape(-1, *pair.shape[2:]), time=2 * np.repeat(number, 2) + parity, parity=parity,
                     row_step=2)  # fmt: skip


def fluctuations(shots: Exposures) -> NDArray[np.float32]:
    """Return what changes in time: each pixel's mean over the exposures and each exposure's own level taken away.

    The fixed pattern goes with the pixel's mean, so that unequal pixels do not pass for noise; the level of the
    light goes with the exposure's mean, so that its flicker does not pass for correlation. The share 1/N of white
    noise that goes with the mean of N pixels is put back.
    """
    pixels = shots.image[0].size
    change = shots.image - shots.image.mean(axis=(1, 2), keepdims=True, dtype=np.float64).astype(np.float32)
    for parity in np.unique(shots.parity):
        same = shots.parity == parity
        change[same] -= change[same].mean(axis=0, keepdims=True)
    return change * np.float32(np.sqrt(pixels / max(pixels - 1, 1)))
