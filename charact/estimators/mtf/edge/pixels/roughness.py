"""Roughness of an edge: its deviation from a straight line beyond what noise alone causes."""

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.edge.pixels.line import displacement_weights, steepness
from charact.estimators.mtf.edge.pixels.profile import EdgeProfile
from charact.estimators.mtf.edge.thresholds import ACCURACY
from charact.estimators.mtf.mean_frame import OrientedFrame
from charact.estimators.mtf.target_motion import TargetMotion, f_tail
from charact.frames.rounding import QUANTISATION_DN2

Array = NDArray[np.float64]

# Step of the distances at which the profile's slope is tabulated, px.
STEP_PX = 0.25


def measure_roughness(picture: OrientedFrame, profile: EdgeProfile) -> TargetMotion:
    """Return the deviation of an edge from a straight line along its length, the same in all
    frames, beyond what noise alone causes.

    Notes
    -----
    d_row = -sum w (v - m), w = (X'X)^-1 X' of m': the displacement of a row is a weighted sum of
    its pixels v, least squares on -m'(d), m the edge's profile, its own level and contrast free
    (X = [m', m, 1]). The same weights, applied to the plateaus, give the displacements by noise:
    temporal and fixed-pattern noise, correlated between rows or not. Noise half way up is taken as
    the mean of both sides', as that of light and of read-out are. The mean squares of displacements
    at the edge and on the plateaus are compared as Fisher's F.
    """
    reach_px = _reach_px(profile)
    displacements, squares = _row_positions(picture.value, profile, reach_px)
    edge = displacements[:, 0]
    valid = np.flatnonzero(np.isfinite(edge))
    plateaus = [_plateau_scatter(side) for side in np.split(displacements[:, 1:], 2, axis=1)]
    if valid.size < 16 or min(plateau[1] for plateau in plateaus) < ACCURACY.min_plateau_positions:
        return TargetMotion()
    residuals = edge[valid] - np.polyval(np.polyfit(valid, edge[valid], 1), valid)
    # Of each pixel the profile holds as much as one of its bin's pixels weighs.
    in_profile = float(np.mean(1.0 / profile.count[np.abs(profile.distance) < reach_px]))
    square = float(residuals @ residuals) / (valid.size - 2) / max(1.0 - in_profile, 0.5)
    noise = 0.5 * sum(plateau[0] for plateau in plateaus)
    if picture.stack.holds_codes:
        # All pixels of a plateau have the same quantisation error; those near an edge differ: the
        # mean square of the sawtooth of `charact.frames.rounding` at any level, DN^2.
        sides = np.array(profile.side_variances)
        variance = np.maximum(sides * len(picture.stack.data) - QUANTISATION_DN2, 0.0)
        turn = np.pi * np.arange(1, 7)[:, None]
        quantisation = np.mean(np.sum(np.exp(-4.0 * turn**2 * variance) / (2.0 * turn**2), axis=0))
        noise += float(quantisation * np.mean(squares[valid]))
    if not square > noise > 0:
        return TargetMotion()
    variance_factor = 0.5 * sum(plateau[2] for plateau in plateaus)
    # Of a mean of two squares (Satterthwaite); windows that overlap by half count for half.
    freedom = (
        2.0 * noise**2 / sum(plateau[0] ** 2 * variance_factor / plateau[1] for plateau in plateaus)
    )
    chance = f_tail(valid.size / variance_factor, freedom, square / noise)
    return TargetMotion(rms_px=float(np.sqrt(square - noise)), chance=chance)


def _reach_px(profile: EdgeProfile) -> float:
    """Return the distance up to which pixels locate the edge: they hold most of the squared
    slope.
    """
    at = np.arange(0.0, ACCURACY.max_row_window_px, STEP_PX)
    steep = sum(steepness(profile.distance, profile.value, sign * at) ** 2 for sign in (-1.0, 1.0))
    slope_power = np.cumsum(steep)
    if not slope_power[-1] > 0:
        return ACCURACY.min_row_window_px
    cell = int(np.searchsorted(slope_power, ACCURACY.slope_fraction * slope_power[-1]))
    return max(float(at[cell] + STEP_PX), ACCURACY.min_row_window_px)


