"""Rings around a point source: geometry, ring means of a stack, and their noise."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.estimators.bloom.source_view import polar_of
from charact.frames.noise_law import NoiseLaw
from labdata import Array, Mask

# Outermost ring, column pitches; halos of up to 1.1 mm at the photocathode fit into it.
REACH_PX = 64
INNERMOST = 3
# Node spacing, column pitches: fine within the core, coarser beyond.
COARSE_PX, FINE_TO_PX = 0.4, 8.0
SECTORS = 16


@dataclass(frozen=True, kw_only=True)
class Geometry:
    """Pixels of the rings around a position, and the radial nodes averaged over them.

    `rows`, `cols`: slices of the frame that contain all rings; `order`: pixels of that window, ring
    by ring, flat indices; `first`: first index of each ring in `order`, shape (ring,); `radius_px`:
    mean radius of each ring, column pitches, shape (ring,); `count`: pixels of each ring, shape
    (ring,); `lost`: rings with mostly excluded pixels: they retain them and are not used, shape
    (ring,); `node_px`: radii of the nodes, column pitches, shape (node,); `pixel_radius_px`,
    `pixel_angle`: radius, column pitches, and angle, radians, of each pixel of `order`.
    """

    rows: slice
    cols: slice
    order: NDArray[np.int64]
    first: NDArray[np.int64]
    radius_px: Array
    count: Array
    lost: Mask
    node_px: Array
    pixel_radius_px: Array
    pixel_angle: Array

    @cached_property
    def averages(self) -> Array:
        """Matrix from values at the nodes to ring means, shape (ring, node)."""
        ring = np.repeat(np.arange(len(self.count)), self.count.astype(int))
        return _averages(self.pixel_radius_px, ring, self.node_px, len(self.count))

    def pixels(self, frames: NDArray) -> Array:
        """Return the pixels of the rings in order, shape (frame, row, col) -> (frame, pixel)."""
        window = np.asarray(frames[:, self.rows, self.cols], np.float64).reshape(len(frames), -1)
        return window[:, self.order]

    def means(self, pixels: Array) -> Array:
        """Average ordered pixels over rings, shape (.., pixel) -> (.., ring)."""
        return np.add.reduceat(pixels, self.first, axis=-1) / self.count

    def largest(self, pixels: Array) -> Array:
        """Largest pixel of each ring, shape (pixel,) -> (ring,)."""
        return np.maximum.reduceat(pixels, self.first)

    def sector_means(self, pixels: Array) -> Array:
        """Average ordered pixels over ring sectors, shape (pixel,) -> (sector, ring); NaN where
        empty.
        """
        ring = np.repeat(np.arange(len(self.count)), self.count.astype(int))
        sector = ((self.pixel_angle / (2 * np.pi) + 0.5) * SECTORS).astype(np.int64) % SECTORS
        cell, size = ring * SECTORS + sector, len(self.count) * SECTORS
        with np.errstate(invalid="ignore"):
            mean = np.bincount(cell, pixels, minlength=size) / np.bincount(cell, minlength=size)
        return mean.reshape(-1, SECTORS).T


def geometry_of(
    shape: tuple[int, int],
    row: float,
    col: float,
    *,
    pitch_ratio: float,
    spoiled: Mask | None,
    reach_px: int = REACH_PX,
) -> Geometry:
    """Return rings of one column pitch around a position.

    `shape`: of the frame; `row`, `col`: centre, px; `pitch_ratio`: row pitch over column pitch;
    `spoiled`: pixels to exclude, shape of the frame; `reach_px`: requested outermost ring; rings
    end where less than 34 % of one lies inside the frame.
    """
    up = int(np.ceil(reach_px / pitch_ratio))
    rows = slice(max(0, int(row) - up), min(shape[0], int(row) + up + 2))
    cols = slice(max(0, int(col) - reach_px), min(shape[1], int(col) + reach_px + 2))
    window = rows.stop - rows.start, cols.stop - cols.start
    polar = polar_of(window, row - rows.start, col - cols.start, pitch_ratio)
    radius, ring = polar.radius.ravel(), polar.ring.ravel()
    within_reach = ring < reach_px
    full_ring_area = np.pi * (2 * np.arange(reach_px) + 1) / pitch_ratio
    enough = np.bincount(ring[within_reach], minlength=reach_px) > 0.34 * full_ring_area
    # The innermost rings contain few pixels, depending on the subpixel position.
    enough[:INNERMOST] |= np.bincount(ring[within_reach], minlength=reach_px)[:INNERMOST] > 0
    ring_count = int(np.argmin(enough)) if not enough.all() else reach_px
    used_pixels = ring < ring_count
    lost = np.zeros(ring_count, bool)
    if spoiled is not None:
        clean = used_pixels & ~spoiled[rows, cols].ravel()
        clean_fraction = np.bincount(ring[clean], minlength=ring_count) / np.bincount(
            ring[used_pixels], minlength=ring_count
        )
        lost = clean_fraction < 0.3
        used_pixels &= clean | lost[np.minimum(ring, ring_count - 1)]
    order = np.flatnonzero(used_pixels)
    order = order[np.argsort(ring[order], kind="stable")]
    _, first, count = np.unique(ring[order], return_index=True, return_counts=True)
    return Geometry(
        rows=rows,
        cols=cols,
        order=order,
        first=first,
        radius_px=np.add.reduceat(radius[order], first) / count,
        count=count.astype(float),
        lost=lost,
        node_px=_nodes(ring_count + 1.0),
        pixel_radius_px=radius[order],
        pixel_angle=np.arctan2(polar.dy, polar.dx).ravel()[order],
    )


def _nodes(reach_px: float) -> Array:
    fine = np.arange(0.0, FINE_TO_PX, 0.125)
    return np.concatenate([fine, np.arange(FINE_TO_PX, reach_px + 3 * COARSE_PX, COARSE_PX)])


def _averages(radius: Array, ring: NDArray[np.int64], nodes: Array, rings: int) -> Array:
    """Weights of cubic interpolation between nodes, averaged over each ring's pixels."""
    first_node = np.clip(np.searchsorted(nodes, radius) - 2, 0, len(nodes) - 4)
    four = first_node[:, None] + np.arange(4)
    x = nodes[four]
    weight = np.ones_like(x)
    for node in range(4):
        for other_node in range(4):
            if other_node != node:
                weight[:, node] *= (radius - x[:, other_node]) / (x[:, node] - x[:, other_node])
    cell = (ring[:, None] * len(nodes) + four).ravel()
    out = np.bincount(cell, weight.ravel(), minlength=rings * len(nodes)).reshape(rings, -1)
    return out / np.bincount(ring, minlength=rings)[:, None]


