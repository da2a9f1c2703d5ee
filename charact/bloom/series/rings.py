"""Rings about a point source: their pixels, and how light worked out along the radius is averaged over them."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Farthest ring, column pitches, and share of a ring that must lie inside the frame for it to count.
REACH_PX = 90
LEAST_SHARE = 0.34
INNERMOST = 3
# Share of a ring's pixels that must be left unspoiled for it to say anything.
LEAST_LEFT = 0.3
# Nodes of the radius on which light is worked out: fine where a core is steep, coarser beyond.
FINE_PX, COARSE_PX, FINE_TO_PX = 0.125, 0.4, 8.0
SECTORS = 16


@dataclass(frozen=True, kw_only=True)
class Geometry:
    """Which pixels make up the rings about a place, and where light is worked out to be averaged over them.

    Parameters
    ----------
    rows, cols
        Slices of the frame that hold all rings.
    order
        Pixels of that window, ring by ring, flat indices.
    first
        Where each ring begins in `order`, shape (ring,).
    radius_px
        Mean radius of each ring, column pitches, shape (ring,).
    count
        Pixels of each ring, shape (ring,).
    lost
        Rings most of whose pixels are spoiled: they have them all and say nothing, shape (ring,).
    node_px
        Radii at which light is worked out, column pitches, shape (node,).
    pixel_radius_px, pixel_angle
        Radius, column pitches, and angle, radians, of each pixel of `order`.
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
        """Takes light at the nodes to ring means, shape (ring, node)."""
        ring = np.repeat(np.arange(len(self.count)), self.count.astype(int))
        return _averages(self.pixel_radius_px, ring, self.node_px, len(self.count))

    def within(self, rings: int) -> "Geometry":
        """Return the innermost rings."""
        size = int(self.count[:rings].sum())
        nodes = self.node_px < self.radius_px[:rings][-1] + 4 * COARSE_PX
        return replace(
            self,
            order=self.order[:size],
            first=self.first[:rings],
            radius_px=self.radius_px[:rings],
            count=self.count[:rings],
            lost=self.lost[:rings],
            node_px=self.node_px[nodes],
            pixel_radius_px=self.pixel_radius_px[:size],
            pixel_angle=self.pixel_angle[:size],
        )

    def pixels(self, frames: NDArray) -> Array:
        """Return the rings' pixels in their order, shape (frame, row, col) -> (frame, pixel)."""
        window = np.asarray(frames[:, self.rows, self.cols], np.float64).reshape(len(frames), -1)
        return window[:, self.order]

    def means(self, pixels: Array) -> Array:
        """Average pixels in their order over rings, shape (.., pixel) -> (.., ring)."""
        return np.add.reduceat(pixels, self.first, axis=-1) / self.count

    def largest(self, pixels: Array) -> Array:
        """Largest pixel of each ring, shape (pixel,) -> (ring,)."""
        return np.maximum.reduceat(pixels, self.first)

    def sector_means(self, pixels: Array) -> Array:
        """Average pixels in their order over the sectors of rings, shape (pixel,) -> (sector, ring); NaN where none."""
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
    """Return the rings about a place, one column pitch wide each.

    Parameters
    ----------
    shape
        Of the frame.
    row, col
        Centre, px.
    pitch_ratio
        Row pitch over column pitch.
    spoiled
        Pixels to leave out, shape of the frame.
    reach_px
        Farthest ring asked for; rings end where less than `LEAST_SHARE` of one lies inside the frame.
    """
    up = int(np.ceil(reach_px / pitch_ratio))
    rows = slice(max(0, int(row) - up), min(shape[0], int(row) + up + 2))
    cols = slice(max(0, int(col) - reach_px), min(shape[1], int(col) + reach_px + 2))
    dy = (np.arange(rows.start, rows.stop) - row)[:, None] * pitch_ratio
    dx = (np.arange(cols.start, cols.stop) - col)[None, :]
    radius = np.hypot(dx, dy).ravel()
    ring = radius.astype(np.int64)
    inside = ring < reach_px
    whole = np.pi * (2 * np.arange(reach_px) + 1) / pitch_ratio
    enough = np.bincount(ring[inside], minlength=reach_px) > LEAST_SHARE * whole
    # The innermost rings are a few pixels each, more or fewer as the place lies among them.
    enough[:INNERMOST] |= np.bincount(ring[inside], minlength=reach_px)[:INNERMOST] > 0
    reach = int(np.argmin(enough)) if not enough.all() else reach_px
    kept = ring < reach
    lost = np.zeros(reach, bool)
    if spoiled is not None:
        clean = kept & ~spoiled[rows, cols].ravel()
        left = np.bincount(ring[clean], minlength=reach) / np.bincount(ring[kept], minlength=reach)
        lost = left < LEAST_LEFT
        kept &= clean | lost[np.minimum(ring, reach - 1)]
    order = np.flatnonzero(kept)
    order = order[np.argsort(ring[order], kind="stable")]
    _, first, count = np.unique(ring[order], return_index=True, return_counts=True)
    down, across = (np.broadcast_to(way, (dy.size, dx.size)).ravel()[order] for way in (dy, dx))
    return Geometry(
        rows=rows,
        cols=cols,
        order=order,
        first=first,
        radius_px=np.add.reduceat(radius[order], first) / count,
        count=count.astype(float),
        lost=lost,
        node_px=_nodes(reach + 1.0),
        pixel_radius_px=radius[order],
        pixel_angle=np.arctan2(down, across),
    )


def _nodes(reach_px: float) -> Array:
    fine = np.arange(0.0, FINE_TO_PX, FINE_PX)
    return np.concatenate([fine, np.arange(FINE_TO_PX, reach_px + 3 * COARSE_PX, COARSE_PX)])


def _averages(radius: Array, ring: NDArray[np.int64], nodes: Array, rings: int) -> Array:
    """Weights of cubic interpolation between nodes, averaged over each ring's pixels."""
    place = np.clip(np.searchsorted(nodes, radius) - 2, 0, len(nodes) - 4)
    four = place[:, None] + np.arange(4)
    x = nodes[four]
    weight = np.ones_like(x)
    for one in range(4):
        for other in range(4):
            if other != one:
                weight[:, one] *= (radius - x[:, other]) / (x[:, one] - x[:, other])
    cell = (ring[:, None] * len(nodes) + four).ravel()
    out = np.bincount(cell, weight.ravel(), minlength=rings * len(nodes)).reshape(rings, -1)
    return out / np.bincount(ring, minlength=rings)[:, None]
