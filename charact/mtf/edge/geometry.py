"""Directions: what an angle in an upright picture is in the frame."""

import numpy as np

from charact.mtf.mean_frame import OrientedFrame


def orientation_deg(picture: OrientedFrame, angle_rad: float) -> float:
    """Return the direction of the edge's normal from the row direction, degrees in [0, 180)."""
    tilt = float(np.rad2deg(angle_rad))
    # Upright, the normal stands at -tilt to the columns' direction; mirrored it is turned over, transposed exchanged.
    tilt = tilt if picture.mirrored else -tilt
    return (90.0 - tilt if picture.transposed else tilt) % 180.0
