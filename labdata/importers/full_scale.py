"""The highest code of the digitiser, found from the data where nobody states it: the code at which pixels pile up."""

from dataclasses import replace

import numpy as np

from labdata.frames import FrameStack

FOUND = "full scale found from the data"
LEAST_PIXELS = 4
LEAST_BITS = 9


def with_full_scale(stack: FrameStack) -> FrameStack:
    """Return frames with their full scale, if it is known or shows.

    Notes
    -----
    Whole numbers of 8 bits end at 255. In wider types full scale shows only where pixels sit on it: the highest code
    is then 2^n - 1, and not by the chance of a noise's single highest pixel, so several must hold it. Frames that
    stay below full scale do not show it, and need it least.
    """
    data = stack.data
    if stack.full_scale_dn is not None or data.dtype.kind not in "ui":
        return stack
    if data.dtype == np.uint8:
        return replace(stack, full_scale_dn=255.0)
    highest = int(data.max())
    held = int(np.count_nonzero(data == highest))
    if not ends_at(highest, held):
        return stack
    bits = highest.bit_length()
    note = f"{FOUND}: {held} pixels hold the highest code, {highest} DN, which is that of {bits} bits"
    return replace(stack, full_scale_dn=float(highest), notes=(*stack.notes, note))


def ends_at(highest: int, held: int) -> bool:
    """Whether the highest code in the data, held by so many pixels, is the last one of a digitiser."""
    return highest.bit_length() >= LEAST_BITS and highest == 2 ** highest.bit_length() - 1 and held >= LEAST_PIXELS
