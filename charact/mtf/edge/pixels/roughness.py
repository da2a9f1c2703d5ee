"""Edge roughness: displacements of the rows, compared with those that noise alone causes.

The displacement of a row is a weighted sum of its pixels. The same weights, applied to the plateaus, give the
displacements by noise: temporal and fixed-pattern noise, correlated between rows or not.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from charact.mtf.edge.pixels.line import steepness
from charact.mtf.edge.pixels.profile import EdgeProfile
from charact.mtf.edge.thresholds import ACCURACY
from charact.mtf.mean_frame import OrientedFrame
from charact.mtf.quantisation_checks import QUANTISATION_DN2
from charact.mtf.target_motion import TargetMotion

Array = NDArray[np.float64]

# Step of the distances at which the profile's slope is tabulated, px.
STEP_PX = 0.25


def roughness_of(picture: OrientedFrame, profile: EdgeProfile) -> TargetMotion:
    """Return the deviation of an edge from a straight line along its length.

    Notes
    -----
    A row's displacement is least squares on -m'(d), m the edge's profile, its own level and contrast free. Noise half
    way up is taken as the mean of both sides', as that of light and of read-out are. The mean squares of displacements
    at the edge and on the plateaus are compared as Fisher's F.
    """
    from scipy.special import fdtrc

    # Pixels that locate the edge: they hold most of the squared slope.
    at = np.arange(0.0, ACCURACY.max_row_window_px, STEP_PX)
    steep = sum(steepness(profile.distance, profile.value, sign * at) ** 2 for sign in (-1.0, 1.0))
    held = np.cumsum(steep)
    reach = at[int(np.searchsorted(held, ACCURACY.slope_fraction * held[-1]))] + STEP_PX if held[-1] > 0 else 0.0
    reach = max(float(reach), ACCURACY.min_row_window_px)
    places, squares = _positions_of(picture, profile, reach)
    edge = places[:, 0]
    valid = np.flatnonzero(np.isfinite(edge))
    plateaus = [_plateau_scatter(side) for side in np.split(places[:, 1:], 2, axis=1)]
    if valid.size < 16 or min(one[1] for one in plateaus) < ACCURACY.min_plateau_positions:
        return TargetMotion()
    left = edge[valid] - np.polyval(np.polyfit(valid, edge[valid], 1), valid)
    # Of each pixel the profile holds as much as one of its bin's pixels weighs.
    own = float(np.mean(1.0 / profile.count[np.abs(profile.distance) < reach]))
    square = float(left @ left) / (valid.size - 2) / max(1.0 - own, 0.5)
    noise = 0.5 * sum(one[0] for one in plateaus) + _quantisation(picture, profile) * float(np.mean(squares[valid]))
    if not square > noise > 0:
        return TargetMotion()
    tied = 0.5 * sum(one[2] for one in plateaus)
    # Of a mean of two squares (Satterthwaite); windows that overlap by half count for half.
    freedom = 0.5 * 4.0 * noise**2 / sum(one[0] ** 2 * tied / one[1] for one in plateaus)
    chance = float(fdtrc(valid.size / tied, freedom, square / noise))
    return TargetMotion(rms_px=float(np.sqrt(square - noise)), chance=chance)


def _quantisation(picture: OrientedFrame, profile: EdgeProfile) -> float:
    """Return the mean square of the quantisation error in means of pixels at any level, DN^2.

    All pixels of a plateau have it alike; those near an edge differ. Sawtooth of `charact.mtf.quantisation_checks`.
    """
    if not picture.whole_codes:
        return 0.0
    sides = np.array([profile.grain.dark_variance, profile.grain.bright_variance])
    variance = np.maximum(sides * picture.frames - QUANTISATION_DN2, 0.0)
    turn = np.pi * np.arange(1, 7)[:, None]
    return float(np.mean(np.sum(np.exp(-4.0 * turn**2 * variance) / (2.0 * turn**2), axis=0)))


def _positions_of(picture: OrientedFrame, profile: EdgeProfile, reach: float) -> tuple[Array, Array]:
    """Return the rows' displacements at the edge, then in as many windows on its dark as on its bright side.

    Shape (row, 1 + window), px, NaN where a window is not whole; and the sum of squares of each row's weights.
    """
    gathered = profile.gathered
    distance = gathered.distance
    at = np.arange(-reach - 1.0, reach + 1.0 + STEP_PX, STEP_PX)
    residual = picture.value - np.interp(distance, profile.distance, profile.value)
    profile_at = np.interp(at, profile.distance, profile.value)
    steep = steepness(profile.distance, profile.value, at)
    step = reach / abs(profile.slopes[0])
    away = np.rint(np.arange(2.0 * step, max(picture.value.shape[1], 2.0 * step + 1.0), step)).astype(np.int64)
    shifts = np.concatenate([[0], -away, away])
    return _row_positions(residual, distance, gathered.used, reach, profile_at, steep, shifts)


@njit(cache=True)
def _row_positions(
    residual: Array, distance: Array, used: NDArray, reach: float, profile: Array, steep: Array, shifts: NDArray
) -> tuple[Array, Array]:
    """Return each row's displacement by the same weights at columns shifted, and the weights' sum of squares."""
    rows, cols = residual.shape
    places, squares = np.full((rows, shifts.size), np.nan), np.zeros(rows)
    middle = profile.mean()
    shape = np.zeros((cols, 3))
    for row in range(rows):
        normal, first, last = np.zeros((3, 3)), cols, -1
        for col in range(cols):
            if abs(distance[row, col]) >= reach:
                continue
            place = (distance[row, col] + reach + 1.0) / STEP_PX
            left = int(place)
            rest = place - left
            shape[col, 0] = steep[left] + rest * (steep[left + 1] - steep[left])
            shape[col, 1] = profile[left] + rest * (profile[left + 1] - profile[left]) - middle
            shape[col, 2] = 1.0
            first, last = min(first, col), col
            for k in range(3):
                for m in range(3):
                    normal[k, m] += shape[col, k] * shape[col, m]
        # A row locates the edge if its pixels lie on both sides of it up to the reach.
        if last - first < 4 or distance[row, first] > 1.0 - reach or distance[row, last] < reach - 1.0:
            continue
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        normal = normal / np.outer(scale, scale) + 1e-9 * np.eye(3)
        inverse = np.linalg.solve(normal, np.array([1.0, 0.0, 0.0])) / scale / scale[0]
        for one in range(shifts.size):
            shift = shifts[one]
            if first + shift < 0 or last + shift >= cols:
                continue
            total, whole = 0.0, True
            for col in range(first, last + 1):
                whole &= used[row, col + shift]
                weight = inverse[0] * shape[col, 0] + inverse[1] * shape[col, 1] + inverse[2] * shape[col, 2]
                total -= weight * residual[row, col + shift]
                squares[row] += weight**2 if one == 0 else 0.0
            if whole:
                places[row, one] = total
    return places, squares


def _plateau_scatter(places: Array) -> tuple[float, int, float]:
    """Return mean square and number of displacements on a plateau, shape (row, window), and their variance factor.

    The factor is by how much a mean square scatters more than that of as many independent normal displacements.
    """
    good = np.isfinite(places)
    count = np.count_nonzero(good, axis=0)
    places, good, count = places[:, count > 1], good[:, count > 1], count[count > 1]
    if not count.size:
        return 0.0, 0, 1.0
    values = np.where(good, places, 0.0)
    values = np.where(good, values - values.sum(axis=0) / count, 0.0)
    number = int(count.sum())
    square = float(np.sum(values**2)) / (number - count.size)
    if not square > 0:
        return 0.0, number, 1.0
    shared = [
        float(np.sum(values[lag:] * values[:-lag])) / max(np.count_nonzero(good[lag:] & good[:-lag]), 1) / square
        for lag in range(1, ACCURACY.roughness_lags + 1)
    ]
    heavy = max(float(np.sum(values**4)) / number / square**2 - 1.0, 2.0) / 2.0
    return square, number, heavy + 2.0 * float(np.sum(np.square(shared)))
