"""What moved while a point source was taken: between the fields of a frame, and through the stack."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SIGNIFICANT = 5.0
FIELDS_APART_PX, DRIFT_PX = 0.15, 0.3
# Light is followed within this distance of its middle, px, from this share of its height on.
NEAR_PX, HIGH = 5.0, 0.1
LEAST_FRAMES = 4


def motion_flags(frames: Array, x: Array, y: Array, parity: NDArray[np.bool_]) -> tuple[str, ...]:
    """Return `interlace-motion` where the fields disagree about the source's column, `drift` where it wanders.

    Parameters
    ----------
    frames
        Light around the source above its background, shape (frame, row, col), DN.
    x, y
        Places of columns and rows from the source, column pitches.
    parity
        Field of every row, shape (row,).
    """
    if len(frames) < LEAST_FRAMES:
        return ()
    found = (("interlace-motion", _fields_apart(frames, x, y, parity)), ("drift", _wanders(frames, x, y)))
    return tuple(name for name, seen in found if seen)


def _fields_apart(frames: Array, x: Array, y: Array, parity: NDArray[np.bool_]) -> bool:
    """Tell whether the light of odd rows stands in other columns than that of even ones."""
    near = (np.hypot(x[None, :], y[:, None]) < NEAR_PX) * frames
    centre, error = [], []
    for rows in (parity, ~parity):
        light, moment = near[:, rows].sum(axis=(1, 2)), (near * x)[:, rows].sum(axis=(1, 2))
        if light.mean() < SIGNIFICANT * light.std(ddof=1) / np.sqrt(len(light)):
            return False
        # The quotient of the sums over frames: that of a single faint frame may be anything.
        centre.append(moment.sum() / light.sum())
        off = moment - centre[-1] * light
        error.append(off.std(ddof=1) / np.sqrt(len(off)) / light.mean())
    return bool(abs(centre[0] - centre[1]) > max(SIGNIFICANT * float(np.hypot(*error)), FIELDS_APART_PX))


def _wanders(frames: Array, x: Array, y: Array) -> bool:
    """Tell whether the light moves steadily along rows or columns from frame to frame."""
    mean = frames.mean(axis=0)
    used = (np.hypot(x[None, :], y[:, None]) < NEAR_PX) & (mean > HIGH * mean.max())
    time = np.linspace(-0.5, 0.5, len(frames))
    for slope in (np.gradient(mean, x, axis=1), np.gradient(mean, y, axis=0)):
        rise = np.where(used, slope, 0.0)
        place = -np.sum((frames - mean) * rise, axis=(1, 2)) / max(float(np.sum(rise**2)), 1e-300)
        travel = float(time @ place / (time @ time))
        left = place - place.mean() - travel * time
        error = float(np.sqrt(left @ left / (len(frames) - 2) / (time @ time)))
        if abs(travel) > max(SIGNIFICANT * error, DRIFT_PX):
            return True
    return False
