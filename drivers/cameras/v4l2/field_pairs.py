"""Fields that come each for itself, put together two by two: the older one of a frame, and then its younger one.

Source: Linux Media userspace API, "Field Order", V4L2_FIELD_ALTERNATE: both fields of a frame have the same sequence
number, and each buffer says which of the two it holds.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.cameras.frame_assembly import IncompleteFrame
from drivers.cameras.v4l2.fields import BOTTOM, TOP
from labdata.capture import Frame


@dataclass(frozen=True, kw_only=True)
class Field:
    """One field.

    Parameters
    ----------
    pixels
        Its rows, shape (row, col), DN.
    parity
        Which one it is, the kernel's number: TOP or BOTTOM.
    number
        Number of its frame.
    time_s
        When it was exposed, s of the kernel's clock.
    """

    pixels: NDArray
    parity: int
    number: int
    time_s: float


class FieldPairs:
    """Makes frames of fields.

    Parameters
    ----------
    older
        Which field of a frame is exposed first, TOP or BOTTOM.
    next_field
        Returns the next field, or what came and is none.
    """

    def __init__(self, older: int, next_field: Callable[[], Field | IncompleteFrame]) -> None:
        self._older, self._next_field = older, next_field
        self._kept: Field | None = None

    def frame(self) -> Frame | IncompleteFrame:
        """Return the next frame, at the time of its older field; a frame of one field only is broken."""
        first, self._kept = self._kept or self._next_field(), None
        if isinstance(first, IncompleteFrame):
            return first
        if first.parity != self._older:
            return IncompleteFrame(number=first.number, fault="its older field did not come")
        second = self._next_field()
        if isinstance(second, IncompleteFrame):
            return IncompleteFrame(number=first.number, fault=f"its younger field: {second.fault}")
        if second.number != first.number or second.parity == first.parity:
            self._kept = second
            return IncompleteFrame(number=first.number, fault="its younger field did not come")
        return Frame(
            pixels=self._woven(first, second),
            number=first.number,
            time_s=first.time_s,
            field_order="top first" if self._older == TOP else "bottom first",
        )

    def _woven(self, first: Field, second: Field) -> NDArray:
        rows, columns = first.pixels.shape
        woven = np.empty((2 * rows, columns), first.pixels.dtype)
        for field in (first, second):
            woven[1 if field.parity == BOTTOM else 0 :: 2] = field.pixels
        return woven
