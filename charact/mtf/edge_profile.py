"""An edge's profile with the noise that is in it: bin means, their covariance, levels and shading."""

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from charact.mtf.bins import Gathered, gather
from charact.mtf.evidence import Evidence, evidence_of
from charact.mtf.grain import Grain, bin_covariance, grain_of
from charact.mtf.line import Line
from charact.mtf.picture import Picture
from charact.mtf.spread import edge_weights

Array = NDArray[np.float64]

# Share of the step in a pixel by which light slopes on either side: in a good set-up, a fair and a poor one.
EVEN_PER_PX, SLIGHT_PER_PX, UNEVEN_PER_PX = 4e-5, 3e-4, 2e-3
PLATEAU_FROM_PX = 10.0
SHADING_LENGTH_PX = 10.0
LEAST_SHADED_PX = 1.4 * SHADING_LENGTH_PX
DEFECT_SD = 8.0
# A pixel off by less than this share of the step moves nothing, and bins of a steep edge leave as much over.
LEAST_DEFECT = 0.02
# Share of the pixels beyond 5 standard deviations that are defects, not the tail of the noise, if any are.
HEAVY_TAIL = 0.5


@dataclass(frozen=True, kw_only=True)
class Profile:
    """A measured edge profile.

    Parameters
    ----------
    gathered
        Pixels and bins.
    distance, spread_px, value, count
        Mean distance, its standard deviation, mean value and count of the pixels of each bin that holds any,
        shape (bin,).
    keep
        Which bins of the band those are.
    dark, bright
        Levels of both sides at the edge, DN.
    grain
        Noise of the picture.
    covariance
        Of the bin means, shape (bin, bin), DN^2.
    shading_sd
        Standard deviation of slow undulations of the plateaus that the grain does not hold, DN.
    defects
        Pixels left out for values that the noise cannot explain.
    angle_rad, slopes
        Angle of the edge; change of distance with one column and one row, px.
    variance_floor
        Least variance of a pixel, DN^2: rounding to codes, and a ten-thousandth of the step.
    """

    gathered: Gathered
    distance: Array
    spread_px: Array
    value: Array
    count: Array
    keep: NDArray[np.bool_]
    dark: float
    bright: float
    grain: Grain
    covariance: Array
    shading_sd: float
    defects: int
    angle_rad: float
    slopes: tuple[float, float]
    variance_floor: float

    @property
    def step(self) -> float:
        """Height of the edge, DN."""
        return self.bright - self.dark

    def evidence(self, grid: Array, slope_sd_per_px: float) -> Evidence:
        """Return the evidence on nodes, both levels and an illumination slope on each side marginalised.

        Parameters
        ----------
        slope_sd_per_px
            Standard deviation of the slopes' prior, share of the step per px.
        """
        even, odd = edge_weights(grid, self.distance, self.spread_px)
        nuisance = np.stack(
            [np.ones_like(self.distance), np.maximum(self.distance, 0.0), np.minimum(self.distance, 0.0)], axis=1
        )
        scale = abs(self.step)
        prior = np.array([np.inf, slope_sd_per_px * scale, slope_sd_per_px * scale])
        return evidence_of(self.value, self.covariance, even, odd, nuisance, prior, scale)


def profile_of(picture: Picture, line: Line, half_width_px: float) -> Profile:
    """Gather the profile of an edge and estimate its noise from what the pixels leave over after it."""
    masked = np.zeros(picture.value.shape, bool)
    gathered = gather(picture, line, half_width_px, masked)
    picture = _even_along(picture, gathered)
    residual, level = _residual(picture, gathered)
    rounding_sd = 0.3 / np.sqrt(picture.frames) if picture.whole_codes else 0.0
    spread = np.abs(_span(picture, gathered))
    masked = _defective(residual, level, gathered.used, max(rounding_sd, LEAST_DEFECT * spread / DEFECT_SD))
    defects = int(masked.sum())
    if defects:
        gathered = gather(picture, line, half_width_px, masked)
        residual, level = _residual(picture, gathered)
    return _assembled(picture, line, gathered, residual, level, defects)


def centred(picture: Picture, line: Line) -> Line:
    """Return the line moved to where the profile is half way up, so that bins fall alike on both sides of the edge."""
    gathered = gather(picture, line, 16.0, np.zeros(picture.value.shape, bool))
    mean, count = gathered.means(picture.value)
    filled = count > 0
    distance, value = gathered.place[filled], mean[filled]
    dark, bright = _levels(mean, count, gathered)
    smooth = np.convolve(value, np.ones(9) / 9.0, "same")[4:-4]
    above = smooth > 0.5 * (dark + bright)
    place = distance[4:-4]
    rises = np.flatnonzero(np.diff(above.astype(int)) == 1)
    shift = float(np.median(place[rises])) if rises.size else 0.0
    if not np.isfinite(shift) or abs(shift) > 4.0:
        return line
    return replace(line, position=line.position + shift / float(np.cos(line.angle_rad(picture.pitch_ratio))))


