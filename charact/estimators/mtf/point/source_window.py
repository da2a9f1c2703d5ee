"""Pixels of a point source: core pixel by pixel, surroundings in rings, figure data."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.known_transfer import halo_diameters_px
from charact.estimators.mtf.point.parametric_noise import (
    dark_sd_from_histogram,
)
from charact.estimators.mtf.point.source import DetectedSource
from charact.estimators.mtf.point.thresholds import ACCURACY, LIMITS
from charact.frames.clipping import is_clipped_at_black
from charact.frames.stack import Stack
from charact.frames.thresholds import CLIPPING
from charact.method import Context
from labdata import Array, Mask
from labdata.camera.description import has_tube


@dataclass(frozen=True, kw_only=True)
class Window:
    """Pixels around a source."""

    core: Array  # Mean frame of the core, shape (row, col), DN
    deviations: Array  # Frames of the core less their mean, shape (frame, row x col), DN
    keep: NDArray[
        np.bool_
    ]  # Valid core pixels: not affected by full scale or a neighbour, shape (row, col)
    sound: bool  # Whether full scale affects no core pixel
    # x, y: positions of columns and rows from the centre of the core, column pitches
    x: Array
    y: Array
    parity: Mask  # Field of every core pixel, shape (row x col,)
    ring_px: Array  # Distances of sample pixels of each ring, shape (ring, pixel), column pitches
    # ring_dn, ring_variance, ring_correlation: mean of each ring, its variance, shape (ring,), and
    # the correlation between rings, shape (ring, ring)
    ring_dn: Array
    ring_variance: Array
    ring_correlation: Array
    # Noise of a pixel without light, DN, infinite without quantisation. Small noise lets
    # quantisation hide faint light
    quiet_sd: float
    frames: int  # Number of frames
    # holds_halo, cut: whether the region contains the complete halo, and whether it cuts into the
    # core
    holds_halo: bool
    cut: bool
    clipped: bool  # Whether the noise of pixels without light is clipped at black
    # Columns and rows of other sources from the centre of the core, shape (neighbour, 2), column
    # pitches
    neighbours: Array
    # Distances of sample pixels of each ring from each neighbour, shape (neighbour, ring, pixel),
    # column pitches
    neighbour_ring_px: Array

    @cached_property
    def distances(self) -> Array:
        """Distances between core pixels, shape (pixel, pixel), px."""
        x, y = (part.ravel() for part in np.broadcast_arrays(self.x, self.y[:, None]))
        return np.hypot(x[:, None] - x, y[:, None] - y)

    @property
    def contrasts(self) -> Array:
        """Contrasts of frames: independent samples of one frame's noise, shape (frame - 1, pixel),
        DN.
        """
        mixed = np.linalg.qr(np.eye(self.frames)[:, : self.frames - 1] - 1.0 / self.frames)[0]
        return np.asarray(mixed.T @ self.deviations, np.float64)

    @property
    def centre(self) -> tuple[float, float]:
        """Centre of light of the brighter half of the core, px."""
        height = self.core - np.median(self.core)
        weight = np.maximum(height - 0.3 * height.max(), 0.0)
        total = max(float(weight.sum()), 1e-12)
        return float((weight * self.x).sum() / total), float(
            (weight * self.y[:, None]).sum() / total
        )


def source_window(stack: Stack, source: DetectedSource, context: Context) -> Window:
    """Return the pixels around a detected source."""
    data, row, col, neighbours, pitch_ratio = (
        stack.data,
        source.row,
        source.col,
        source.neighbours,
        stack.pitch_ratio,
    )
    described = has_tube(stack.camera)
    halo_radius_px = halo_diameters_px(context, transposed=False)[1] / 2.0 if described else np.inf
    frames, rows, cols = data.shape
    top, bottom = max(0, row - ACCURACY.half_rows), min(rows, row + ACCURACY.half_rows + 1)
    first_col, last_col = max(0, col - ACCURACY.half_cols), min(cols, col + ACCURACY.half_cols + 1)
    mean = stack.mean_frame_dn
    core = data[:, top:bottom, first_col:last_col].astype(float)
    x = np.arange(first_col, last_col) - float(col)
    y = (np.arange(top, bottom) - float(row)) * pitch_ratio
    parity = np.repeat(np.arange(top, bottom) % 2 == 1, x.size)
    radius = np.hypot(np.arange(cols) - col, ((np.arange(rows) - row) * pitch_ratio)[:, None])
    surroundings = np.ones((rows, cols), bool)
    surroundings[top:bottom, first_col:last_col] = False
    undisturbed = ~neighbour_mask(mean.shape, neighbours, pitch_ratio)
    surroundings &= undisturbed
    border_px = min(row * pitch_ratio, (rows - 1 - row) * pitch_ratio, col, cols - 1 - col)
    rings = _rings(mean, radius, surroundings, row, col, border_px, pitch_ratio)
    positions = np.array(
        [(c - col, (r - row) * pitch_ratio) for r, c in neighbours], float
    ).reshape(-1, 2)
    far_ring = (
        surroundings & (radius > (27.0 if border_px > 31 else 0.7 * border_px)) & (radius < 48.0)
    )
    values = data[:, far_ring] if far_ring.any() else data.reshape(frames, -1)
    noise = float(np.sqrt(values.var(axis=0, ddof=1).mean() if frames > 1 else values.var()))
    rounded = data.dtype.kind in "ui"
    # A causal video filter follows a described sensor.
    sound = _valid_pixels(core, stack.ceiling_dn, filtered=described)
    return Window(
        core=core.mean(axis=0),
        deviations=(core - core.mean(axis=0)).reshape(frames, -1),
        keep=sound & undisturbed[top:bottom, first_col:last_col],
        sound=bool(sound.all()),
        x=x,
        y=y,
        parity=parity,
        ring_px=rings[0],
        ring_dn=rings[1],
        ring_variance=rings[2],
        ring_correlation=rings[3],
        quiet_sd=min(dark_sd_from_histogram(values), noise) if rounded else np.inf,
        frames=frames,
        holds_halo=border_px >= halo_radius_px + 5.0,
        cut=core.shape[1:] != (2 * ACCURACY.half_rows + 1, 2 * ACCURACY.half_cols + 1),
        clipped=is_clipped_at_black(values),
        neighbours=positions,
        neighbour_ring_px=np.array(
            [
                [_ring_quantiles(np.hypot(*(ring - at[:, None]))) for ring in rings[4]]
                for at in positions
            ]
        ).reshape(len(positions), len(rings[4]), ACCURACY.pixels_per_ring),
    )


def neighbour_mask(
    shape: tuple[int, ...], neighbours: tuple[tuple[int, int], ...], pitch_ratio: float
) -> Mask:
    """Return the pixels that belong to neighbouring sources, shape (row, col)."""
    rows, cols = np.ogrid[: shape[0], : shape[1]]
    mask = np.zeros(shape, bool)
    for row, col in neighbours:
        mask |= (cols - col) ** 2 + ((rows - row) * pitch_ratio) ** 2 < LIMITS.neighbour_px**2
    return mask


def _valid_pixels(core: Array, full_scale_dn: float | None, *, filtered: bool) -> Mask:
    """Return the core pixels that neither reach full scale nor follow such a pixel in a filtered
    row.
    """
    if full_scale_dn is None:
        return np.ones(core.shape[1:], bool)
    full = np.asarray(core.max(axis=0) >= CLIPPING.full_fraction * full_scale_dn)
    spoilt = full.copy()
    if filtered:
        for step in range(1, 9):
            spoilt[:, step:] |= full[:, :-step]
        spoilt[:, :-1] |= full[:, 1:]
    return ~spoilt


def _rings(
    mean: Array,
    radius: Array,
    surroundings: Mask,
    row: int,
    col: int,
    border_px: float,
    pitch_ratio: float,
) -> tuple[Array, Array, Array, Array, list[Array]]:
    """Return distances, means, variances and correlations of rings, and columns and rows of their
    pixels.
    """
    angle = np.arctan2(
        *np.broadcast_arrays(
            (np.arange(mean.shape[0]) - row)[:, None], np.arange(mean.shape[1]) - col
        )
    )
    distances, values, sectors, pixels, lengths, positions = [], [], [], [], [], []
    for low, high in pairwise(ACCURACY.ring_borders_px):
        if high > border_px:
            break
        ring = surroundings & (radius >= low) & (radius < high)
        if ring.sum() < 24:
            continue
        distances.append(_ring_quantiles(radius[ring]))
        values.append(float(mean[ring].mean()))
        sectors.append(
            _sectors(mean[ring], angle[ring], round(np.pi * (low + high) / ACCURACY.sector_px))
        )
        pixels.append(float(ring.sum()))
        lengths.append((low, high))
        y, x = np.nonzero(ring)
        positions.append(np.stack([x - col, (y - row) * pitch_ratio]))
    if not distances:
        return (
            np.empty((0, ACCURACY.pixels_per_ring)),
            np.empty(0),
            np.empty(0),
            np.empty((0, 0)),
            [],
        )
    variance, correlation = _ring_noise(sectors, np.array(pixels), np.array(lengths))
    return np.array(distances), np.array(values), variance, correlation, positions


def _ring_quantiles(distances: Array) -> Array:
    """Return equidistant quantiles of distances, shape (pixel,)."""
    return np.quantile(
        distances, (np.arange(ACCURACY.pixels_per_ring) + 0.5) / ACCURACY.pixels_per_ring
    )


def _sectors(values: Array, angle: Array, count: int) -> Array:
    """Return the sectors' means less their mean, ordered by angle, shape (sector,)."""
    sector = ((angle / (2 * np.pi) + 0.5) * count).astype(int) % count
    number = np.bincount(sector, minlength=count)
    parts = np.bincount(sector, values, minlength=count)[number > 0] / number[number > 0]
    return parts - parts.mean()


