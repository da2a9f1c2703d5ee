"""Mean frame of a stack, oriented so that an edge is upright with its bright side right."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.thresholds import LIMITS
from charact.frames.stack import Stack

Array = NDArray[np.float64]

Region = tuple[int, int, int, int]


@dataclass(frozen=True, kw_only=True)
class OrientedFrame:
    """Mean frame with its orientation.

    Parameters
    ----------
    stack
        The frames averaged.
    value
        Mean frame, shape (row, col), DN, upright.
    row_index
        Row of the original frame of every pixel, shape (row, col); its parity is the field.
    transposed, mirrored
        Whether rows and columns are exchanged, and whether the columns then run backwards.
    pitch_ratio
        Row pitch over column pitch of the oriented frame.
    """

    stack: Stack
    value: Array
    row_index: NDArray[np.int64]
    transposed: bool
    mirrored: bool
    pitch_ratio: float

    def turned(self, *, transpose: bool, mirror: bool) -> "OrientedFrame":
        """Return the frame transposed and then mirrored."""
        value, row_index = (
            (self.value.T, self.row_index.T) if transpose else (self.value, self.row_index)
        )
        step = -1 if mirror else 1
        return replace(
            self,
            value=np.ascontiguousarray(value[:, ::step]),
            row_index=np.ascontiguousarray(row_index[:, ::step]),
            transposed=self.transposed != transpose,
            mirrored=self.mirrored != mirror,
            pitch_ratio=1.0 / self.pitch_ratio if transpose else self.pitch_ratio,
        )

    @cached_property
    def upright_frames(self) -> Array:
        """Frames in the same orientation, shape (frame, row, col), DN."""
        turned = self.stack.data.swapaxes(1, 2) if self.transposed else self.stack.data
        return np.ascontiguousarray(turned[:, :, ::-1] if self.mirrored else turned, np.float64)


def usable_black_level(black_dn: float | None, dark_dn: float, bright_dn: float) -> float | None:
    """Return the black level, DN; None if it is unknown or lies well above the dark side."""
    if black_dn is None or black_dn > dark_dn + LIMITS.max_below_black * (bright_dn - dark_dn):
        return None
    return black_dn