def _residual(picture: Picture, gathered: Gathered) -> tuple[Array, Array]:
    """Return the picture less its own bin means, and the profile from 0 to 1, at every pixel.

    A bin's mean takes part of its pixels' noise with it; the residuals are enlarged for that.
    """
    mean, count = gathered.means(picture.value)
    level = _level(mean, count, gathered)
    lost = np.sqrt(count / np.maximum(count - 1.0, 0.5))
    value = (picture.value - _at_pixels(mean, count, gathered)) * lost[gathered.bin_index]
    value = np.where(gathered.used, value, 0.0)
    return value, level


def _level(mean: Array, count: Array, gathered: Gathered) -> Array:
    """Return the profile from 0 to 1 at every pixel."""
    dark, bright = _levels(mean, count, gathered)
    return ((mean - dark) / (bright - dark if bright != dark else 1.0))[gathered.bin_index]


def _span(picture: Picture, gathered: Gathered) -> float:
    """Return the step between the outer halves of both sides, DN."""
    dark, bright = _levels(*gathered.means(picture.value), gathered)
    return bright - dark


def _at_pixels(mean: Array, count: Array, gathered: Gathered) -> Array:
    """Return the profile at every pixel: its bin's mean, and its slope for the place within the bin."""
    filled, rise = count > 0, np.zeros_like(mean)
    if np.count_nonzero(filled) > 8:
        smooth = np.convolve(mean[filled], np.ones(3) / 3.0, "same")
        rise[filled] = np.gradient(smooth, gathered.place[filled])
        rise[:4] = rise[-4:] = 0.0
    return gathered.carried(mean, rise)


def _even_along(picture: Picture, gathered: Gathered) -> Picture:
    """Return the picture less the change of its light along the edge, of which a tilted window would make a slope."""
    mean, count = gathered.means(picture.value)
    level = _level(mean, count, gathered)
    slope = _slope_along(picture.value - _at_pixels(mean, count, gathered), gathered, level)
    return replace(picture, value=picture.value - slope)


def _without_slope(value: Array, gathered: Gathered, level: Array) -> Array:
    """Return residuals less an illumination slope along the edge, on both sides of it."""
    return np.where(gathered.used, value - _slope_along(value, gathered, level), value)


def _slope_along(value: Array, gathered: Gathered, level: Array) -> Array:
    """Return the part of residuals that changes evenly along the edge, by its own amount on both sides of it.

    Pixels are compared with those at the same distance: what changes across the edge is the profile's.
    """
    along = gathered.along / max(float(np.abs(gathered.along).max()), 1.0)
    middle = gathered.means(along)[0]
    sides = _both_sides(value, along, level, gathered.used, gathered.bin_index, middle)
    bright, dark = np.linalg.lstsq(*sides, rcond=1e-9)[0]
    return along * (bright * level + dark * (1.0 - level))


