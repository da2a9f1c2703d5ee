"""The light of an edge's pixels: levels, what changes along the edge, what is left over, and defective pixels."""

from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from charact.mtf.edge.pixels.bins import BinnedPixels
from charact.mtf.edge.pixels.fields import steepness
from charact.mtf.mean_frame import OrientedFrame
from charact.robust import NORMAL, median

Array = NDArray[np.float64]

DEFECT_SD = 8.0
# A pixel off by less than this share of the step moves nothing, and bins of a steep edge leave as much over.
MIN_DEFECT = 0.02
# Share of the pixels beyond 5 standard deviations that are defects, not the tail of the noise, if any are.
HEAVY_TAIL = 0.5


def residual_of(picture: OrientedFrame, gathered: BinnedPixels) -> tuple[Array, Array]:
    """Return the picture less its own bin means, and the profile from 0 to 1, at every pixel.

    A bin's mean takes part of its pixels' noise with it; the residuals are enlarged for that.
    """
    mean, count = gathered.means(picture.value)
    level = _level(mean, count, gathered)
    lost = np.sqrt(count / np.maximum(count - 1.0, 0.5))
    value = (picture.value - _profile_at_pixels(mean, count, gathered)) * lost[gathered.bin_index]
    value = np.where(gathered.used, value, 0.0)
    return value, level


def _level(mean: Array, count: Array, gathered: BinnedPixels) -> Array:
    """Return the profile from 0 to 1 at every pixel."""
    dark, bright = levels_of(mean, count, gathered)
    return ((mean - dark) / (bright - dark if bright != dark else 1.0))[gathered.bin_index]


def span(picture: OrientedFrame, gathered: BinnedPixels) -> float:
    """Return the step between the outer halves of both sides, DN."""
    dark, bright = levels_of(*gathered.means(picture.value), gathered)
    return bright - dark


def _profile_at_pixels(mean: Array, count: Array, gathered: BinnedPixels) -> Array:
    """Return the profile at every pixel: its bin's mean, and its slope for the place within the bin."""
    filled, rise = count > 0, np.zeros_like(mean)
    if np.count_nonzero(filled) > 8:
        rise[filled] = steepness(gathered.place[filled], mean[filled], gathered.place[filled])
    return gathered.interpolate(mean, rise)


def remove_slope_along(picture: OrientedFrame, gathered: BinnedPixels) -> OrientedFrame:
    """Return the picture less the change of its light along the edge, of which a tilted window would make a slope."""
    mean, count = gathered.means(picture.value)
    level = _level(mean, count, gathered)
    slope = _slope_along(picture.value - _profile_at_pixels(mean, count, gathered), gathered, level)
    return replace(picture, value=picture.value - slope)


def remove_slope(value: Array, gathered: BinnedPixels, level: Array) -> Array:
    """Return residuals less an illumination slope along the edge, on both sides of it."""
    return np.where(gathered.used, value - _slope_along(value, gathered, level), value)


def _slope_along(value: Array, gathered: BinnedPixels, level: Array) -> Array:
    """Return the part of residuals that changes evenly along the edge, by its own amount on both sides of it.

    Pixels are compared with those at the same distance: what changes across the edge is the profile's.
    """
    along = gathered.along / max(float(np.abs(gathered.along).max()), 1.0)
    middle = gathered.means(along)[0]
    sides = _side_equations(value, along, level, gathered.used, gathered.bin_index, middle)
    bright, dark = np.linalg.lstsq(*sides, rcond=1e-9)[0]
    return along * (bright * level + dark * (1.0 - level))


@njit(cache=True)
def _side_equations(
    value: Array, along: Array, level: Array, used: NDArray[np.bool_], index: NDArray[np.int64], middle: Array
) -> tuple[Array, Array]:
    """Return the normal equations of values that change evenly along the edge, by their own amount on both sides."""
    normal, pull = np.zeros((2, 2)), np.zeros(2)
    for row in range(value.shape[0]):
        for col in range(value.shape[1]):
            if used[row, col]:
                within = along[row, col] - middle[index[row, col]]
                bright, dark = within * level[row, col], within * (1.0 - level[row, col])
                normal[0, 0] += bright * bright
                normal[0, 1] += bright * dark
                normal[1, 1] += dark * dark
                pull[0] += bright * value[row, col]
                pull[1] += dark * value[row, col]
    normal[1, 0] = normal[0, 1]
    return normal, pull


def levels_of(mean: Array, count: Array, gathered: BinnedPixels) -> tuple[float, float]:
    """Return dark and bright level: medians of the outer halves of both sides."""
    middle = 0.5 * (gathered.borders[1:] + gathered.borders[:-1])
    filled = count > 0
    left, right = middle < 0.5 * gathered.borders[0], middle > 0.5 * gathered.borders[-1]
    sides = (side if side.any() else filled for side in (filled & left, filled & right))
    dark, bright = (median(mean[side]) for side in sides)
    return dark, bright


def find_defects(residual: Array, level: Array, used: NDArray[np.bool_], rounding_sd: float) -> NDArray[np.bool_]:
    """Tell which pixels the noise of their level cannot explain; none in heavy-tailed noise, where many nearly are."""
    size = np.where(used, np.abs(residual), 0.0)
    sides = [used & (level < 0.25), used & (level > 0.75)]
    dark, bright = (_robust_sd(size[side if side.any() else used], rounding_sd) for side in sides)
    sd = np.sqrt(dark**2 + np.clip(level, 0.0, 1.0) * (bright**2 - dark**2))
    far, near = size > DEFECT_SD * sd, np.count_nonzero(size > 5.0 * sd)
    return far & (sd > 0) if np.count_nonzero(far) > HEAVY_TAIL * near else np.zeros_like(used)


def _robust_sd(size: Array, rounding_sd: float) -> float:
    """Return the standard deviation of normal noise whose absolute values have this median."""
    return max(NORMAL * median(size), rounding_sd)
