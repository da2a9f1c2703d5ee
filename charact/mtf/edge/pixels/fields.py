"""The two fields of an interlaced frame: how far an edge moved between them, so that each is taken at its own place."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from charact.mtf.edge.pixels.bins import bin_pixels
from charact.mtf.edge.pixels.line import EdgeLine, RowFit, refine
from charact.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.mtf.mean_frame import OrientedFrame
from charact.robust import median, robust_sd

Array = NDArray[np.float64]

# Rows of each field that tell where it is, and how far from the edge pixels tell it, px.
MIN_ROWS = 6
# Steps over which a profile's slope is estimated, px, and how many of them are averaged.
STEP_PX, SMOOTH_STEPS = 0.25, 5

# Displacement of the odd lines against the even ones, px, and its standard error.
Displacement = tuple[float, float]


def is_significant(displacement: Displacement) -> bool:
    """Tell whether fields lie apart by more than chance, and by enough to matter."""
    apart, error = displacement
    return bool(abs(apart) > max(THRESHOLDS.field_displacement_sd * error, THRESHOLDS.field_displacement_px))


def field_displacement_of_rows(picture: OrientedFrame, rows: RowFit) -> Displacement:
    """Return how far the edge lies elsewhere in odd lines of the frame, which are rows of the picture."""
    good = np.isfinite(rows.offset)
    odd = (picture.row_index[:, 0] % 2).astype(bool)
    if min(np.count_nonzero(good & odd), np.count_nonzero(good & ~odd)) < MIN_ROWS:
        return 0.0, np.inf
    one, other = rows.offset[good & odd], rows.offset[good & ~odd]
    error = 1.25 * np.hypot(robust_sd(one) / np.sqrt(one.size), robust_sd(other) / np.sqrt(other.size))
    return median(one) - median(other), float(error)


def steepness(place: Array, value: Array, distance: Array) -> Array:
    """Return the slope of a profile at distances, DN per px: over even steps, as its bins may lie close together.

    Zero within a pixel of its ends, and for a profile that is too short.
    """
    even = np.arange(place[0], place[-1], STEP_PX)
    if even.size < SMOOTH_STEPS + 6:
        return np.zeros_like(distance)
    smooth = np.convolve(np.interp(even, place, value), np.ones(SMOOTH_STEPS) / SMOOTH_STEPS, "valid")
    middle = even[SMOOTH_STEPS // 2 : -(SMOOTH_STEPS // 2)]
    return np.interp(distance, middle[2:-2], np.gradient(smooth, STEP_PX)[2:-2], left=0.0, right=0.0)


def field_displacement_of_pixels(
    line_parity: NDArray[np.int64], residual: Array, steep: Array, noise: float
) -> Displacement:
    """Return how far odd lines lie from even ones, which run along the edge, by least squares on single pixels.

    Parameters
    ----------
    line_parity
        0 or 1 for the field of every pixel, shape (pixel,).
    residual
        Pixels less their mean profile, shape (pixel,), DN.
    steep
        Slope of that profile, DN per px.
    noise
        Standard deviation of a pixel, DN.
    """
    shape = (0.5 - line_parity) * steep
    power = float(shape @ shape)
    if power <= 0 or line_parity.min() == line_parity.max():
        return 0.0, np.inf
    return float(shape @ residual) / power, noise / np.sqrt(power)


def separate_fields(picture: OrientedFrame, rows: RowFit) -> RowFit:
    """Return an edge whose two fields are taken each at its own place, where they lie apart."""
    moved = _field_displacement(picture, rows)
    if not is_significant(moved):
        return rows
    for _ in range(ACCURACY.field_iterations):
        apart = rows.line.fields_apart_px + moved[0]
        rows = refine(picture, replace(rows.line, fields_apart_px=apart, fields=picture.row_index % 2))
        moved = _field_displacement(picture, rows)
        if abs(moved[0]) < ACCURACY.field_tolerance_px:
            break
    return rows


def _field_displacement(picture: OrientedFrame, rows: RowFit) -> Displacement:
    return (
        _field_displacement_along(picture, rows.line)
        if picture.transposed
        else field_displacement_of_rows(picture, rows)
    )


def _field_displacement_along(picture: OrientedFrame, line: EdgeLine) -> Displacement:
    """Return how far fields lie apart whose lines run along the edge."""
    gathered = bin_pixels(picture, line, ACCURACY.field_band_px, np.zeros(picture.value.shape, bool))
    mean, count = gathered.means(picture.value)
    filled = count > 0
    place, value = gathered.place[filled], mean[filled]
    used = gathered.used
    residual = picture.value[used] - np.interp(gathered.distance[used], place, value)
    slopes = steepness(place, value, gathered.distance[used])
    # Distances grow along the picture's columns, so that an edge displaced by d stands at a distance of -d.
    found, error = field_displacement_of_pixels(picture.row_index[used] % 2, residual, slopes, float(np.std(residual)))
    return found / float(np.cos(line.angle_rad(picture.pitch_ratio))), error
