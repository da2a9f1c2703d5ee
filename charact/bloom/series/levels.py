"""One level of a point series as ring means, with the noise that they really have."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.bloom.series.rings import SECTORS, Geometry

Array = NDArray[np.float64]

# Rings apart up to which noise is shared, rings over which its strength is smoothed, and the smallest eigenvalue that a
# correlation estimated from few frames may have.
LAGS = 6
SMOOTHED = 7
LEAST_EIGENVALUE = 0.05
# Means of codes are known no better than this, DN.
LEAST_SD_DN = 0.01
# Rings of so few pixels that their neighbours share less than others.
INNERMOST = 4
# Share of samples at the highest code from which on a ring's scatter says nothing of its noise.
HARDLY_CUT = 1e-3
# Rings beside a cut core into which a streak reaches before it is seen as one.
ADJACENT_RINGS = 2


@dataclass(frozen=True, kw_only=True)
class LevelRings:
    """Ring means of one stack.

    Parameters
    ----------
    label
        Its stack.
    geometry
        Its rings.
    mean_dn
        Ring means over all frames, codes cut at full scale among them, shape (ring,), DN.
    cut_share
        Share of each ring's samples at the highest code, shape (ring,).
    pixel_variance
        Variance of single pixels from frame to frame, averaged over the ring, shape (ring,), DN^2.
    scatter
        Ring means of single frames less their mean; of a single frame those of sectors, scaled to whole rings.
    frames
        Number of frames.
    sector_sd
        Root mean square of what sectors are brighter or darker than their ring, shape (ring,), DN.
    """

    label: str
    geometry: Geometry
    mean_dn: Array
    cut_share: Array
    pixel_variance: Array
    scatter: Array
    frames: int
    sector_sd: Array

    def without_core(self, reach_px: float) -> "LevelRings":
        """Return the level without its cut rings, those next to them, and all within a radius."""
        cut = np.flatnonzero(self.cut_share > HARDLY_CUT)
        lost = self.geometry.lost | (self.geometry.radius_px < reach_px)
        lost[: int(cut[-1]) + 1 + ADJACENT_RINGS if len(cut) else 0] = True
        return replace(self, geometry=replace(self.geometry, lost=lost))


def level_of(label: str, frames: NDArray, geometry: Geometry, *, full_dn: float) -> LevelRings:
    """Average a stack over rings, shape (frame, row, col), DN."""
    pixels = geometry.pixels(frames)
    image = pixels.mean(axis=0)
    mean = geometry.means(image)
    uneven = geometry.sector_means(image - _along(geometry, mean))
    off = uneven - np.nanmean(uneven, axis=0)
    if len(frames) > 1:
        scatter = geometry.means(pixels) - mean
        variance = geometry.means(pixels.var(axis=0, ddof=1))
    else:
        scatter = np.nan_to_num(off) / np.sqrt(SECTORS * (SECTORS - 1))
        variance = geometry.means((image - _along(geometry, mean)) ** 2)
    return LevelRings(
        label=label,
        geometry=geometry,
        mean_dn=mean,
        cut_share=geometry.means((pixels >= full_dn).mean(axis=0)),
        pixel_variance=variance,
        scatter=scatter,
        frames=len(frames),
        sector_sd=np.sqrt(np.nanmean(off**2, axis=0)),
    )


def _along(geometry: Geometry, mean: Array) -> Array:
    """Ring means as a smooth profile, at each pixel."""
    return np.interp(geometry.pixel_radius_px, geometry.radius_px, mean)


@dataclass(frozen=True, kw_only=True)
class RingNoise:
    """Noise of a series as its frames show it.

    Parameters
    ----------
    floor_dn2, slope_dn
        Variance of a single pixel, floor + slope x (level - dark).
    dark_dn
        Level without light, DN.
    sharing
        Variance of a ring's mean over that of as many pixels that share no noise, shape (ring,).
    correlation
        Of ring means 0, 1, 2, .. apart, shape (lag,).
    fewer
        Frames that are worth one, as successive ones share light.
    """

    floor_dn2: float
    slope_dn: float
    dark_dn: float
    sharing: Array
    correlation: Array
    fewer: float

    def pixel_sd(self, level_dn: Array) -> Array:
        """Return the standard deviation of a single pixel at levels, DN."""
        return np.sqrt(np.maximum(self.floor_dn2 + self.slope_dn * (level_dn - self.dark_dn), 1e-4))

    def covariance(self, level_dn: Array, count: Array, frames: int) -> Array:
        """Return the covariance of ring means of a stack at levels, shape (ring, ring), DN^2."""
        sd = self.pixel_sd(level_dn) * np.sqrt(self.sharing[: len(count)] / count * min(self.fewer / frames, 1.0))
        rounding = np.diag(self.rounding_sd(level_dn) ** 2 + LEAST_SD_DN**2)
        return self._matrix[: len(count), : len(count)] * np.outer(sd, sd) + rounding

    def rounding_sd(self, level_dn: Array) -> Array:
        """Return how far rounding to whole codes moves a mean, DN: exp(-2 pi^2 s^2)/pi at most for noise of s codes.

        Light that comes in rare pulses does not stir the codes between them: below a code of light only the noise
        without light counts.
        """
        stirred = self.floor_dn2 + self.slope_dn * np.maximum(level_dn - self.dark_dn - 1.0, 0.0)
        return np.exp(-2.0 * np.pi**2 * stirred) / np.pi

    @cached_property
    def _matrix(self) -> Array:
        """Correlation of all rings, made positive where its estimate is not."""
        size = len(self.sharing)
        apart = np.abs(np.subtract.outer(np.arange(size), np.arange(size)))
        padded = np.concatenate([self.correlation, np.zeros(max(1, size - len(self.correlation)))])
        values, vectors = np.linalg.eigh(padded[apart])
        return (vectors * np.maximum(values, LEAST_EIGENVALUE)) @ vectors.T


def noise_of(levels: tuple[LevelRings, ...], *, dark_dn: float) -> RingNoise:
    """Estimate the noise that all levels of a series share."""
    free = np.array([(level.cut_share < HARDLY_CUT) & ~level.geometry.lost for level in levels])
    floor, slope = _variance_law(levels, free, dark_dn)
    bare = RingNoise(
        floor_dn2=floor, slope_dn=slope, dark_dn=dark_dn, sharing=np.ones(1), correlation=np.ones(1), fewer=1.0
    )
    scaled = [
        np.where(usable, level.scatter / (bare.pixel_sd(level.mean_dn) / np.sqrt(level.geometry.count)), np.nan)
        for level, usable in zip(levels, free, strict=True)
    ]
    freedom = np.array([max(level.frames - 1, 1) for level in levels])
    square = np.sum([np.nansum(one**2, axis=0) for one in scaled], axis=0)
    sharing = _smooth_over_rings(square, freedom @ free)
    alike = [one / np.sqrt(sharing) for one in scaled]
    return RingNoise(
        floor_dn2=floor,
        slope_dn=slope,
        dark_dn=dark_dn,
        sharing=sharing,
        correlation=_correlation(alike),
        fewer=_frames_per_independent_frame(alike, levels),
    )


def _variance_law(levels: tuple[LevelRings, ...], free: NDArray[np.bool_], dark_dn: float) -> tuple[float, float]:
    """Floor and slope of the pixels' variance over the level, the weights being those of variances."""
    mean = np.concatenate([level.mean_dn[use] for level, use in zip(levels, free, strict=True)]) - dark_dn
    variance = np.concatenate([level.pixel_variance[use] for level, use in zip(levels, free, strict=True)])
    pixels = np.concatenate([level.geometry.count[use] for level, use in zip(levels, free, strict=True)])
    if len(mean) < 3:
        return 1.0, 0.0
    design = np.stack([np.ones_like(mean), np.maximum(mean, 0.0)], axis=1)
    fitted = np.full(len(mean), np.median(variance))
    for _ in range(4):
        weight = np.sqrt(pixels) / np.maximum(fitted, 1e-3)
        floor, slope = np.linalg.lstsq(design * weight[:, None], variance * weight, rcond=None)[0]
        fitted = np.maximum(design @ [max(floor, 1e-3), max(slope, 0.0)], 1e-3)
    return float(max(floor, 1e-3)), float(max(slope, 0.0))