def _ring_noise(sectors: list[Array], pixels: Array, borders: Array) -> tuple[Array, Array]:
    """Return variances of rings' means, shape (ring,), and their correlations, shape (ring, ring).

    `sectors`: sector means of every ring less their mean, DN; `pixels`, `borders`: pixels of every
    ring, shape (ring,), and its inner and outer radius, px, shape (ring, 2).

    Notes
    -----
    A pulse on a border contributes to both sides, so that adjacent sums covary by the border's
    length times a correlation length l. Adjacent sectors of length s are correlated by l/s, which
    gives l. The variance of a ring is 1 + 2 l/s times that of its sectors, and rings of widths v
    and w are correlated by l/sqrt(v w). The variance per pixel is averaged over adjacent rings:
    that of few sectors may be too small by chance.
    """
    count = np.array([len(sector) for sector in sectors], float)
    square = np.array([sector @ sector for sector in sectors]) + 1e-300
    sector_correlation = float(
        np.average([sector @ np.roll(sector, 1) for sector in sectors] / square, weights=count)
    )
    # Subtracting their mean reduces the correlation of sectors.
    size = float(count.mean())
    correlated_sectors = (1.0 + sector_correlation * (size - 1.0)) / (
        size - 2.0 + 2.0 * sector_correlation
    )
    # Noise is correlated over at most one pixel across a border.
    correlation_px = float(np.clip(correlated_sectors * ACCURACY.sector_px, 0.0, 1.0))
    wider = 1.0 + 2.0 * correlation_px / ACCURACY.sector_px
    by_pixel = pixels * wider * square / (count - wider) / count
    weight = np.eye(count.size) + np.eye(count.size, k=1) + np.eye(count.size, k=-1)
    variance = (weight @ (count * by_pixel)) / (weight @ count) / pixels + 1e-6
    width = np.diff(borders, axis=1)[:, 0]
    touch = np.isclose(borders[1:, 0], borders[:-1, 1])
    adjacent = np.where(touch, correlation_px / np.sqrt(width[1:] * width[:-1]), 0.0)
    return variance, np.eye(count.size) + np.diag(adjacent, 1) + np.diag(adjacent, -1)