# Innermost rings, of few pixels, are less correlated.
FIRST_CORRELATED_RING = 4
# Fraction of clipped samples above which a ring's scatter is no measure of its noise.
HARDLY_CUT = 1e-3
# Rings next to a clipped core that an undetected streak may contaminate.
ADJACENT_RINGS = 2


@dataclass(frozen=True, kw_only=True)
class LevelRings:
    """Ring means of one stack.

    `label`: label of the stack; `geometry`: its rings; `mean_dn`: ring means over all frames,
    clipped values included, shape (ring,), DN; `cut_share`: fraction of each ring's samples at full
    scale, shape (ring,); `pixel_variance`: temporal variance of single pixels, averaged over the
    ring, shape (ring,), DN^2; `scatter`: ring means of single frames less their mean; for a single
    frame those of sectors, scaled to complete rings; `frames`: number of frames; `sector_sd`: root
    mean square deviation of sectors from their ring, shape (ring,), DN.
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
        """Return the stack without its clipped rings, those next to them, and all within a
        radius.
        """
        cut = np.flatnonzero(self.cut_share > HARDLY_CUT)
        lost = self.geometry.lost | (self.geometry.radius_px < reach_px)
        lost[: int(cut[-1]) + 1 + ADJACENT_RINGS if len(cut) else 0] = True
        return replace(self, geometry=replace(self.geometry, lost=lost))


def level_of(label: str, frames: NDArray, geometry: Geometry, *, full_dn: float) -> LevelRings:
    """Average a stack, shape (frame, row, col), DN, over rings."""
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
    """Smooth profile of ring means at each pixel."""
    return np.interp(geometry.pixel_radius_px, geometry.radius_px, mean)


@dataclass(frozen=True, kw_only=True)
class RingNoise:
    """Noise of a series, estimated from its frames.

    `law`: noise of a pixel against its signal above the black level `dark_dn`, DN; `sharing`:
    variance of a ring's mean over that of independent pixels, dimensionless; `correlation`:
    correlation of ring means by distance 0, 1, 2, .., shape (lag,); `fewer`: frames per independent
    frame.
    """

    law: NoiseLaw
    dark_dn: float
    sharing: float
    correlation: Array
    fewer: float

    def pixel_sd(self, level_dn: Array) -> Array:
        """Return the standard deviation of a pixel at given signals, DN."""
        return self.law.sd(level_dn - self.dark_dn)

    def covariance(self, level_dn: Array, count: Array, frames: int) -> Array:
        """Return the covariance of a stack's ring means at given signals, shape (ring, ring),
        DN^2.
        """
        sd = self.pixel_sd(level_dn) * np.sqrt(self.sharing / count * min(self.fewer / frames, 1.0))
        # Rounding shifts a mean by at most exp(-2 pi^2 s^2)/pi for noise of s DN. Rare pulses do
        # not dither the values between them: below 1 DN only the dark noise counts.
        rounding_sd = np.exp(-2.0 * np.pi**2 * self.pixel_sd(level_dn - 1.0) ** 2) / np.pi
        rounding = np.diag(rounding_sd**2 + 0.01**2)
        ring = np.arange(len(count))
        padded = np.concatenate([self.correlation, np.zeros(max(1, len(ring)))])
        # Eigenvalues are bounded from below.
        values, vectors = np.linalg.eigh(padded[np.abs(np.subtract.outer(ring, ring))])
        correlation = (vectors * np.maximum(values, 0.05)) @ vectors.T
        return correlation * np.outer(sd, sd) + rounding


def noise_of(levels: tuple[LevelRings, ...], *, dark_dn: float) -> RingNoise:
    """Estimate the noise common to all stacks of a series."""
    free = np.array([(level.cut_share < HARDLY_CUT) & ~level.geometry.lost for level in levels])
    law = _noise_law(levels, free, dark_dn)
    bare = RingNoise(
        law=law,
        dark_dn=dark_dn,
        sharing=1.0,
        correlation=np.ones(1),
        fewer=1.0,
    )
    scaled = [
        np.where(
            usable,
            level.scatter / (bare.pixel_sd(level.mean_dn) / np.sqrt(level.geometry.count)),
            np.nan,
        )
        for level, usable in zip(levels, free, strict=True)
    ]
    freedom = np.array([max(level.frames - 1, 1) for level in levels])
    square = sum(float(np.nansum(scatter**2)) for scatter in scaled)
    sharing = max(square / max(float((freedom @ free).sum()), 1.0), 0.3)
    normalised = [scatter / np.sqrt(sharing) for scatter in scaled]
    return RingNoise(
        law=law,
        dark_dn=dark_dn,
        sharing=sharing,
        correlation=_correlation(normalised),
        fewer=_frames_per_independent_frame(normalised, levels),
    )


def _noise_law(levels: tuple[LevelRings, ...], free: NDArray[np.bool_], dark_dn: float) -> NoiseLaw:
    """Noise law of a pixel, by weighted least squares."""
    mean = (
        np.concatenate([level.mean_dn[use] for level, use in zip(levels, free, strict=True)])
        - dark_dn
    )
    variance = np.concatenate(
        [level.pixel_variance[use] for level, use in zip(levels, free, strict=True)]
    )
    pixels = np.concatenate(
        [level.geometry.count[use] for level, use in zip(levels, free, strict=True)]
    )
    if len(mean) < 3:
        return NoiseLaw(gain_dn=0.0, read_dn=1.0)
    design = np.stack([np.ones_like(mean), np.maximum(mean, 0.0)], axis=1)
    fitted = np.full(len(mean), np.median(variance))
    for _ in range(4):
        weight = np.sqrt(pixels) / np.maximum(fitted, 1e-3)
        floor, slope = np.linalg.lstsq(design * weight[:, None], variance * weight, rcond=None)[0]
        fitted = np.maximum(design @ [max(floor, 1e-3), max(slope, 0.0)], 1e-3)
    return NoiseLaw(gain_dn=float(max(slope, 0.0)), read_dn=float(max(floor, 1e-3)) ** 0.5)


def _correlation(normalised: list[Array]) -> Array:
    """Correlation of ring means by ring separation, beyond the innermost."""
    out = [1.0]
    for lag in range(1, 6 + 1):
        pairs = [
            (scatter[:, FIRST_CORRELATED_RING:-lag], scatter[:, FIRST_CORRELATED_RING + lag :])
            for scatter in normalised
        ]
        products = np.concatenate([(inner * outer).ravel() for inner, outer in pairs])
        squares = np.concatenate([(0.5 * (inner**2 + outer**2)).ravel() for inner, outer in pairs])
        known = np.isfinite(products)
        enough = known.sum() > 50 and squares[known].sum() > 0
        out.append(float(products[known].sum() / squares[known].sum()) if enough else 0.0)
    return np.clip(np.array(out), -0.5, 1.0)


def _frames_per_independent_frame(normalised: list[Array], levels: tuple[LevelRings, ...]) -> float:
    """Number of frames per independent frame: 1 + 2 x the bias-corrected correlation of successive
    frames.
    """
    top = bottom = 0.0
    frames = []
    for scatter, level in zip(normalised, levels, strict=True):
        if level.frames < 4:
            continue
        top += float(np.nansum(scatter[1:] * scatter[:-1])) * level.frames / (level.frames - 1)
        bottom += float(np.nansum(scatter**2))
        frames.append(level.frames)
    if not bottom:
        return 1.0
    # Deviations from a mean of N have the correlation -1/N.
    one_apart = top / bottom + 1.0 / float(np.mean(frames))
    return float(max(1.0, 1.0 + 2.0 * max(0.0, one_apart)))
