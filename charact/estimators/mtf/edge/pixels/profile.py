"""Edge profile: pixels binned by their distance from the line, with the covariance of the bin
means.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.edge.pixels.bins import BinnedPixels, bin_pixels, coarsen
from charact.estimators.mtf.edge.pixels.line import EdgeLine, steepness
from charact.estimators.mtf.edge.pixels.noise_model import (
    bin_covariance,
    correlation_of,
)
from charact.estimators.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.estimators.mtf.mean_frame import OrientedFrame, usable_black_level
from charact.estimators.mtf.nonlinearity import contrast_of
from charact.frames.noise_law import NoiseLaw, fit_noise_law
from charact.frames.robust import median, robust_sd

Array = NDArray[np.float64]

DEFECT_SD = 8.0
# Slope of the illumination on either side, fraction of the step per px: in a good set-up, a fair
# and a poor one.
EVEN_PER_PX, SLIGHT_PER_PX, UNEVEN_PER_PX = 4e-5, 3e-4, 2e-3


def levels_of(mean: Array, count: Array, gathered: BinnedPixels) -> tuple[float, float]:
    """Return dark and bright level: medians of the outer halves of both sides."""
    middle = 0.5 * (gathered.borders[1:] + gathered.borders[:-1])
    filled = count > 0
    dark_half, bright_half = middle < 0.5 * gathered.borders[0], middle > 0.5 * gathered.borders[-1]
    sides = (side if side.any() else filled for side in (filled & dark_half, filled & bright_half))
    dark, bright = (median(mean[side]) for side in sides)
    return dark, bright


def _residual_of(
    value: Array, gathered: BinnedPixels, *, by_median: bool = False
) -> tuple[Array, Array, Array, float]:
    """Return the frame less its profile, the profile from 0 to 1 at every pixel, a factor of
    residuals, and the step.

    The profile is its bin's mean, with its slope for the position within the bin; by median one
    bright pixel does not make defects of all others in its bin. The factor restores the part of the
    noise that a bin's mean takes with it, and is 0 for pixels that are not used.
    """
    mean, count = gathered.medians(value) if by_median else gathered.means(value)
    dark, bright = levels_of(mean, count, gathered)
    index, filled, rise = gathered.bin_index, count > 0, np.zeros_like(mean)
    level = ((mean - dark) / (bright - dark if bright != dark else 1.0))[index]
    if np.count_nonzero(filled) > 8:
        rise[filled] = steepness(
            gathered.mean_distance[filled], mean[filled], gathered.mean_distance[filled]
        )
    residual = value - (
        mean[index] + rise[index] * (gathered.distance - gathered.mean_distance[index])
    )
    lost = np.where(gathered.valid, np.sqrt(count / np.maximum(count - 1.0, 0.5))[index], 0.0)
    return residual, level, lost, abs(bright - dark)


def _slope_along(value: Array, gathered: BinnedPixels, level: Array) -> Array:
    """Return the part of residuals that changes evenly along the edge, by its own amount on both
    sides of it.

    Pixels are compared with those at the same distance: what changes across the edge is the
    profile's.
    """
    along = gathered.along / max(float(np.abs(gathered.along).max()), 1.0)
    middle = gathered.means(along)[0]
    centred = np.where(gathered.valid, along - middle[gathered.bin_index], 0.0)
    sides = np.stack([(centred * level).ravel(), (centred * (1.0 - level)).ravel()])
    bright, dark = np.linalg.lstsq(sides @ sides.T, sides @ value.ravel(), rcond=1e-9)[0]
    return along * (bright * level + dark * (1.0 - level))


@dataclass(frozen=True, kw_only=True)
class EdgeProfile:
    """A measured edge profile.

    Parameters
    ----------
    gathered
        Pixels and bins.
    distance, spread_px, value, count
        Mean distance, its standard deviation, mean value and count of the pixels of each bin that
        holds any, shape (bin,).
    keep
        Which bins of the band those are.
    dark, bright, black
        Levels of both sides at the edge, and black level, DN; None: unknown.
    noise
        Noise of the frame against the height above the dark side, neighbours taken as independent.
    residual, level
        Frame less its profile, DN, and the profile from 0 to 1, shape (row, col).
    field_axis
        Axis of the frame along which two fields alternate; None: there are none.
    defects
        Number of pixels left out for values that the noise cannot explain.
    angle_rad, slopes
        Angle of the edge; change of distance with one column and one row, px.
    variance_floor
        Least variance of a pixel, DN^2: quantisation, and a ten-millionth of the squared step.
    shading_sd
        Standard deviation of slow undulations of the plateaus beyond the noise, DN.
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
    noise: NoiseLaw
    residual: Array
    level: Array
    field_axis: int | None
    defects: int
    angle_rad: float
    slopes: tuple[float, float]
    variance_floor: float
    shading_sd: float = 0.0

    @property
    def step(self) -> float:
        """Height of the edge, DN."""
        return self.bright - self.dark

    def noise_variance(self, level: Array | float) -> Array:
        """Return the variance of a pixel where the profile stands at a level between 0 and 1,
        DN^2.
        """
        return self.noise.variance(self.step * np.clip(level, 0.0, 1.0))

    @cached_property
    def side_variances(self) -> tuple[float, float]:
        """Variance of a pixel on the dark and on the bright side, DN^2."""
        dark, bright = self.noise_variance(np.array([0.0, 1.0])).tolist()
        return dark, bright

    @cached_property
    def correlated_noise(self) -> NoiseLaw:
        """Noise with the correlation of neighbours; quantisation does not correlate them."""
        if max(self.side_variances) <= 1.01 * self.variance_floor:
            return self.noise
        valid = self.gathered.valid
        standard = np.where(valid, self.residual / np.sqrt(self.noise_variance(self.level)), 0.0)
        correlation = correlation_of(standard, valid, self.slopes, self.field_axis)
        return self.noise.correlated(correlation)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the bin means by noise and shading, shape (bin, bin), DN^2."""
        covariance = bin_covariance(
            self.correlated_noise,
            self.gathered.borders,
            np.clip(self.value - self.dark, 0.0, max(self.step, 0.0)),
            self.count,
            self.keep,
            self.slopes,
        )
        if not self.shading_sd:
            return covariance
        return covariance + self.shading_sd**2 * undulation(self.distance)

    @property
    def contrast(self) -> float:
        """Contrast of both sides."""
        return contrast_of(self.dark, self.bright, self.black)

    @property
    def _is_one_light(self) -> bool:
        """Whether the black level tells that both sides slope as one light; else each side slopes
        by itself.
        """
        return self.black is not None and self.bright > max(self.dark, self.black)

    @cached_property
    def gradient_ways(self) -> Array:
        """Slopes of bright and dark side in the two ways in which light slopes, unit vectors, shape
        (way, side).

        Non-uniform lamps and lens shading multiply the light: sides a and b above black slope by
        the same fraction of a and of b.
        """
        if not self._is_one_light:
            return np.eye(2)
        bright, dark = self.bright - (self.black or 0.0), max(self.dark - (self.black or 0.0), 0.0)
        return np.array([[bright, dark], [-dark, bright]]) / np.hypot(bright, dark)

    @cached_property
    def levels(self) -> Array:
        """A level and the two ways in which light slopes at the bins, shape (bin, 3)."""
        sides = np.stack([np.maximum(self.distance, 0.0), np.minimum(self.distance, 0.0)], axis=1)
        return np.concatenate(
            [np.ones((self.distance.size, 1)), sides @ self.gradient_ways.T], axis=1
        )

    def slopes_sd(self, slope_sd_per_px: float) -> Array:
        """Return the standard deviations of the priors of the two ways in which light slopes, DN
        per px.

        Parameters
        ----------
        slope_sd_per_px
            That of the bright side's slope, fraction of the step per px.
        """
        unshared_sd = max(THRESHOLDS.gradient_asymmetry * slope_sd_per_px, EVEN_PER_PX)
        sd = (
            slope_sd_per_px / self.gradient_ways[0, 0],
            unshared_sd if self._is_one_light else slope_sd_per_px,
        )
        return np.array(sd) * max(abs(self.step), 1e-300)


def profile_of(
    picture: OrientedFrame, line: EdgeLine, half_width_px: float, *, quickly: bool = False
) -> EdgeProfile:
    """Bin the pixels of an edge and estimate its noise from the residuals of its profile.

    Parameters
    ----------
    half_width_px
        Half width of the band wanted.
    quickly
        Whether bins may be twice as wide where noise hides what narrow ones would show: a fit costs
        as their square.
    """
    gathered = bin_pixels(picture, line, half_width_px)
    # Light that changes along the edge makes a slope in a tilted window.
    residual, level, _, _ = _residual_of(picture.value, gathered)
    value = picture.value - _slope_along(residual, gathered, level)
    residual, level, lost, step = _residual_of(value, gathered)
    residual = residual * lost
    # Defects: pixels that the noise of their level cannot explain; none in heavy-tailed noise,
    # where many nearly are.
    size, valid = np.abs(residual), gathered.valid
    # Half of few codes may be one code: its noise is at least half a step.
    quantisation_sd = 0.5 / np.sqrt(len(picture.stack.data)) if picture.stack.holds_codes else 0.0
    least_sd = max(quantisation_sd, THRESHOLDS.min_defect * step / DEFECT_SD)
    sides = (
        side if side.any() else valid for side in (valid & (level < 0.25), valid & (level > 0.75))
    )
    dark_sd, bright_sd = (max(robust_sd(size[side], 0.0), least_sd) for side in sides)
    size = np.abs(_residual_of(value, gathered, by_median=True)[0])
    sd = np.sqrt(dark_sd**2 + np.clip(level, 0.0, 1.0) * (bright_sd**2 - dark_sd**2))
    masked = valid & (size > DEFECT_SD * sd) & (sd > 0)
    # Many of one bin are its edge, as where two fields are displaced.
    fraction, _ = gathered.means(masked.astype(float))
    masked &= fraction[gathered.bin_index] < THRESHOLDS.defects_of_bin
    heavy_tailed = np.count_nonzero(valid & (size > 5.0 * sd))
    defects = int(np.count_nonzero(masked))
    if defects <= THRESHOLDS.defect_fraction * heavy_tailed:
        defects = 0
    if defects:
        gathered = bin_pixels(picture, line, half_width_px, masked)
        residual, level, lost, _ = _residual_of(value, gathered)
        residual = residual * lost
    if quickly and step < THRESHOLDS.noisy_step_sd * np.std(residual[gathered.valid]):
        gathered = coarsen(gathered)
    mean, count = gathered.means(value)
    distance, (square, _) = gathered.mean_distance, gathered.means(gathered.distance**2)
    keep = count >= 1
    dark, bright = levels_of(mean, count, gathered)
    angle = line.angle_rad(picture.pitch_ratio)
    slopes = float(np.cos(angle)), float(-line.slope * np.cos(angle))
    quantisation = 1.0 / (12.0 * len(picture.stack.data)) if picture.stack.holds_codes else 0.0
    floor = max(quantisation, (3e-4 * (bright - dark)) ** 2, 1e-30)
    return EdgeProfile(
        gathered=gathered,
        distance=distance[keep],
        spread_px=np.sqrt(np.maximum(square - distance**2, 0.0))[keep],
        value=mean[keep],
        count=count[keep],
        keep=keep,
        dark=dark,
        bright=bright,
        black=usable_black_level(picture.stack.frames.black_level_dn, dark, bright),
        noise=fit_noise_law(
            level[gathered.valid] * (bright - dark),
            residual[gathered.valid] ** 2,
            bright - dark,
            floor,
        ),
        residual=residual,
        level=level,
        field_axis=int(picture.transposed) if picture.stack.interlaced else None,
        defects=defects,
        angle_rad=angle,
        slopes=slopes,
        variance_floor=floor,
    )


def centre_line(picture: OrientedFrame, line: EdgeLine) -> EdgeLine:
    """Return the line moved to where the profile is half way up, so that bins fall alike on both
    sides of the edge.
    """
    gathered = bin_pixels(picture, line, 16.0)
    mean, count = gathered.means(picture.value)
    filled = count > 0
    dark, bright = levels_of(mean, count, gathered)
    smooth = np.convolve(mean[filled], np.ones(9) / 9.0, "same")[4:-4]
    is_bright = smooth > 0.5 * (dark + bright)
    rises = np.flatnonzero(np.diff(is_bright.astype(int)) == 1)
    shift = median(gathered.mean_distance[filled][4:-4][rises]) if rises.size else 0.0
    if not np.isfinite(shift) or abs(shift) > 4.0:
        return line
    return replace(
        line, position=line.position + shift / float(np.cos(line.angle_rad(picture.pitch_ratio)))
    )


def refine_noise(profile: EdgeProfile, picture: OrientedFrame, model_value: Array) -> EdgeProfile:
    """Return the profile with its noise estimated anew from the residuals of a model's bin values,
    shape (bin,), DN.
    """
    gathered = profile.gathered
    at_pixel = np.interp(gathered.distance, profile.distance, model_value)
    level = (at_pixel - profile.dark) / profile.step
    value = np.where(gathered.valid, picture.value - at_pixel, 0.0)
    residual = np.where(gathered.valid, value - _slope_along(value, gathered, level), value)
    height, square = level[gathered.valid] * profile.step, residual[gathered.valid] ** 2
    noise = fit_noise_law(height, square, profile.step, profile.variance_floor)
    changed = replace(profile, noise=noise, residual=residual, level=level, shading_sd=0.0)
    return with_shading(changed, profile.value)


def undulation(distance: Array) -> Array:
    """Return the correlation of shading, exp(-(d - d')^2 / (2 l^2)), shape (bin, bin)."""
    apart_px = distance[:, None] - distance
    return np.exp(-0.5 * (apart_px / ACCURACY.shading_length_px) ** 2)


def with_shading(profile: EdgeProfile, left_over: Array) -> EdgeProfile:
    """Return a profile without shading with the slow undulations of its plateaus allowed for, as
    large as residuals show them.

    A plateau not much longer than the correlation length is fitted by a parabola within a
    thousandth: no estimate.

    Parameters
    ----------
    left_over
        The bins' values, or their residuals of a model, shape (bin,), DN.
    """
    distance, excess, weight, scatter = profile.distance, 0.0, 0.0, 0.0
    for side in (distance < -ACCURACY.plateau_from_px, distance > ACCURACY.plateau_from_px):
        plateau = distance[side]
        if plateau.size < 12 or np.ptp(plateau) < 1.4 * ACCURACY.shading_length_px:
            continue
        basis = np.linalg.qr(np.stack([np.ones_like(plateau), plateau, plateau**2], axis=1))[0]
        noise, shading = profile.covariance[np.ix_(side, side)], undulation(plateau)
        # Of the residuals of values, noise and undulations after the bend I - B B^T: squares and
        # traces.
        across = noise @ basis
        noise_in_basis = basis.T @ across
        bend = basis.T @ left_over[side]
        excess += float(
            left_over[side] @ left_over[side]
            - bend @ bend
            - np.trace(noise)
            + np.trace(noise_in_basis)
        )
        scatter += 2.0 * float(
            np.sum(noise**2) - 2.0 * np.sum(across**2) + np.sum(noise_in_basis**2)
        )
        weight += float(np.trace(shading) - np.sum(basis * (shading @ basis)))
    # The excess of plateaus without shading scatters by this much; only what stands out of it
    # counts.
    shading_sd = float(np.sqrt(excess / weight)) if excess > 3.0 * np.sqrt(scatter) else 0.0
    return replace(profile, shading_sd=shading_sd) if shading_sd else profile
