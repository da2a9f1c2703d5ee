"""Byte order of 16-bit frames, checked by how neighbours change."""

import numpy as np
from numpy.typing import NDArray

from labdata.importers.thresholds import BYTES_SWAPPED


def swapped_note(data: NDArray) -> tuple[str, ...]:
    """Return a note if the bytes of 16-bit pixels look swapped, else nothing.

    Notes
    -----
    From a pixel to its neighbour the low byte changes at least as often as the high byte, except where few bits are
    shifted far left: of 9 bits in the upper ones of 16 the low byte is one bit and changes half as often. More than
    three times as many changes of the high byte have no other cause than a swap. A low byte that never changes (8 bits
    shifted left by 8) proves nothing.
    """
    if data.dtype.kind not in "ui" or data.dtype.itemsize != 2 or data.shape[2] < 2:
        return ()
    frame = np.asarray(data[0]).view(np.uint16)
    changed = frame[:, 1:] ^ frame[:, :-1]
    high, low = float(np.mean(changed >> 8 != 0)), float(np.mean(changed & 255 != 0))
    if low == 0.0 or high <= BYTES_SWAPPED * low:
        return ()
    return (
        f"the two bytes of each pixel look swapped: from pixel to pixel the high byte changes {high / low:.3g} times "
        "as often as the low one; if so, no number here holds: write the file again in the other byte order",
    )
