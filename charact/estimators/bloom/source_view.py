"""Mean frame around a source: rings and sectors, pixel noise and background."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.frames.noise_law import NoiseLaw
from charact.frames.robust import robust_sd
from charact.frames.rounding import QUANTISATION_DN2
from charact.frames.stack import Stack
from labdata import Array, Mask

# Sectors of the full circle.
SECTORS = 24


@dataclass(frozen=True, kw_only=True)
class Polar:
    """Polar coordinates of the pixels around a source.

    `dx`, `dy`: distances from the source along rows and columns, column pitches, shape (row, col);
    `radius`: distance, column pitches, shape (row, col); `ring`, `sector`: index of the ring, one
    column pitch wide, and of the sector, shape (row, col); `row_pitch`: row pitch over column
    pitch.
    """

    dx: Array
    dy: Array
    radius: Array
    ring: NDArray[np.intp]
    sector: NDArray[np.intp]
    row_pitch: float

    @property
    def rings(self) -> int:
        """Number of rings, including those that cross the border."""
        return int(self.ring.max()) + 1


def polar_of(shape: tuple[int, int], row: float, col: float, row_pitch: float) -> Polar:
    """Return the polar coordinates of the pixels of a frame around (row, col)."""
    down = (np.arange(shape[0]) - row)[:, None] * row_pitch
    dx, dy = np.broadcast_arrays((np.arange(shape[1]) - col)[None, :], down)
    radius = np.hypot(dx, dy)
    sector = ((np.arctan2(dy, dx) / (2 * np.pi) + 0.5) * SECTORS).astype(np.intp) % SECTORS
    return Polar(
        dx=dx, dy=dy, radius=radius, ring=radius.astype(np.intp), sector=sector, row_pitch=row_pitch
    )


@dataclass(frozen=True, kw_only=True)
class Rings:
    """Sums over ring and sector cells of an image.

    `total`, `count`: sum and number of pixels of each cell, shape (ring, sector); `radius`: mean
    radius of each ring, column pitches, shape (ring,); `inside_fraction`: fraction of each ring
    that lies inside the frame, shape (ring,).
    """

    total: Array
    count: Array
    radius: Array
    inside_fraction: Array

    def mean(self, sectors: Mask | None = None) -> Array:
        """Ring means over the selected sectors, shape (ring,)."""
        chosen = np.ones(SECTORS, bool) if sectors is None else sectors
        return self.total[:, chosen].sum(axis=1) / np.maximum(
            self.count[:, chosen].sum(axis=1), 1.0
        )

    def median(self) -> Array:
        """Median over the sectors of each ring, shape (ring,); robust against a streak or another
        source.
        """
        cells = np.sort(
            np.where(self.count > 0, self.total / np.maximum(self.count, 1.0), np.inf), axis=1
        )
        occupied = (self.count > 0).sum(axis=1)
        rows, upper = np.arange(len(cells)), np.minimum(occupied // 2, SECTORS - 1)
        lower = np.maximum((occupied - 1) // 2, 0)
        return np.where(occupied > 0, 0.5 * (cells[rows, lower] + cells[rows, upper]), 0.0)

    def draws(self, pixel_sd: Array, count: int, rng: np.random.Generator, sectors: Mask) -> Array:
        """Draw ring means by a block bootstrap over sectors, shape (draw, ring).

        Random weights of the sectors preserve the correlation of noise between pixels, rings and
        frames. `pixel_sd` is the noise of a pixel of the mean frame in each ring, shape (ring,).
        """
        mean, number = self.mean(sectors), np.maximum(self.count[:, sectors].sum(axis=1), 1.0)
        sector_deviations = (self.total - mean[:, None] * self.count)[:, sectors] / number[:, None]
        weights = rng.standard_normal((count, sector_deviations.shape[1])) * np.sqrt(
            sector_deviations.shape[1] / max(sector_deviations.shape[1] - 1, 1)
        )
        innermost_sd = np.where(self.radius < 4, pixel_sd / np.sqrt(number), 0.0)
        return (
            mean
            + weights @ sector_deviations.T
            + innermost_sd * rng.standard_normal((count, len(mean)))
        )


def rings_of(image: Array, polar: Polar) -> Rings:
    """Sum an image over rings and sectors."""
    rings = polar.rings
    cell = (polar.ring * SECTORS + polar.sector).ravel()
    size = rings * SECTORS
    count = np.bincount(cell, minlength=size).reshape(rings, SECTORS).astype(float)
    total = np.bincount(cell, image.ravel(), minlength=size).reshape(rings, SECTORS).astype(float)
    pixels = np.maximum(count.sum(axis=1), 1.0)
    radius = np.bincount(polar.ring.ravel(), polar.radius.ravel(), minlength=rings) / pixels
    full = np.pi * (2.0 * np.arange(rings) + 1.0) / polar.row_pitch
    return Rings(total=total, count=count, radius=radius, inside_fraction=count.sum(axis=1) / full)


# Distance from full scale, standard deviations of a pixel, within which noise is clipped.
NEAR_TOP = 5.0
# Range of signal, fractions of full scale, in which photon noise is measured.
LIGHT = (0.1, 0.7)
SMOOTHING_PX = 1.0
# Rows with independent noise.
APART_ROWS = 3


def clipped_mean(mean: Array, sd: Array, top: float) -> tuple[Array, Array]:
    """Return the mean of a signal with Gaussian noise clipped at `top`, and the unclipped fraction;
    shape of `mean`.
    """
    from scipy.special import ndtr

    z = (top - mean) / sd
    read, unclipped_fraction = np.minimum(mean, top), (z > 0).astype(float)
    near_top = np.abs(z) < NEAR_TOP
    if near_top.any():
        at, near_sd = z[near_top], np.broadcast_to(sd, z.shape)[near_top]
        density = np.exp(-0.5 * at**2) / np.sqrt(2 * np.pi)
        unclipped_fraction[near_top] = ndtr(at)
        read[near_top] = top - near_sd * (at * unclipped_fraction[near_top] + density)
    return read, unclipped_fraction


def mean_with_clipping(mean: Array, noise: NoiseLaw, top: float) -> tuple[Array, Array]:
    """Return `clipped_mean` of a signal with the noise of one frame."""
    return clipped_mean(mean, noise.sd(np.minimum(mean, top)), top)


def noise_of(
    stack: Stack, signal: Array, smooth: Array, top: float, polar: Polar, rings: Rings
) -> NoiseLaw:
    """Estimate pixel noise from frame differences or, in a single frame, from differences within
    rings.

    `signal`, `smooth`: mean frame above dark and that smoothed by one pixel, shape (row, col), DN;
    `top`: full scale above dark, DN; `polar`, `rings`: polar coordinates of the pixels, and sums
    over cells of the mean.
    """
    profile = rings.median()
    expected = np.interp(polar.radius, rings.radius, profile)
    if len(stack) > 1:
        variance = stack.temporal_variance_dn2
    else:
        # Differences are no measure of noise where rings fall steeply; along columns they are, even
        # in a streak.
        level = (np.abs(np.gradient(profile)) < np.maximum(0.015 * profile, 0.004 * top))[
            polar.ring
        ]
        level[:APART_ROWS] = level[-APART_ROWS:] = False
        around = 0.5 * (np.roll(signal, APART_ROWS, axis=0) + np.roll(signal, -APART_ROWS, axis=0))
        variance = np.where(level, (signal - around) ** 2 / 1.5, np.nan)
    faint = (signal <= np.median(signal[::2, ::2]))[::2, ::2]
    spread = [
        float(np.median(np.abs(image - expected)[::2, ::2][faint])) for image in (smooth, signal)
    ]
    correlation_factor = max(
        1.0, (spread[0] / max(spread[1], 1e-6)) ** 2 * 4.0 * np.pi * SMOOTHING_PX**2
    )
    # In a single frame, selection by the pixel's own value would bias its noise.
    of = signal if len(stack) > 1 else expected
    return _line(variance.ravel(), of.ravel(), top, len(stack), correlation_factor)


def _line(
    variance: Array, signal: Array, top: float, frames: int, correlation_factor: float
) -> NoiseLaw:
    """Fit variance against signal from the faint half of the pixels and from well exposed ones."""
    known = np.isfinite(variance)
    variance, signal = variance[known], signal[known]
    faint = signal <= np.median(signal)
    lit = (signal > LIGHT[0] * top) & (signal < LIGHT[1] * top)
    at_faint, of_faint = float(np.maximum(signal[faint], 0.0).mean()), float(variance[faint].mean())
    if lit.sum() < 8:
        # Noise of intensified cameras is mostly photon noise.
        slope, floor = max(of_faint - QUANTISATION_DN2, 0.0) / max(at_faint, 1.0), QUANTISATION_DN2
    else:
        # Medians, since pixels at the end of a streak or under a moving source vary by more than
        # their noise.
        at_lit = float(np.median(signal[lit]))
        # Median over mean of chi squared (Wilson and Hilferty, 1931).
        median_ratio = (1.0 - 2.0 / (9.0 * max(frames - 1, 1))) ** 3
        of_lit = float(np.median(variance[lit])) / median_ratio
        slope, floor = max(of_lit - QUANTISATION_DN2, 0.0) / at_lit, QUANTISATION_DN2
        if at_lit >= 1.5 * at_faint:
            slope = max(of_lit - of_faint, 0.0) / max(at_lit - at_faint, 1e-6)
            floor = max(of_faint - slope * at_faint, QUANTISATION_DN2)
    return NoiseLaw(gain_dn=slope, read_dn=floor**0.5, correlation_factor=correlation_factor)


@dataclass(frozen=True, kw_only=True)
class SourceView:
    """Mean frame around a source.

    `signal`: mean frame above dark, shape (row, col), DN; `smooth`: the same smoothed by one pixel;
    `dark_dn`: black level, DN; `top`: full scale above dark, DN; `polar`, `rings`, `noise`: polar
    coordinates of the pixels, sums over cells, and noise of a pixel in one frame; `frames`: how
    many are averaged.
    """

    signal: Array
    smooth: Array
    dark_dn: float
    top: float
    polar: Polar
    rings: Rings
    noise: NoiseLaw
    frames: int

    def mean_sd(self, signal: Array | float) -> Array:
        """Return the standard deviation of a pixel of the mean frame at signals above dark, DN."""
        return self.noise.sd(signal) / np.sqrt(self.frames)

    @cached_property
    def profile(self) -> tuple[Array, Array]:
        """Radius and median signal of the rings."""
        return self.rings.radius, self.rings.median()


def view_of(stack: Stack, dark_dn: float, row: float, col: float, row_pitch: float) -> SourceView:
    """Compute rings, sectors and pixel noise of frames around (row, col).

    `dark_dn`: black level, DN; `row`, `col`: centre of the source, px; `row_pitch`: row pitch over
    column pitch.
    """
    from scipy import ndimage

    signal = stack.mean_frame_dn - dark_dn
    polar = polar_of((signal.shape[0], signal.shape[1]), row, col, row_pitch)
    rings, top = rings_of(signal, polar), stack.top_dn - dark_dn
    smooth = np.asarray(ndimage.gaussian_filter(signal, SMOOTHING_PX))
    return SourceView(
        signal=signal,
        smooth=smooth,
        dark_dn=dark_dn,
        top=top,
        polar=polar,
        rings=rings,
        noise=noise_of(stack, signal, smooth, top, polar, rings),
        frames=len(stack),
    )


@dataclass(frozen=True, kw_only=True)
class Background:
    """Signal far from the source above dark and its standard uncertainty, DN, and whether it is
    uniform.
    """

    level_dn: float
    sd_dn: float
    is_uniform: bool

    @property
    def is_illuminated(self) -> bool:
        """Whether the background is clearly above the dark level."""
        return self.level_dn > max(0.25, 5.0 * self.sd_dn)


def background_of(view: SourceView) -> Background:
    """Estimate the background from the outermost rings; medians over sectors exclude other
    sources.
    """
    first = int(0.6 * view.polar.rings)
    half = (first + view.polar.rings) // 2
    inner, outer = _level(view, slice(first, half)), _level(view, slice(half, None))
    level, sd = _level(view, slice(first, None))
    falls = inner[0] - outer[0]
    is_uniform = falls < max(4.0 * float(np.hypot(inner[1], outer[1])), 0.05 * abs(level), 0.1)
    return Background(level_dn=level, sd_dn=sd, is_uniform=bool(is_uniform))


def _level(view: SourceView, rings: slice) -> tuple[float, float]:
    """Return the median over sectors of the means of some rings, and its standard uncertainty."""
    total, count = view.rings.total[rings].sum(axis=0), view.rings.count[rings].sum(axis=0)
    means = total[count > 0] / count[count > 0]
    middle = float(np.median(means))
    spread = robust_sd(means)
    return middle, 1.25 * spread / np.sqrt(max(len(means), 1)) + 0.01 / np.sqrt(SECTORS)