def _smooth_over_rings(square: Array, seen: Array) -> Array:
    """Mean squares over neighbouring rings; where none is seen, the mean of all."""
    kernel = np.ones(SMOOTHED)
    total, number = (np.convolve(np.pad(one, SMOOTHED // 2), kernel, mode="valid") for one in (square, seen))
    whole = square.sum() / max(seen.sum(), 1)
    return np.maximum(np.where(number > 20, total / np.maximum(number, 1), max(whole, 0.3)), 0.1)


def _correlation(alike: list[Array]) -> Array:
    """Correlation of ring means by how many rings they are apart, beyond the innermost."""
    out = [1.0]
    for lag in range(1, LAGS + 1):
        pairs = [(one[:, INNERMOST:-lag], one[:, INNERMOST + lag :]) for one in alike]
        products = np.concatenate([(near * far).ravel() for near, far in pairs])
        squares = np.concatenate([(0.5 * (near**2 + far**2)).ravel() for near, far in pairs])
        known = np.isfinite(products)
        enough = known.sum() > 50 and squares[known].sum() > 0
        out.append(float(products[known].sum() / squares[known].sum()) if enough else 0.0)
    return np.clip(np.array(out), -0.5, 1.0)


def _frames_per_independent_frame(alike: list[Array], levels: tuple[LevelRings, ...]) -> float:
    """How many frames are worth one: 1 + 2 x the correlation of successive ones, freed of its bias."""
    top = bottom = 0.0
    frames = []
    for one, level in zip(alike, levels, strict=True):
        if level.frames < 4:
            continue
        top += float(np.nansum(one[1:] * one[:-1])) * level.frames / (level.frames - 1)
        bottom += float(np.nansum(one**2))
        frames.append(level.frames)
    if not bottom:
        return 1.0
    # Deviations from a mean of N are correlated by -1/N of themselves.
    one_apart = top / bottom + 1.0 / float(np.mean(frames))
    return float(max(1.0, 1.0 + 2.0 * max(0.0, one_apart)))
