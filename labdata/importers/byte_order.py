"""Byte order of 16-bit frames, checked by the bits that are in use."""

import numpy as np
from numpy.typing import NDArray


def byte_order_note(data: NDArray) -> tuple[str, ...]:
    """Return a note if the bytes of 16-bit pixels look swapped, else nothing.

    Notes
    -----
    Digitisers have 14 bits or fewer, mostly. With their bytes swapped the two upper bits of the low byte are never set
    while all bits of the high byte are in use. In the right order values that differ by more than 64 set them; bits
    shifted left leave the lower bits of the low byte free, not the upper ones.
    """
    if data.dtype.kind not in "ui" or data.dtype.itemsize != 2:
        return ()
    used = int(np.bitwise_or.reduce(np.asarray(data[0]).view(np.uint16), axis=None))
    high, low = divmod(used, 256)
    if high != 255 or not 0 < low < 64:
        return ()
    return (
        f"the two bytes of each pixel look swapped: all bits of the high byte are in use and none above the "
        f"{low.bit_length()} lowest of the low one; if so, no number here is right: write the file again in the other "
        "byte order",
    )
