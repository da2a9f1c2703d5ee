"""Full scale of the digitiser, found from the data where it is not stated: the last code, where pixels pile up."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labdata.frames import FrameStack, blocks
from labdata.importers.thresholds import LEAST_BITS, LEAST_PIXELS

FOUND = "full scale found from the data"


def with_full_scale(stack: FrameStack) -> FrameStack:
    """Return frames with their full scale, if it is known or shows.

    Notes
    -----
    Whole numbers of 8 bits end at 255. In wider types full scale shows only where pixels sit on it: the highest value
    is then 2^n - 1 steps of the digitiser, and not by the chance of a noise's single highest pixel, so several must be
    there. The step is 1 in plain whole numbers, a power of 2 where n bits fill the upper ones of a wider type, and
    1 / (2^n - 1) in real numbers from 0 to 1. Frames that stay below full scale do not show it, and need it least.
    """
    if stack.full_scale_dn is not None:
        return stack
    if stack.data.dtype == np.uint8:
        return replace(stack, full_scale_dn=255.0)
    highest, held = _highest(stack.data)
    step = step_of(stack.data) if held >= LEAST_PIXELS and highest > 0 else None
    if step is None or not ends_at(round(highest / step), held):
        return stack
    bits = round(highest / step).bit_length()
    steps = "" if step == 1 else f" in steps of {step:.6g} DN"
    note = f"{FOUND}: {held} pixels hold the highest code, {highest:g} DN, which is that of {bits} bits{steps}"
    return replace(stack, full_scale_dn=float(highest), notes=(*stack.notes, note))


def ends_at(highest: int, held: int) -> bool:
    """Whether the highest code in the data, in so many pixels, is the last one of a digitiser."""
    return highest.bit_length() >= LEAST_BITS and highest == 2 ** highest.bit_length() - 1 and held >= LEAST_PIXELS


def step_of(data: NDArray) -> float | None:
    """Return the step of the digitiser that all values are multiples of, in the data's unit; None: there is none.

    Notes
    -----
    Of whole numbers it is the largest power of 2 that divides them all. Of real numbers it is the least distance of
    two values of the first frame, if every distance is a multiple of it within their rounding; values without a
    digitiser have distances down to that rounding.
    """
    if data.dtype.kind in "ui":
        used = 0
        for block in blocks(data):
            used |= int(np.bitwise_or.reduce(block, axis=None))
        return float(used & -used) if used else None
    values = np.unique(np.asarray(data[0], np.float64))
    if values.size < 2 or not np.isfinite(values).all():
        return None
    rounding = float(np.finfo(data.dtype).eps * np.abs(values).max())
    distances = np.diff(values)
    distances = distances[distances > 4.0 * rounding]
    if not distances.size or (least := float(distances.min())) < 64.0 * rounding:
        return None
    # The least distance carries the rounding of two values; the whole range, in steps, does so once.
    step = float(np.ptp(values)) / round(float(np.ptp(values)) / least)
    off = np.abs(values - values[0] - step * np.rint((values - values[0]) / step))
    return step if off.max() <= 4.0 * rounding else None


def _highest(data: NDArray) -> tuple[float | int, int]:
    """Return the highest value and how many pixels hold it, in one pass."""
    highest, held = None, 0
    for block in blocks(data):
        top = block.max()
        if highest is None or top > highest:
            highest, held = top, 0
        held += int(np.count_nonzero(block == top)) if top == highest else 0
    return (0 if highest is None else highest.item()), held
