"""An edge's profile with the noise that is in it: bin means, their covariance, levels and shading."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from charact.mtf.edge.fit.esf_from_mtf import edge_weights
from charact.mtf.edge.fit.sufficient_statistics import ProfileStatistics, profile_statistics
from charact.mtf.edge.pixels.bins import BinnedPixels, bin_pixels, coarsen
from charact.mtf.edge.pixels.fields import steepness
from charact.mtf.edge.pixels.line import EdgeLine
from charact.mtf.edge.pixels.noise_model import EdgeNoiseModel, bin_covariance, estimate_edge_noise
from charact.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.mtf.mean_frame import OrientedFrame
from charact.mtf.nonlinearity import usable_black_level
from charact.robust import NORMAL, median

Array = NDArray[np.float64]

DEFECT_SD = 8.0


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
    return far & (sd > 0) if np.count_nonzero(far) > THRESHOLDS.defect_fraction * near else np.zeros_like(used)


def _robust_sd(size: Array, rounding_sd: float) -> float:
    """Return the standard deviation of normal noise whose absolute values have this median."""
    return max(NORMAL * median(size), rounding_sd)


# Share of the step in a pixel by which light slopes on either side: in a good set-up, a fair and a poor one.
EVEN_PER_PX, SLIGHT_PER_PX, UNEVEN_PER_PX = 4e-5, 3e-4, 2e-3


@dataclass(frozen=True, kw_only=True)
class IlluminationGradient:
    """The two ways in which the light of an edge slopes.

    Parameters
    ----------
    ways
        Slopes of bright and dark side in each way, unit vectors, shape (way, side).
    together
        Whether the first way is that of one light on both sides; otherwise each side slopes by itself.
    """

    ways: Array
    together: bool

    def levels(self, distance_px: Array) -> Array:
        """Return a level and both ways of slopes at distances from the edge, shape (distance, 3), px."""
        sides = np.stack([np.maximum(distance_px, 0.0), np.minimum(distance_px, 0.0)], axis=1)
        return np.concatenate([np.ones((distance_px.size, 1)), sides @ self.ways.T], axis=1)

    def slopes_sd(self, slope_sd_per_px: float) -> Array:
        """Return the deviations of the priors of both ways from that of the bright side's slope, in its unit."""
        apart = max(THRESHOLDS.gradient_asymmetry * slope_sd_per_px, EVEN_PER_PX) if self.together else slope_sd_per_px
        return np.array([slope_sd_per_px / self.ways[0, 0], apart])

    def by_side(self, amplitude: Array) -> Array:
        """Return amplitudes that end with the slopes of bright and dark side for those that end with both ways'."""
        return np.concatenate([amplitude[:-2], amplitude[-2:] @ self.ways])


def uneven_light(dark_dn: float, bright_dn: float, black_dn: float | None) -> IlluminationGradient:
    """Return how light slopes on an edge between two levels.

    Parameters
    ----------
    black_dn
        Code at no light, as `believed_black` gives it; None: not known, and with it how much light either side gets.

    Notes
    -----
    Non-uniform lamps and lens shading multiply the light: sides a and b above black slope by the same fraction of a and
    of b.
    """
    if black_dn is None or not bright_dn > max(dark_dn, black_dn):
        return IlluminationGradient(ways=np.eye(2), together=False)
    bright, dark = bright_dn - black_dn, max(dark_dn - black_dn, 0.0)
    return IlluminationGradient(
        ways=np.array([[bright, dark], [-dark, bright]]) / np.hypot(bright, dark), together=True
    )


MIN_SHADED_PX = 1.4 * ACCURACY.shading_length_px


