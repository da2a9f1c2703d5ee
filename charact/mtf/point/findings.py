"""Findings of point sources: remedies, motion, undersampling."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from charact.mtf.point.source_window import Window
from charact.mtf.point.thresholds import ACCURACY, LIMITS
from labdata.flags import Finding
from labdata.measurement import Measurement

Array = NDArray[np.float64]

REMEDIES = {
    "clipped": "an offset that keeps the noise of dark pixels above 0 DN",
    "saturated": "less light or a shorter exposure, so that no pixel approaches full scale",
    "low-signal": "more light, a longer exposure or more frames",
    "model-misfit": "--roi around one source on a uniform background, focus, and no gamma or sharpening",
    "several-targets": "--roi around one source, or sources further apart",
    "window-too-small": "a larger --roi around the source",
    "prior-bound": "another focus or magnification, so that the spot is 1 to 10 px wide",
    "interlace-motion": "a stationary source and camera, or frames of one field",
    "drift": "a stationary source and camera, or fewer frames",
    "gamma": "frames with a linear response (gamma 1)",
    "aliased": "a spot blurred over more pixels: larger magnification or f-number",
    "not-converged": "another --seed",
}


# Median of chi squared of one degree of freedom.
CHI2_MEDIAN = 0.455


def finding(flag: str, effect: str) -> Finding:
    """Return the finding of a flag with its effect and remedy."""
    return Finding(flag=flag, effect=effect, remedy=REMEDIES[flag])


def motion_findings(names: tuple[str, ...]) -> list[Finding]:
    """Return the findings of motion flags."""

    lowered = f"MTF50 is lowered by {100.0 * LIMITS.max_motion_loss:g} % or more"
    effects = {
        "interlace-motion": f"the fields are displaced by at least {LIMITS.max_field_offset_px:g} px; {lowered}",
        "drift": f"the source moves by {LIMITS.max_drift_px:g} px over the frames, or moves between frames; {lowered}",
    }
    return [finding(name, effects[name]) for name in names]


def flag_undersampled(found: Iterable[Measurement], window: Window) -> tuple[Measurement, ...]:
    """Flag measurements of a spot as `aliased` where MTF50 may be too close to the sampling limit.

    Notes
    -----
    The position of the spot is fitted to first order. A spot of 0.15 px illuminates one pixel wherever it lies in it:
    MTF50 is 10 to 15 % low, and 30 % at the corner of four pixels.
    """
    numbers = tuple(found)
    step_px = {0.0: float(window.x[1] - window.x[0]), 90.0: float(window.y[1] - window.y[0])}
    sharp = any(
        one.quantity == "mtf50"
        and one.interval95 is not None
        and one.interval95[1] * step_px[one.orientation_deg or 0.0] > LIMITS.max_mtf50
        for one in numbers
    )
    if not sharp:
        return numbers
    effect = f"MTF50 may lie above {LIMITS.max_mtf50:g} cycles per sample, where it is measured 10 to 30 % low"
    return tuple(one.with_(findings=[finding("aliased", effect)]) for one in numbers)


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
    if len(frames) < ACCURACY.min_motion_frames:
        return ()
    moves = _drifts(frames, x, y) or _shakes(frames, x, y)
    found = (("interlace-motion", _has_field_offset(frames, x, y, parity)), ("drift", moves))
    return tuple(name for name, seen in found if seen)


def _has_field_offset(frames: Array, x: Array, y: Array, parity: NDArray[np.bool_]) -> bool:
    """Return whether odd and even rows show the source in different columns."""
    near = (np.hypot(x[None, :], y[:, None]) < ACCURACY.motion_radius_px) * frames
    centre, error = [], []
    for rows in (parity, ~parity):
        light, moment = near[:, rows].sum(axis=(1, 2)), (near * x)[:, rows].sum(axis=(1, 2))
        if light.mean() < LIMITS.motion_sd * light.std(ddof=1) / np.sqrt(len(light)):
            return False
        # The ratio of sums over frames: that of a single faint frame is unreliable.
        centre.append(moment.sum() / light.sum())
        off = moment - centre[-1] * light
        error.append(off.std(ddof=1) / np.sqrt(len(off)) / light.mean())
    return bool(
        abs(centre[0] - centre[1]) > max(LIMITS.motion_sd * float(np.hypot(*error)), LIMITS.max_field_offset_px)
    )


def _drifts(frames: Array, x: Array, y: Array) -> bool:
    """Return whether the source moves steadily along rows or columns."""
    time = np.linspace(-0.5, 0.5, len(frames))
    for position, _ in _places(frames, x, y):
        travel = float(time @ position / (time @ time))
        left = position - position.mean() - travel * time
        error = float(np.sqrt(left @ left / (len(frames) - 2) / (time @ time)))
        if abs(travel) > max(LIMITS.motion_sd * error, LIMITS.max_drift_px):
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
    near = np.hypot(x[None, :], y[:, None]) < ACCURACY.total_light_radius_px
    light, freedom = frames[:, near].sum(axis=1), len(frames) - 1
    if not light.mean() > 0:
        return False
    per_light = light.var(ddof=1) / light.mean()
    dark = 0.5 * float(np.median(np.diff(frames[:, ~near], axis=0) ** 2)) / CHI2_MEDIAN if not near.all() else 0.0
    area = light.mean() / max(float(mean.max()), 1e-300) * float(np.diff(x[:2])[0] * np.diff(y[:2])[0])
    for position, rise in _places(frames, x, y):
        power = float(np.sum(rise**2))
        if not power > 0:
            # Light in a single pixel: its position is undefined.
            continue
        noise = per_light * float(np.sum(rise**2 * np.maximum(mean, 0.0))) / power**2 + dark / power
        square = position.var(ddof=1)
        lowered = np.pi * (square - noise) / area
        if (
            lowered > LIMITS.max_motion_loss
            and fdtrc(freedom, freedom, square / max(noise, 1e-300)) < LIMITS.motion_p_value
        ):
            return True
    return False


def _places(frames: Array, x: Array, y: Array) -> list[tuple[Array, Array]]:
    """Return displacements of each frame along rows and columns, and the slopes used."""
    mean = frames.mean(axis=0)
    used = (np.hypot(x[None, :], y[:, None]) < ACCURACY.motion_radius_px) & (
        mean > ACCURACY.motion_min_height * mean.max()
    )
    found = []
    for slope in (np.gradient(mean, x, axis=1), np.gradient(mean, y, axis=0)):
        rise = np.where(used, slope, 0.0)
        position = -np.sum((frames - mean) * rise, axis=(1, 2)) / max(float(np.sum(rise**2)), 1e-300)
        found.append((position, rise))
    return found