def _row_positions(value: Array, profile: EdgeProfile, reach_px: float) -> tuple[Array, Array]:
    """Return each row's displacement by the same weights at the edge and at windows on the dark and
    on the bright side, shape (row, 1 + 2 side), px, and the weights' sum of squares, shape (row,).

    NaN where a window is not whole.
    """
    distance, valid = profile.gathered.distance, profile.gathered.valid
    residual = value - np.interp(distance, profile.distance, profile.value)
    rows, cols = distance.shape
    # Pixels within reach of the edge: their first column in each row, and as many from there on as
    # the fullest row has.
    within = np.abs(distance) < reach_px
    first, count = np.argmax(within, axis=1), np.count_nonzero(within, axis=1)
    col = first[:, None] + np.arange(max(int(count.max()), 1))
    inside = col < (first + count)[:, None]
    near = np.take_along_axis(distance, np.minimum(col, cols - 1), 1)
    last = near[np.arange(rows), np.maximum(count - 1, 0)]
    # A row locates the edge if its pixels lie on both sides of it up to the reach.
    locates = (count > 4) & (near[:, 0] <= 1.0 - reach_px) & (last >= reach_px - 1.0)
    at = np.arange(-reach_px - 1.0, reach_px + 1.0 + STEP_PX, STEP_PX)
    profile_at = np.interp(at, profile.distance, profile.value)
    weight, _ = displacement_weights(
        np.interp(near, at, steepness(profile.distance, profile.value, at)),
        np.interp(near, at, profile_at - profile_at.mean()),
        inside,
    )
    # As many windows on the dark as on the bright side.
    step = reach_px / abs(profile.slopes[0])
    offsets = np.rint(np.arange(2.0 * step, max(cols, 2.0 * step + 1.0), step)).astype(np.int64)
    displacement = np.full((rows, 1 + 2 * offsets.size), np.nan)
    for window, shift in enumerate((0, *-offsets, *offsets)):
        shifted = np.clip(col + shift, 0, cols - 1)
        complete = locates & (first + shift >= 0) & (first + count + shift <= cols)
        complete &= (np.take_along_axis(valid, shifted, 1) | ~inside).all(axis=1)
        total = np.sum(weight * np.take_along_axis(residual, shifted, 1), axis=1)
        displacement[complete, window] = total[complete]
    return displacement, np.sum(weight**2, axis=1) * locates


def _plateau_scatter(displacements: Array) -> tuple[float, int, float]:
    """Return mean square and number of displacements on a plateau, shape (row, window), and their
    variance factor.

    The factor is by how much a mean square scatters more than that of as many independent normal
    displacements.
    """
    finite = np.isfinite(displacements)
    count = np.count_nonzero(finite, axis=0)
    displacements, finite, count = (
        displacements[:, count > 1],
        finite[:, count > 1],
        count[count > 1],
    )
    if not count.size:
        return 0.0, 0, 1.0
    values = np.where(finite, displacements, 0.0)
    values = np.where(finite, values - values.sum(axis=0) / count, 0.0)
    number = int(count.sum())
    square = float(np.sum(values**2)) / (number - count.size)
    if not square > 0:
        return 0.0, number, 1.0
    correlation = [
        float(np.sum(values[lag:] * values[:-lag]))
        / max(np.count_nonzero(finite[lag:] & finite[:-lag]), 1)
        / square
        for lag in range(1, ACCURACY.roughness_lags + 1)
    ]
    heavy = max(float(np.sum(values**4)) / number / square**2 - 1.0, 2.0) / 2.0
    return square, number, heavy + 2.0 * float(np.sum(np.square(correlation)))