@dataclass(frozen=True, kw_only=True)
class EdgeProfile:
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
    black
        Code at no light, DN; None: not known.
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

    gathered: BinnedPixels
    distance: Array
    spread_px: Array
    value: Array
    count: Array
    keep: NDArray[np.bool_]
    dark: float
    bright: float
    black: float | None
    grain: EdgeNoiseModel
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

    @cached_property
    def light(self) -> IlluminationGradient:
        """How light may slope."""
        return uneven_light(self.dark, self.bright, self.black)

    @cached_property
    def levels(self) -> Array:
        """A level and the two ways in which light slopes at the bins, shape (bin, 3)."""
        return self.light.levels(self.distance)

    def slopes_sd(self, slope_sd_per_px: float) -> Array:
        """Return the deviations of the priors of the two ways in which light slopes, DN per px.

        Parameters
        ----------
        slope_sd_per_px
            Standard deviation of the prior of the bright side's slope, share of the step per px.
        """
        return self.light.slopes_sd(slope_sd_per_px) * max(abs(self.step), 1e-300)

    def evidence(self, grid: Array, slope_sd_per_px: float) -> ProfileStatistics:
        """Return the evidence on nodes, level, step and the slopes of the light marginalised.

        Parameters
        ----------
        slope_sd_per_px
            As of `slopes_sd`.
        """
        spread = np.concatenate(edge_weights(grid, self.distance, self.spread_px), axis=1)
        prior = np.array([np.inf, *self.slopes_sd(slope_sd_per_px)])
        return profile_statistics(self.value, self.covariance, spread, self.levels, prior, abs(self.step))


def profile_of(picture: OrientedFrame, line: EdgeLine, half_width_px: float, *, quickly: bool = False) -> EdgeProfile:
    """Gather the profile of an edge and estimate its noise from what the pixels leave over after it.

    Parameters
    ----------
    half_width_px
        Half width of the band wanted.
    quickly
        Whether bins may be twice as wide where noise hides what narrow ones would tell: a fit costs as their square.
    """
    masked = np.zeros(picture.value.shape, bool)
    gathered = bin_pixels(picture, line, half_width_px, masked)
    picture = remove_slope_along(picture, gathered)
    residual, level = residual_of(picture, gathered)
    rounding_sd = 0.3 / np.sqrt(picture.frames) if picture.whole_codes else 0.0
    spread = abs(span(picture, gathered))
    masked = find_defects(residual, level, gathered.used, max(rounding_sd, THRESHOLDS.min_defect * spread / DEFECT_SD))
    defects = int(masked.sum())
    if defects:
        gathered = bin_pixels(picture, line, half_width_px, masked)
        residual, level = residual_of(picture, gathered)
    if quickly and spread < THRESHOLDS.noisy_step_sd * np.std(residual[gathered.used]):
        gathered = coarsen(gathered)
    return _assemble(picture, line, gathered, residual, level, defects)


def centre_line(picture: OrientedFrame, line: EdgeLine) -> EdgeLine:
    """Return the line moved to where the profile is half way up, so that bins fall alike on both sides of the edge."""
    gathered = bin_pixels(picture, line, 16.0, np.zeros(picture.value.shape, bool))
    mean, count = gathered.means(picture.value)
    filled = count > 0
    distance, value = gathered.place[filled], mean[filled]
    dark, bright = levels_of(mean, count, gathered)
    smooth = np.convolve(value, np.ones(9) / 9.0, "same")[4:-4]
    above = smooth > 0.5 * (dark + bright)
    place = distance[4:-4]
    rises = np.flatnonzero(np.diff(above.astype(int)) == 1)
    shift = median(place[rises]) if rises.size else 0.0
    if not np.isfinite(shift) or abs(shift) > 4.0:
        return line
    return replace(line, position=line.position + shift / float(np.cos(line.angle_rad(picture.pitch_ratio))))


def _assemble(
    picture: OrientedFrame, line: EdgeLine, gathered: BinnedPixels, residual: Array, level: Array, defects: int
) -> EdgeProfile:
    """Return the profile of gathered pixels with the covariance of its bins."""
    mean, count = gathered.means(picture.value)
    distance = gathered.place
    square, _ = gathered.means(gathered.distance**2)
    keep = count >= 1
    dark, bright = levels_of(mean, count, gathered)
    angle = line.angle_rad(picture.pitch_ratio)
    slopes = (float(np.cos(angle)), float(-line.slope * np.cos(angle)))
    rounding = 1.0 / (12.0 * picture.frames) if picture.whole_codes else 0.0
    floor = max(rounding, (3e-4 * (bright - dark)) ** 2, 1e-30)
    grain = estimate_edge_noise(residual, level, gathered, floor, picture.field_axis)
    profile = EdgeProfile(
        gathered=gathered,
        distance=distance[keep],
        spread_px=np.sqrt(np.maximum(square - distance**2, 0.0))[keep],
        value=mean[keep],
        count=count[keep],
        keep=keep,
        dark=dark,
        bright=bright,
        black=usable_black_level(picture.black_dn, dark, bright),
        grain=grain,
        covariance=np.eye(int(keep.sum())),
        shading_sd=0.0,
        defects=defects,
        angle_rad=angle,
        slopes=slopes,
        variance_floor=floor,
    )
    return with_noise(profile, grain)


