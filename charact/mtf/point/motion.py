"""Motion of a point source between the fields of a frame and through the stack."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SIGNIFICANT = 5.0
FIELDS_APART_PX, DRIFT_PX = 0.15, 0.3
# Light is followed within this distance of its middle, px, from this share of its height on.
NEAR_PX, HIGH = 5.0, 0.1
MIN_FRAMES = 4
# Light is all within this distance of its middle, px, also where it moves.
ALL_PX = 10.0
# Share by which motion from frame to frame may lower MTF50 untold, and probability of as much by chance.
SHAKEN, CHANCE = 0.01, 5e-4
# Median of chi squared of one degree of freedom.
CHI2_MEDIAN = 0.455


def motion_flags(frames: Array, x: Array, y: Array, parity: NDArray[np.bool_]) -> tuple[str, ...]:
    """Return `interlace-motion` for a displacement between fields, `drift` for one through the stack.

    Parameters
    ----------
    frames
        Light around the source above its background, shape (frame, row, col), DN.
    x, y
        Positions of columns and rows from the source, column pitches.
    parity
        Field of every row, shape (row,).
    """
    if len(frames) < MIN_FRAMES:
        return ()
    moves = _drifts(frames, x, y) or _shakes(frames, x, y)
    found = (("interlace-motion", _has_field_offset(frames, x, y, parity)), ("drift", moves))
    return tuple(name for name, seen in found if seen)


def _has_field_offset(frames: Array, x: Array, y: Array, parity: NDArray[np.bool_]) -> bool:
    """Return whether odd and even rows show the source in different columns."""
    near = (np.hypot(x[None, :], y[:, None]) < NEAR_PX) * frames
    centre, error = [], []
    for rows in (parity, ~parity):
        light, moment = near[:, rows].sum(axis=(1, 2)), (near * x)[:, rows].sum(axis=(1, 2))
        if light.mean() < SIGNIFICANT * light.std(ddof=1) / np.sqrt(len(light)):
            return False
        # The ratio of sums over frames: that of a single faint frame is unreliable.
        centre.append(moment.sum() / light.sum())
        off = moment - centre[-1] * light
        error.append(off.std(ddof=1) / np.sqrt(len(off)) / light.mean())
    return bool(abs(centre[0] - centre[1]) > max(SIGNIFICANT * float(np.hypot(*error)), FIELDS_APART_PX))


def _drifts(frames: Array, x: Array, y: Array) -> bool:
    """Return whether the source moves steadily along rows or columns."""
    time = np.linspace(-0.5, 0.5, len(frames))
    for place, _ in _places(frames, x, y):
        travel = float(time @ place / (time @ time))
        left = place - place.mean() - travel * time
        error = float(np.sqrt(left @ left / (len(frames) - 2) / (time @ time)))
        if abs(travel) > max(SIGNIFICANT * error, DRIFT_PX):
            return True
    return False


def _shakes(frames: Array, x: Array, y: Array) -> bool:
    """Return whether the source moves between frames beyond photon noise, and enough to matter.

    Notes
    -----
    Photons of a spot S scatter its position by at most a sum(w^2 S) / sum(w^2)^2, w its slope and a the variance of the
    total light over that light. Pulses wider than a pixel scatter it less (Jensen); lamp flicker raises the bound. The
    mean frame is blurred by the mean square displacement, which reduces MTF50 by half its ratio to that of the blur.
    """
    from scipy.special import fdtrc

    mean = frames.mean(axis=0)
    near = np.hypot(x[None, :], y[:, None]) < ALL_PX
    light, freedom = frames[:, near].sum(axis=1), len(frames) - 1
    if not light.mean() > 0:
        return False
    per_light = light.var(ddof=1) / light.mean()
    dark = 0.5 * float(np.median(np.diff(frames[:, ~near], axis=0) ** 2)) / CHI2_MEDIAN if not near.all() else 0.0
    area = light.mean() / max(float(mean.max()), 1e-300) * float(np.diff(x[:2])[0] * np.diff(y[:2])[0])
    for place, rise in _places(frames, x, y):
        power = float(np.sum(rise**2))
        if not power > 0:
            # Light in a single pixel: its position is undefined.
            continue
        noise = per_light * float(np.sum(rise**2 * np.maximum(mean, 0.0))) / power**2 + dark / power
        square = place.var(ddof=1)
        lowered = np.pi * (square - noise) / area
        if lowered > SHAKEN and fdtrc(freedom, freedom, square / max(noise, 1e-300)) < CHANCE:
            return True
    return False


def _places(frames: Array, x: Array, y: Array) -> list[tuple[Array, Array]]:
    """Return displacements of each frame along rows and columns, and the slopes used."""
    mean = frames.mean(axis=0)
    used = (np.hypot(x[None, :], y[:, None]) < NEAR_PX) & (mean > HIGH * mean.max())
    found = []
    for slope in (np.gradient(mean, x, axis=1), np.gradient(mean, y, axis=0)):
        rise = np.where(used, slope, 0.0)
        place = -np.sum((frames - mean) * rise, axis=(1, 2)) / max(float(np.sum(rise**2)), 1e-300)
        found.append((place, rise))
    return found