@njit(cache=True)
def _both_sides(
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


def _levels(mean: Array, count: Array, gathered: Gathered) -> tuple[float, float]:
    """Return dark and bright level: medians of the outer halves of both sides."""
    middle = 0.5 * (gathered.borders[1:] + gathered.borders[:-1])
    filled = count > 0
    left, right = middle < 0.5 * gathered.borders[0], middle > 0.5 * gathered.borders[-1]
    sides = (side if side.any() else filled for side in (filled & left, filled & right))
    dark, bright = (float(np.median(mean[side])) for side in sides)
    return dark, bright


def _defective(residual: Array, level: Array, used: NDArray[np.bool_], rounding_sd: float) -> NDArray[np.bool_]:
    """Tell which pixels the noise of their level cannot explain; none in heavy-tailed noise, where many nearly are."""
    size = np.where(used, np.abs(residual), 0.0)
    sides = [used & (level < 0.25), used & (level > 0.75)]
    dark, bright = (_robust_sd(size[side if side.any() else used], rounding_sd) for side in sides)
    sd = np.sqrt(dark**2 + np.clip(level, 0.0, 1.0) * (bright**2 - dark**2))
    far, near = size > DEFECT_SD * sd, np.count_nonzero(size > 5.0 * sd)
    return far & (sd > 0) if np.count_nonzero(far) > HEAVY_TAIL * near else np.zeros_like(used)


def _robust_sd(size: Array, rounding_sd: float) -> float:
    """Return the standard deviation of normal noise whose absolute values have this median."""
    return max(1.4826 * float(np.median(size)), rounding_sd)


def _assembled(
    picture: Picture, line: Line, gathered: Gathered, residual: Array, level: Array, defects: int
) -> Profile:
    """Return the profile of gathered pixels with the covariance of its bins."""
    mean, count = gathered.means(picture.value)
    distance = gathered.place
    square, _ = gathered.means(gathered.distance**2)
    keep = count >= 1
    dark, bright = _levels(mean, count, gathered)
    angle = line.angle_rad(picture.pitch_ratio)
    slopes = (float(np.cos(angle)), float(-line.slope * np.cos(angle)))
    rounding = 1.0 / (12.0 * picture.frames) if picture.whole_codes else 0.0
    floor = max(rounding, (3e-4 * (bright - dark)) ** 2, 1e-30)
    grain = grain_of(residual, level, gathered, floor)
    profile = Profile(
        gathered=gathered,
        distance=distance[keep],
        spread_px=np.sqrt(np.maximum(square - distance**2, 0.0))[keep],
        value=mean[keep],
        count=count[keep],
        keep=keep,
        dark=dark,
        bright=bright,
        grain=grain,
        covariance=np.eye(int(keep.sum())),
        shading_sd=0.0,
        defects=defects,
        angle_rad=angle,
        slopes=slopes,
        variance_floor=floor,
    )
    return with_grain(profile, grain)


def refined(profile: Profile, picture: Picture, model_value: Array) -> Profile:
    """Return the profile with its noise estimated anew from what the pixels leave over after a model's bin values.

    Parameters
    ----------
    model_value
        The model at every kept bin, shape (bin,), DN.
    """
    at_pixel = np.interp(profile.gathered.distance, profile.distance, model_value)
    level = (at_pixel - profile.dark) / profile.step
    value = np.where(profile.gathered.used, picture.value - at_pixel, 0.0)
    residual = _without_slope(value, profile.gathered, level)
    anew = with_grain(profile, grain_of(residual, level, profile.gathered, profile.variance_floor))
    return with_shading(anew, profile.value)


def with_grain(profile: Profile, grain: Grain) -> Profile:
    """Return the profile with another noise, its plateaus taken as even."""
    level = (profile.value - profile.dark) / (profile.step if profile.step != 0 else 1.0)
    covariance = bin_covariance(grain, profile.gathered, level, profile.count, profile.keep, profile.slopes)
    return replace(profile, grain=grain, covariance=covariance, shading_sd=0.0)


def with_shading(profile: Profile, left_over: Array) -> Profile:
    """Return the profile with slow undulations of its plateaus allowed for, as large as values left over show them.

    Parameters
    ----------
    left_over
        The bins' values, or what a model leaves of them, shape (bin,), DN.
    """
    bare = profile.covariance - _undulations(profile.distance, profile.shading_sd)
    shading = _shading(replace(profile, covariance=bare), left_over)
    return replace(profile, covariance=bare + _undulations(profile.distance, shading), shading_sd=shading)


def _undulations(place: Array, sd: float) -> Array | float:
    """Return the covariance of slow undulations at some places, shape (place, place); 0 where there are none."""
    if sd == 0:
        return 0.0
    return sd**2 * np.exp(-0.5 * ((place[:, None] - place) / SHADING_LENGTH_PX) ** 2)


def _shading(profile: Profile, left_over: Array) -> float:
    """Return the standard deviation by which the plateaus undulate beyond the noise of wide bins.

    In a plateau not much longer than an undulation all but a thousandth of it is bend, of which nothing is told.
    """
    excess, weight, scatter = 0.0, 0.0, 0.0
    for side in (profile.distance < -PLATEAU_FROM_PX, profile.distance > PLATEAU_FROM_PX):
        place = profile.distance[side]
        if place.size < 12 or np.ptp(place) < LEAST_SHADED_PX:
            continue
        design = np.stack([np.ones_like(place), place, place**2], axis=1)
        basis = np.linalg.qr(design)[0]
        project = np.eye(place.size) - basis @ basis.T
        left = project @ left_over[side]
        noise = project @ profile.covariance[np.ix_(side, side)] @ project
        excess += float(left @ left - np.trace(noise))
        scatter += 2.0 * float(np.sum(noise**2))
        weight += float(np.sum(project * _undulations(place, 1.0)))
    # The excess of plateaus without shading scatters by this much; only what stands out of it counts.
    return float(np.sqrt(excess / weight)) if excess > 3.0 * np.sqrt(scatter) else 0.0
