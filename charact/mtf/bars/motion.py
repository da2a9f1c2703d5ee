"""Bars that move across themselves from frame to frame."""

import numpy as np

from charact.mtf.bars.target import BarTarget
from charact.mtf.target_motion import TargetMotion, measure_line_motion
from labdata.frames import FrameStack

# How far beyond the outer bars pixels tell where they stand, periods.
BEYOND = 0.5


def measure_bar_motion(used: FrameStack, target: BarTarget) -> TargetMotion:
    """Return the motion of a target across its bars through a stack."""
    across, along = target.coordinates(used.data.shape[1:])
    inside = (np.abs(across) < target.width_px / 2.0 + BEYOND / target.frequency) & (
        np.abs(along) < target.length_px / 2.0
    )
    if not inside.any():
        return TargetMotion()
    line = np.floor(along).astype(np.int64)
    return measure_line_motion(list(used.data), across, line - line[inside].min(), inside)
