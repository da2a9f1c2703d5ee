"""Pixels around a source by ring and sector: means of rings, and how surely they are known from what sectors differ."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SECTORS = 24
# Rings so near the centre that few sectors have a pixel in them: the noise of single pixels is added to their means.
FEW_PIXELS = 4


@dataclass(frozen=True, kw_only=True)
class Polar:
    """Where every pixel lies as seen from a source.

    Parameters
    ----------
    dx, dy
        Distances from the source along rows and columns, column pitches, shape (row, col).
    radius
        Distance, column pitches, shape (row, col).
    ring, sector
        Number of the ring, one column pitch wide, and of the sector, shape (row, col).
    row_pitch
        Row pitch over column pitch.
    """

    dx: Array
    dy: Array
    radius: Array
    ring: NDArray[np.intp]
    sector: NDArray[np.intp]
    row_pitch: float

    @property
    def rings(self) -> int:
        """Number of rings, those cut by the border included."""
        return int(self.ring.max()) + 1


def polar_of(shape: tuple[int, int], row: float, col: float, row_pitch: float) -> Polar:
    """Return the places of the pixels of a frame as seen from (row, col)."""
    down = (np.arange(shape[0]) - row)[:, None] * row_pitch
    dx, dy = np.broadcast_arrays((np.arange(shape[1]) - col)[None, :], down)
    radius = np.hypot(dx, dy)
    sector = ((np.arctan2(dy, dx) / (2 * np.pi) + 0.5) * SECTORS).astype(np.intp) % SECTORS
    return Polar(dx=dx, dy=dy, radius=radius, ring=radius.astype(np.intp), sector=sector, row_pitch=row_pitch)


@dataclass(frozen=True, kw_only=True)
class Rings:
    """Sums over the cells of a picture.

    Parameters
    ----------
    total, count
        Sum and number of pixels of each cell, shape (ring, sector).
    radius
        Mean radius of each ring, column pitches, shape (ring,).
    whole
        Share of each ring that lies inside the frame, shape (ring,).
    """

    total: Array
    count: Array
    radius: Array
    whole: Array

    def mean(self, sectors: NDArray[np.bool_] | None = None) -> Array:
        """Ring means over the sectors chosen, shape (ring,)."""
        chosen = np.ones(SECTORS, bool) if sectors is None else sectors
        return self.total[:, chosen].sum(axis=1) / np.maximum(self.count[:, chosen].sum(axis=1), 1.0)

    def median(self) -> Array:
        """Median of the sectors of each ring, which a streak or another source in a few of them does not move."""
        cells = np.sort(np.where(self.count > 0, self.total / np.maximum(self.count, 1.0), np.inf), axis=1)
        occupied = (self.count > 0).sum(axis=1)
        rows, upper = np.arange(len(cells)), np.minimum(occupied // 2, SECTORS - 1)
        lower = np.maximum((occupied - 1) // 2, 0)
        return np.where(occupied > 0, 0.5 * (cells[rows, lower] + cells[rows, upper]), 0.0)

    def draws(self, pixel_sd: Array, count: int, rng: np.random.Generator, sectors: NDArray[np.bool_]) -> Array:
        """Draw ring means as they might have come, shape (draw, ring).

        The sectors are weighted at random (a bootstrap of blocks): what ties the noise of neighbouring pixels, rings
        and frames is kept. `pixel_sd` is the noise of a pixel of the mean frame in each ring, shape (ring,).
        """
        mean, number = self.mean(sectors), np.maximum(self.count[:, sectors].sum(axis=1), 1.0)
        apart = (self.total - mean[:, None] * self.count)[:, sectors] / number[:, None]
        weights = rng.standard_normal((count, apart.shape[1])) * np.sqrt(apart.shape[1] / max(apart.shape[1] - 1, 1))
        near = np.where(self.radius < FEW_PIXELS, pixel_sd / np.sqrt(number), 0.0)
        return mean + weights @ apart.T + near * rng.standard_normal((count, len(mean)))


def rings_of(image: Array, polar: Polar) -> Rings:
    """Sum a picture over rings and sectors."""
    rings = polar.rings
    cell = (polar.ring * SECTORS + polar.sector).ravel()
    size = rings * SECTORS
    count = np.bincount(cell, minlength=size).reshape(rings, SECTORS).astype(float)
    total = np.bincount(cell, image.ravel(), minlength=size).reshape(rings, SECTORS).astype(float)
    pixels = np.maximum(count.sum(axis=1), 1.0)
    radius = np.bincount(polar.ring.ravel(), polar.radius.ravel(), minlength=rings) / pixels
    full = np.pi * (2.0 * np.arange(rings) + 1.0) / polar.row_pitch
    return Rings(total=total, count=count, radius=radius, whole=count.sum(axis=1) / full)
