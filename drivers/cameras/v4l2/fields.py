"""Fields of interlaced video: field order, and frames from two fields.

Source: Linux Media userspace API, "Field Order": of video of 525 lines the bottom field is the
older one, of any other the top field. V4L2_FIELD_ALTERNATE: both fields of a frame have the same
sequence number, and each buffer states which of the two it contains.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.cameras.frame_assembly import IncompleteFrame
from drivers.cameras.v4l2.structures import STANDARDS_525
from labdata.capture import FieldOrder, Frame
from labdata.errors import BadInput

ANY, PROGRESSIVE, TOP, BOTTOM, INTERLACED, TOP_THEN_BOTTOM, BOTTOM_THEN_TOP, ALTERNATE = range(8)
INTERLACED_TOP_FIRST, INTERLACED_BOTTOM_FIRST = 8, 9

# First row of the first field, for fields stored one after the other
FIRST_ROW = {TOP_THEN_BOTTOM: 0, BOTTOM_THEN_TOP: 1}

STANDARDS = {525: 0x0000B000, 625: 0x000000FF}  # V4L2_STD_NTSC and V4L2_STD_PAL by number of lines

_ORDERS: dict[int, FieldOrder] = {
    PROGRESSIVE: "progressive",
    TOP: "top only",
    BOTTOM: "bottom only",
    TOP_THEN_BOTTOM: "top first",
    BOTTOM_THEN_TOP: "bottom first",
    INTERLACED_TOP_FIRST: "top first",
    INTERLACED_BOTTOM_FIRST: "bottom first",
}
# The kernel's number of each field order; of two, the one with interleaved rows
NUMBERS = {order: number for number, order in _ORDERS.items()}


def field_order(field: int, standard: int) -> FieldOrder:
    """Return the order of a frame's fields from the kernel's number and the bits of the input's
    standards.
    """
    if field in (INTERLACED, ALTERNATE):
        return "bottom first" if older_field(standard) == BOTTOM else "top first"
    if field not in _ORDERS:
        raise BadInput(
            f"the order of a frame's fields must be one of the kernel's, got the field number "
            f"{field}"
        )
    return _ORDERS[field]


def older_field(standard: int) -> int:
    """Return the field of a video standard that is exposed first, the kernel's TOP or BOTTOM."""
    return BOTTOM if standard & STANDARDS_525 else TOP


def rows_of(height: int, field: int) -> int:
    """Return the rows of a frame from the height of its format, px, which is that of a field for
    separate fields.
    """
    return 2 * height if field == ALTERNATE else height


@dataclass(frozen=True, kw_only=True)
class Field:
    """One field."""

    pixels: NDArray  #: Pixels of the field, shape (row, col), DN
    parity: int  #: The kernel's number of the field: TOP or BOTTOM
    number: int  #: Number of its frame
    time_s: float  #: Time stamp, s of the kernel's clock


class FieldPairs:
    """Combines the fields that `next_field` returns into frames; `older` is exposed first, TOP or
    BOTTOM.
    """

    def __init__(self, older: int, next_field: Callable[[], Field | IncompleteFrame]) -> None:
        self._older, self._next_field = older, next_field
        self._kept: Field | None = None

    def frame(self) -> Frame | IncompleteFrame:
        """Return the next frame with the time of its older field; a single field is an incomplete
        frame.
        """
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
            pixels=weave(first.pixels, second.pixels, first_row=int(self._older == BOTTOM)),
            number=first.number,
            time_s=first.time_s,
            field_order="top first" if self._older == TOP else "bottom first",
        )


def weave(first: NDArray, second: NDArray, *, first_row: int) -> NDArray:
    """Return the frame of two fields, shape (row, col) each; the first begins at row 0 or 1."""
    frame = np.empty((2 * len(first), *first.shape[1:]), first.dtype)
    frame[first_row::2], frame[1 - first_row :: 2] = first, second
    return frame
