"""The exposures of a stack in the order of time: whole frames, or the two fields that make each interlaced frame."""

from collections.abc import Sized
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


def runs_of(stack: Sized) -> list[tuple[int, int]]:
    """Return the first and last-plus-one frame of runs of nearly equal length, each of at least two frames."""
    frames = len(stack)
    count = max(1, -(-frames // RUN_FRAMES))
    edges = np.linspace(0, frames, count + 1).round().astype(int)
    return [(int(a), int(b)) for a, b in pairwise(edges)]


@dataclass(frozen=True, kw_only=True)
class Order:
    """When the exposures of some frames were made: `time`, `parity` and `row_step` as in `Exposures`."""

    time: NDArray[np.int64]
    parity: NDArray[np.int64]
    row_step: int


def order_of(frame_number: NDArray[np.int64], *, interlaced: bool) -> Order:
    """Return the order of the exposures of frames that follow one another; lost frames leave a gap in their times."""
    number = np.asarray(frame_number, np.int64) - int(frame_number[0])
    if not interlaced:
        return Order(time=number, parity=np.zeros(len(number), np.int64), row_step=1)
    parity = np.tile([0, 1], len(number))
    return Order(time=2 * np.repeat(number, 2) + parity, parity=parity, row_step=2)


def split_fields(data: NDArray, row_step: int) -> list[NDArray]:
    """Return the fields of frames as views, each of shape (frame, row, col); a last odd row has no partner."""
    rows = row_step * (data.shape[1] // row_step)
    return [data[:, parity:rows:row_step] for parity in range(row_step)]


def exposures(stack: FrameStack, first: int, last: int, *, interlaced: bool) -> Exposures:
    """Return the exposures of the frames first..last-1; lost frames leave a gap in their times."""
    data = stack.data[first:last]
    stamped = len(stack.frame_number) == len(stack)
    order = order_of(stack.frame_number[first:last] if stamped else np.arange(first, last), interlaced=interlaced)
    image = np.stack(split_fields(data, order.row_step), axis=1).astype(np.float32)
    return Exposures(image=image.reshape(-1, *image.shape[2:]), time=order.time, parity=order.parity,
                     row_step=order.row_step)  # fmt: skip


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
