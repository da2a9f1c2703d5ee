"""Full scale and byte order of frames, found from the data."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labdata.frames import FrameStack, blocks
from labdata.importers.thresholds import LEAST_BITS, LEAST_PIXELS, MOST_BITS

FOUND = "full scale found from the data"


def with_full_scale(stack: FrameStack) -> FrameStack:
    """Return frames with their full scale, if it is known or can be found.

    Notes
    -----
    Full scale of 8-bit integers is 255. In wider types it can be found only if pixels are at full
    scale: the highest value is then 2^n - 1 quantisation steps, and several pixels must have it,
    since noise has a single highest pixel. The step is 1 in plain integers, a power of 2 where n
    bits are the upper ones of a wider type, and 1 / (2^n - 1) in real numbers from 0 to 1. Frames
    below full scale do not need it.
    """
    if stack.full_scale_dn is not None:
        return stack
    if stack.data.dtype == np.uint8:
        return replace(stack, full_scale_dn=255.0)
    highest, pixels_at_highest = _highest(stack.data)
    if pixels_at_highest < LEAST_PIXELS or highest <= 0:
        return stack
    bits = _bits_of(stack.data, highest)
    if bits is None:
        return stack
    step = highest / (2**bits - 1)
    steps = "" if step == 1 else f" in steps of {step:.6g} DN"
    note = (
        f"{FOUND}: {pixels_at_highest} pixels hold the highest code, {highest:g} DN, which is that "
        f"of {bits} bits{steps}"
    )
    return replace(stack, full_scale_dn=float(highest), notes=(*stack.notes, note))


def ends_at(highest: int, pixels_at_highest: int) -> bool:
    """Return whether the highest value, with its number of pixels, is the full scale of a
    digitiser.
    """
    return (
        highest.bit_length() >= LEAST_BITS
        and highest == 2 ** highest.bit_length() - 1
        and pixels_at_highest >= LEAST_PIXELS
    )


def _bits_of(data: NDArray, highest: float) -> int | None:
    """Return the bits of the digitiser whose full scale is the highest value; None if there is
    none.

    Notes
    -----
    Integers are divided by their largest common power of 2. Real numbers of the first frame must be
    multiples of the highest one over 2^n - 1 within their rounding.
    """
    if data.dtype.kind in "ui":
        used_bits = 0
        for block in blocks(data):
            used_bits |= int(np.bitwise_or.reduce(block, axis=None))
        top = int(highest) // (used_bits & -used_bits)
        return top.bit_length() if ends_at(top, LEAST_PIXELS) else None
    values = np.unique(np.asarray(data[0], np.float64)) / highest
    if values.size <= MOST_BITS:  # a few round numbers are multiples of many steps
        return None
    rounding = 4.0 * float(np.finfo(data.dtype).eps)
    for bits in range(LEAST_BITS - 1, MOST_BITS + 1):
        codes = values * (2**bits - 1)
        if np.abs(codes - np.rint(codes)).max() <= rounding * 2**bits:
            return bits
    return None


def _highest(data: NDArray) -> tuple[float | int, int]:
    """Return the highest value and its number of pixels, in one pass."""
    highest, count = None, 0
    for block in blocks(data):
        top = block.max()
        if highest is None or top > highest:
            highest, count = top, 0
        count += int(np.count_nonzero(block == top)) if top == highest else 0
    return (0 if highest is None else highest.item()), count


def byte_order_note(data: NDArray) -> tuple[str, ...]:
    """Return a note if the bytes of 16-bit pixels appear swapped.

    Notes
    -----
    Most digitisers have at most 14 bits. With swapped bytes the two upper bits of the low byte are
    never set while all bits of the high byte are used. In the right order, values that differ by
    more than 64 set them; bits shifted left leave the lower bits of the low byte unused, not the
    upper ones.
    """
    if data.dtype.kind not in "ui" or data.dtype.itemsize != 2:
        return ()
    used_bits = int(np.bitwise_or.reduce(np.asarray(data[0]).view(np.uint16), axis=None))
    high, low = divmod(used_bits, 256)
    if high != 255 or not 0 < low < 64:
        return ()
    return (
        "the two bytes of each pixel look swapped: all bits of the high byte are in use and none "
        f"above the {low.bit_length()} lowest of the low one; if so, no number here is right: "
        "write the file again in the other byte order",
    )
