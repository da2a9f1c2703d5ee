"""Orthonormal combinations of the pixels of a stack along time, rows and columns, read in one
pass.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from charact.frames.pixels import dot
from charact.frames.thresholds import CUBE
from labdata.frames import FrameStack, LazyStack

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Contrasts:
    """Orthonormal combinations of the pixels of a stack, separate for each interlaced field.

    Index 0 of an axis of combinations is the sum over it divided by the root of its length; the
    others are the slowest waves along it, see `waves`. White noise of variance v gives every
    combination the variance v. DN.
    """

    by_row: NDArray  # combinations along columns, shape (field, frame, row, wave)
    by_col: NDArray  # combinations along rows, shape (field, frame, wave, col)
    by_pixel: NDArray  # combinations along frames, shape (field, wave, row, col)
    # sum over frames and pixels of the squared deviation from the temporal mean of each pixel,
    # shape (field,), DN^2
    power_dn2: Array
    # differences of some successive frames, disjoint, over the root of two, shape (field, pair,
    # row, col)
    pairs: NDArray[np.float32]

    @property
    def size(self) -> tuple[int, int, int]:
        """Frames, rows and columns of one field."""
        return self.by_row.shape[1], self.by_row.shape[2], self.by_col.shape[3]

    @property
    def frame_mean_dn(self) -> Array:
        """Mean of every frame of each field, shape (field, frame), DN."""
        return self.by_row[..., 0].sum(axis=2) / np.sqrt(self.size[2]) / self.size[1]


def waves(length: int) -> Array:
    """Return the mean and the slowest waves along an axis as orthonormal rows, shape (1 + wave,
    length).
    """
    phase = 2.0 * np.pi * np.arange(length) / length
    periods = range(1, min(CUBE.slow_waves // 2, length // 2) + 1)
    pairs = [wave(period * phase) for period in periods for wave in (np.cos, np.sin)]
    # At half a wave per pixel the sine vanishes.
    rows = np.array([np.ones(length), *pairs])[: min(1 + CUBE.slow_waves, length)]
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def row_sets(*, interlaced: bool, two_way: bool = False) -> int:
    """Return the number of sets of rows that are separate: two fields, each with lines of both scan
    directions.
    """
    return (2 if interlaced else 1) * (2 if two_way else 1)


def contrasts(
    stack: LazyStack | FrameStack, *, interlaced: bool, two_way: bool = False
) -> Contrasts:
    """Read a stack once, in groups of frames, and return its contrasts.

    `two_way`: whether successive lines of a field are scanned in opposite directions; these are
    separate then.

    The first frame is subtracted from all frames, which removes the fixed pattern, so that single
    precision suffices for the squares.
    """
    step = row_sets(interlaced=interlaced, two_way=two_way)
    rows = step * (stack.shape[1] // step)
    parts = [_Pass(stack, parity, rows, step) for parity in range(step)]
    for first in range(0, len(stack), CUBE.chunk_frames):
        frames = stack.frames(first, min(first + CUBE.chunk_frames, len(stack)))
        for part in parts:
            part.take(frames, first)
    field_contrasts = [part.contrasts() for part in parts]
    by_row, by_col, by_pixel, power, pairs = (
        np.stack([part[i] for part in field_contrasts]) for i in range(5)
    )
    return Contrasts(by_row=by_row, by_col=by_col, by_pixel=by_pixel, power_dn2=power, pairs=pairs)


class _Pass:
    """Running sums of one field."""

    def __init__(self, stack: LazyStack | FrameStack, parity: int, rows: int, step: int) -> None:
        self.field = np.s_[parity:rows:step]
        self.first = stack.frames(0, 1)[0][self.field].astype(np.float64)
        frames, (height, width) = len(stack), self.first.shape
        self.along = [waves(length).astype(np.float32) for length in (frames, height, width)]
        self.by_row = np.empty((frames, height, len(self.along[2])), np.float32)
        self.by_col = np.zeros((frames, len(self.along[1]), width), np.float32)
        self.by_pixel = np.zeros((len(self.along[0]), height, width), np.float32)
        self.power = 0.0
        pairs = frames // 2
        self.starts = 2 * np.unique(
            np.linspace(0, pairs - 1, min(CUBE.pairs, pairs)).round().astype(int)
        )
        self.pairs: list[NDArray[np.float32]] = []

    def take(self, frames: NDArray, first: int) -> None:
        """Add the next frames."""
        change = self._from_first(frames[:, self.field])
        block = slice(first, first + len(change))
        in_time = np.ascontiguousarray(self.along[0][:, block].T)
        self.power += _add(
            change,
            in_time,
            self.along[1],
            self.along[2],
            self.by_row[block],
            self.by_col[block],
            self.by_pixel,
        )
        for start in (
            self.starts[(self.starts >= first) & (self.starts < first + len(change))] - first
        ):
            self.pairs.append((change[start + 1] - change[start]) / np.float32(np.sqrt(2.0)))

    def _from_first(self, frames: NDArray) -> NDArray[np.float32]:
        """Return the deviation from the first frame; values of up to 16 bits are exact in single
        precision.
        """
        if frames.dtype.itemsize <= 2:
            return np.subtract(frames, self.first.astype(np.float32), dtype=np.float32)
        return (frames - self.first).astype(np.float32)

    def contrasts(self):
        """Return the contrasts of the field including the first frame, the power about the mean,
        and the pairs.
        """
        frames = len(self.by_row)
        power = self.power - float(np.sum(self.by_pixel[0].astype(np.float64) ** 2))
        fixed_row, fixed_col = self.first @ self.along[2].T, self.along[1] @ self.first
        by_pixel = self.by_pixel.astype(np.float64)
        by_pixel[0] += np.sqrt(frames) * self.first
        return (
            self.by_row + fixed_row,
            self.by_col + fixed_col,
            by_pixel,
            power,
            np.array(self.pairs),
        )


@njit(cache=True, fastmath=True)
def _add(change, in_time, along_rows, along_cols, by_row, by_col, by_pixel):
    """Add the contrasts of some frames along time, rows and columns; return the sum of squares."""
    power = 0.0
    for t in range(change.shape[0]):
        for row in range(change.shape[1]):
            line = change[t, row]
            power += dot(line, line)
            for wave in range(along_cols.shape[0]):
                by_row[t, row, wave] = dot(line, along_cols[wave])
            for wave in range(along_rows.shape[0]):
                out, weight = by_col[t, wave], along_rows[wave, row]
                for col in range(len(line)):
                    out[col] += weight * line[col]
            for wave in range(in_time.shape[1]):
                out, weight = by_pixel[wave, row], in_time[t, wave]
                for col in range(len(line)):
                    out[col] += weight * line[col]
    return power
