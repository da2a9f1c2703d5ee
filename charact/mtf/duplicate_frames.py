"""Removal of identical frames, which a stalled grabber delivers repeatedly."""

from collections import defaultdict
from dataclasses import replace

import numpy as np

from labdata.frames import FrameStack

# Rows of a frame by which it is looked up among those before it.
LOOKED_AT = 8


def drop_duplicate_frames(stack: FrameStack) -> FrameStack:
    """Return a stack without frames identical to an earlier one, with a note of their number.

    Noise never produces two identical frames. Identical frames would make the noise, estimated from frame differences,
    too small.
    """
    first = _distinct_indices(stack)
    frames = len(stack)
    if len(first) == frames:
        return stack
    if len(first) == 1:
        note = f"All {frames} frames are the same, code for code: they count as one."
    else:
        note = f"{frames - len(first)} of {frames} frames repeat an earlier one code for code and do not count."
    stamps = {name: getattr(stack, name)[first] for name in ("time_s", "frame_number") if getattr(stack, name).size}
    return replace(stack, data=stack.data[first], notes=(*stack.notes, note), **stamps)


def _distinct_indices(stack: FrameStack) -> list[int]:
    """Return the indices of the frames that equal none before them."""
    step = max(1, stack.shape[1] // LOOKED_AT)
    alike: dict[bytes, list[int]] = defaultdict(list)
    first = []
    for number, frame in enumerate(stack.data):
        before = alike[frame[::step].tobytes()]
        if not any(np.array_equal(frame, stack.data[one]) for one in before):
            before.append(number)
            first.append(number)
    return first
