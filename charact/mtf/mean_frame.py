"""Mean frame of a stack, oriented so that an edge is upright with its bright side right."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labdata.frames import FrameStack

Array = NDArray[np.float64]

Region = tuple[int, int, int, int]


@dataclass(frozen=True, kw_only=True)
class OrientedFrame:
    """Mean frame with its orientation.

    Parameters
    ----------
    value
        Mean frame, shape (row, col), DN, upright.
    row_index
        Row of the original frame of every pixel, shape (row, col); its parity is the field.
    transposed, mirrored
        Whether rows and columns are exchanged, and whether the columns then run backwards.
    frames
        Number of frames averaged.
    whole_codes
        Whether the frames hold integers.
    black_dn
        Black level, DN; None: unknown.
    pitch_ratio
        Row pitch over column pitch of the oriented frame.
    interlaced
        Whether odd and even rows of the original frame are two fields.
    """

    value: Array
    row_index: NDArray[np.int64]
    transposed: bool
    mirrored: bool
    frames: int
    whole_codes: bool
    black_dn: float | None
    pitch_ratio: float
    interlaced: bool = False

    @property
    def field_axis(self) -> int | None:
        """Axis along which two fields alternate; None: progressive frames."""
        return int(self.transposed) if self.interlaced else None

    def turned(self, *, transpose: bool, mirror: bool) -> "OrientedFrame":
        """Return the frame transposed and then mirrored."""
        value, row_index = self.value, self.row_index
        if transpose:
            value, row_index = value.T, row_index.T
        if mirror:
            value, row_index = value[:, ::-1], row_index[:, ::-1]
        return OrientedFrame(
            value=np.ascontiguousarray(value),
            row_index=np.ascontiguousarray(row_index),
            transposed=self.transposed != transpose,
            mirrored=self.mirrored != mirror,
            frames=self.frames,
            whole_codes=self.whole_codes,
            black_dn=self.black_dn,
            pitch_ratio=1.0 / self.pitch_ratio if transpose else self.pitch_ratio,
            interlaced=self.interlaced,
        )

    def upright(self, frame: NDArray) -> Array:
        """Return a single frame in the same orientation."""
        turned = frame.T if self.transposed else frame
        return np.ascontiguousarray(turned[:, ::-1] if self.mirrored else turned, np.float64)


def mean_oriented_frame(stack: FrameStack, pitch_ratio: float, *, interlaced: bool = False) -> OrientedFrame:
    """Return the mean frame of a stack, not yet reoriented."""
    data = stack.data
    frames, rows, cols = data.shape
    value = data[0].astype(float) if frames == 1 else data.mean(axis=0, dtype=np.float64)
    whole = data.dtype.kind in "ui" or bool(np.all(data[0] == np.rint(data[0])))
    return OrientedFrame(
        value=value,
        row_index=np.broadcast_to(np.arange(rows)[:, None], (rows, cols)),
        transposed=False,
        mirrored=False,
        frames=frames,
        whole_codes=whole,
        black_dn=stack.black_level_dn,
        pitch_ratio=pitch_ratio,
        interlaced=interlaced,
    )
