"""Exposures of a stack in time order (frames, or interlaced fields) and their temporal autocovariance."""

from collections.abc import Sized
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from charact.noise.thresholds import STACK
from labdata.frames import FrameStack


@dataclass(frozen=True, kw_only=True)
class Exposures:
    """Successive exposures.

    Parameters
    ----------
    image
        Pixel values, shape (exposure, row, col), DN.
    time
        Time of each exposure in units of one exposure's period (a field of interlaced video), shape (exposure,).
    parity
        Rows of the frame it contains: 0 even, 1 odd; 0 for progressive frames. Shape (exposure,).
    row_step
        Frame rows per image row.
    """

    image: NDArray[np.float32]
    time: NDArray[np.int64]
    parity: NDArray[np.int64]
    row_step: int


def runs_of(stack: Sized) -> list[tuple[int, int]]:
    """Return the first and last-plus-one frame of blocks of nearly equal length, at least two frames each."""
    frames = len(stack)
    count = max(1, -(-frames // STACK.block_frames))
    edges = np.linspace(0, frames, count + 1).round().astype(int)
    return [(int(a), int(b)) for a, b in pairwise(edges)]


@dataclass(frozen=True, kw_only=True)
class Order:
    """Times and parities of exposures: `time`, `parity` and `row_step` as in `Exposures`."""

    time: NDArray[np.int64]
    parity: NDArray[np.int64]
    row_step: int


def order_of(frame_number: NDArray[np.int64], *, interlaced: bool) -> Order:
    """Return the time order of the exposures of frames; lost frames leave a gap."""
    number = np.asarray(frame_number, np.int64) - int(frame_number[0])
    if not interlaced:
        return Order(time=number, parity=np.zeros(len(number), np.int64), row_step=1)
    parity = np.tile([0, 1], len(number))
    return Order(time=2 * np.repeat(number, 2) + parity, parity=parity, row_step=2)


def split_fields(data: NDArray, row_step: int) -> list[NDArray]:
    """Return the fields of frames as views, each of shape (frame, row, col), without an unpaired last row."""
    rows = row_step * (data.shape[1] // row_step)
    return [data[:, parity:rows:row_step] for parity in range(row_step)]


def exposures(stack: FrameStack, first: int, last: int, *, interlaced: bool) -> Exposures:
    """Return the exposures of the frames first..last-1; lost frames leave a gap in time."""
    data = stack.data[first:last]
    stamped = len(stack.frame_number) == len(stack)
    order = order_of(stack.frame_number[first:last] if stamped else np.arange(first, last), interlaced=interlaced)
    image = np.stack(split_fields(data, order.row_step), axis=1).astype(np.float32)
    return Exposures(image=image.reshape(-1, *image.shape[2:]), time=order.time, parity=order.parity,
                     row_step=order.row_step)  # fmt: skip


def fluctuations(shots: Exposures) -> NDArray[np.float32]:
    """Return the temporal fluctuations: exposures less each pixel's mean and each exposure's mean.

    The pixel mean removes the fixed pattern, the exposure mean flicker. The fraction 1/N of white noise lost with the
    mean of N pixels is restored.
    """
    pixels = shots.image[0].size
    change = shots.image - shots.image.mean(axis=(1, 2), keepdims=True, dtype=np.float64).astype(np.float32)
    for parity in np.unique(shots.parity):
        same = shots.parity == parity
        change[same] -= change[same].mean(axis=0, keepdims=True)
    return change * np.float32(np.sqrt(pixels / max(pixels - 1, 1)))