def refine_noise(profile: EdgeProfile, picture: OrientedFrame, model_value: Array) -> EdgeProfile:
    """Return the profile with its noise estimated anew from what the pixels leave over after a model's bin values.

    Parameters
    ----------
    model_value
        The model at every kept bin, shape (bin,), DN.
    """
    at_pixel = np.interp(profile.gathered.distance, profile.distance, model_value)
    level = (at_pixel - profile.dark) / profile.step
    value = np.where(profile.gathered.used, picture.value - at_pixel, 0.0)
    residual = remove_slope(value, profile.gathered, level)
    grain = estimate_edge_noise(residual, level, profile.gathered, profile.variance_floor, picture.field_axis)
    anew = with_noise(profile, grain)
    return with_shading(anew, profile.value)


def with_noise(profile: EdgeProfile, grain: EdgeNoiseModel) -> EdgeProfile:
    """Return the profile with another noise, its plateaus taken as even."""
    level = (profile.value - profile.dark) / (profile.step if profile.step != 0 else 1.0)
    covariance = bin_covariance(grain, profile.gathered, level, profile.count, profile.keep, profile.slopes)
    return replace(profile, grain=grain, covariance=covariance, shading_sd=0.0)


def with_shading(profile: EdgeProfile, left_over: Array) -> EdgeProfile:
    """Return the profile with slow undulations of its plateaus allowed for, as large as values left over show them.

    Parameters
    ----------
    left_over
        The bins' values, or what a model leaves of them, shape (bin,), DN.
    """
    bare = profile.covariance - _shading_covariance(profile.distance, profile.shading_sd)
    shading = _shading_sd(replace(profile, covariance=bare), left_over)
    return replace(profile, covariance=bare + _shading_covariance(profile.distance, shading), shading_sd=shading)


def _shading_covariance(place: Array, sd: float) -> Array | float:
    """Return the covariance of slow undulations at some places, shape (place, place); 0 where there are none."""
    if sd == 0:
        return 0.0
    return sd**2 * np.exp(-0.5 * ((place[:, None] - place) / ACCURACY.shading_length_px) ** 2)


def _shading_sd(profile: EdgeProfile, left_over: Array) -> float:
    """Return the standard deviation by which the plateaus undulate beyond the noise of wide bins.

    A plateau not much longer than the correlation length is fitted by a parabola within a thousandth: no estimate.
    """
    excess, weight, scatter = 0.0, 0.0, 0.0
    for side in (profile.distance < -ACCURACY.plateau_from_px, profile.distance > ACCURACY.plateau_from_px):
        place = profile.distance[side]
        if place.size < 12 or np.ptp(place) < MIN_SHADED_PX:
            continue
        basis = np.linalg.qr(np.stack([np.ones_like(place), place, place**2], axis=1))[0]
        noise, even = profile.covariance[np.ix_(side, side)], _shading_covariance(place, 1.0)
        # Of what is left of values, noise and undulations after the bend I - B B^T: squares and traces.
        across = noise @ basis
        within = basis.T @ across
        bend = basis.T @ left_over[side]
        excess += float(left_over[side] @ left_over[side] - bend @ bend - np.trace(noise) + np.trace(within))
        scatter += 2.0 * float(np.sum(noise**2) - 2.0 * np.sum(across**2) + np.sum(within**2))
        weight += float(np.trace(even) - np.sum(basis * (even @ basis)))
    # The excess of plateaus without shading scatters by this much; only what stands out of it counts.
    return float(np.sqrt(excess / weight)) if excess > 3.0 * np.sqrt(scatter) else 0.0
