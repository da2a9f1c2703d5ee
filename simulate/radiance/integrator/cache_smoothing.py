"""Smoothing and interpolation of the irradiance cache: local plane fits along smooth surfaces."""

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from simulate.arrays import Array, Array32, Index, Mask
from simulate.radiance.geometry.embree import COMPILED, INLINED
from simulate.radiance.geometry.ray_tracer import NOTHING
from simulate.radiance.integrator.integrator_settings import Run

# Neighbours belong to one smooth surface if their normals differ by less than acos(0.98) = 11
# degrees, and if neither deviates from the other's plane by more than this fraction of their
# distance, or by the single-precision error.
SAME_NORMAL, OFF_PLANE, MIN_HEIGHT_M = 0.98, 0.05, 1e-5
# A plane fit needs at least this many nodes, else the mean is used; and rows of nodes in one job.
MIN_NODES, STRIP = 4, 16


@dataclass(frozen=True)
class Nodes:
    """A grid of surface points in view of a camera."""

    row: Index  # of the nodes that see a surface, shape (node,)
    col: Index
    position_m: Array  # shape (row, col, 3)
    normal: Array
    face: Index  # triangles, -1 where there is no surface, shape (row, col)

    @classmethod
    def of(
        cls,
        row: Index,
        col: Index,
        shape: tuple[int, int],
        position_m: Array,
        normal: Array,
        face: Index,
    ) -> "Nodes":
        """Return a grid of positions and normals (node, 3) and triangles (node,) at rows and
        columns (node,).
        """
        grid = cls(row, col, np.zeros((*shape, 3)), np.zeros((*shape, 3)), np.full(shape, NOTHING))
        grid.position_m[row, col], grid.normal[row, col], grid.face[row, col] = (
            position_m,
            normal,
            face,
        )
        return grid

    @property
    def has_surface(self) -> Mask:
        """Whether there is a surface, shape (row, col)."""
        return self.face != NOTHING

    def on_grid(self, values: NDArray) -> NDArray:
        """Return values (node, ...) on the grid, zero without a surface."""
        grid = np.zeros((*self.has_surface.shape, *values.shape[1:]), values.dtype)
        grid[self.row, self.col] = values
        return grid

    def smooth(self, values: Array, width: Index, run: Run) -> Array:
        """Return values (row, col, band) smoothed over windows of half widths (row, col), nodes."""
        smoothed, rows = np.zeros_like(values), len(values)

        def strip(first: int) -> None:
            _fit(
                values,
                self.position_m,
                self.normal,
                self.face,
                width,
                first,
                min(first + STRIP, rows),
                smoothed,
            )

        list(run(strip, list(range(0, rows, STRIP))))
        return smoothed

    def interpolate(
        self, values: Array32, row: Array, col: Array, position_m: Array, normal: Array
    ) -> tuple[Array32, Mask]:
        """Interpolate values (row, col, band) at points; return also which points had a node on
        their surface.

        Coordinates (point,) are integers at nodes; positions and normals have shape (point, 3).
        """
        interpolated, has_node = (
            np.zeros((len(row), values.shape[2]), np.float32),
            np.zeros(len(row), np.bool_),
        )
        _interpolate(
            values,
            self.position_m,
            self.normal,
            self.face,
            row,
            col,
            position_m,
            normal,
            interpolated,
            has_node,
        )
        return interpolated, has_node


@numba.njit(**INLINED)
def is_same_surface(position: Any, normal: Any, other_position: Any, other_normal: Any) -> bool:
    """Return whether two points lie on one smooth surface."""
    normal_cosine, height, other_height, square = 0.0, 0.0, 0.0, 0.0
    for axis in range(3):
        step = other_position[axis] - position[axis]
        normal_cosine += normal[axis] * other_normal[axis]
        height += normal[axis] * step
        other_height += other_normal[axis] * step
        square += step * step
    limit = OFF_PLANE * np.sqrt(square) + MIN_HEIGHT_M
    return normal_cosine > SAME_NORMAL and abs(height) < limit and abs(other_height) < limit


@numba.njit(**COMPILED)
def same_surface_pairs(position: Any, normal: Any, other_position: Any, other_normal: Any) -> Any:
    """Return which pairs of points (pair, 3), with unit normals, lie on one smooth surface, shape
    (pair,).
    """
    same_surface = np.empty(len(position), np.bool_)
    for pair in range(len(same_surface)):
        same_surface[pair] = is_same_surface(
            position[pair], normal[pair], other_position[pair], other_normal[pair]
        )
    return same_surface


@numba.njit(**COMPILED)
def _fit(
    values: Any,
    position: Any,
    normal: Any,
    face: Any,
    width: Any,
    first: int,
    last: int,
    smoothed: Any,
) -> None:
    """Fit a plane over row and column to the values in the window of each node, and store its value
    at the centre.

    Arrays are those of `Nodes` and shape (row, col, band); windows have half widths (row, col).
    """
    rows, columns, bands = values.shape
    plane = np.zeros((3, bands))
    for r in range(first, last):
        for c in range(columns):
            centre_face = face[r, c]
            if centre_face == NOTHING:
                continue
            h = width[r, c]
            n, x1, y1, xx, xy, yy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            plane[:] = 0.0
            for i in range(max(r - h, 0), min(r + h + 1, rows)):
                for j in range(max(c - h, 0), min(c + h + 1, columns)):
                    # Nodes on one triangle are on one surface.
                    if face[i, j] != centre_face and (
                        face[i, j] == NOTHING
                        or not is_same_surface(
                            position[r, c], normal[r, c], position[i, j], normal[i, j]
                        )
                    ):
                        continue
                    x, y = float(j - c), float(i - r)
                    n += 1.0
                    x1 += x
                    y1 += y
                    xx += x * x
                    xy += x * y
                    yy += y * y
                    for b in range(bands):
                        value = values[i, j, b]
                        plane[0, b] += value
                        plane[1, b] += value * x
                        plane[2, b] += value * y
            # Constant of the normal equations, by Cramer's rule.
            a, p, q = xx * yy - xy * xy, xy * y1 - x1 * yy, x1 * xy - xx * y1
            determinant = n * a + x1 * p + y1 * q
            is_mean = n < MIN_NODES or determinant < 1e-6 * n * max(xx * yy, 1e-30)
            for b in range(bands):
                if is_mean:
                    smoothed[r, c, b] = plane[0, b] / n
                else:
                    smoothed[r, c, b] = (
                        plane[0, b] * a + plane[1, b] * p + plane[2, b] * q
                    ) / determinant


@numba.njit(**COMPILED)
def _interpolate(
    values: Any,
    position: Any,
    normal: Any,
    face: Any,
    row: Any,
    col: Any,
    point: Any,
    point_normal: Any,
    interpolated: Any,
    has_node: Any,
) -> None:
    """Interpolate nodes at points (ray,) between them, among nodes on the same surface."""
    rows, columns, bands = values.shape
    for ray in range(len(row)):
        first_row, first_column = int(np.floor(row[ray])), int(np.floor(col[ray]))
        total = 0.0
        for margin in range(2):
            for i in range(max(first_row - margin, 0), min(first_row + 2 + margin, rows)):
                for j in range(
                    max(first_column - margin, 0), min(first_column + 2 + margin, columns)
                ):
                    if face[i, j] == NOTHING or not is_same_surface(
                        point[ray], point_normal[ray], position[i, j], normal[i, j]
                    ):
                        continue
                    span = 1.0 + margin
                    weight = (
                        max(span - abs(row[ray] - i), 0.0) * max(span - abs(col[ray] - j), 0.0)
                        + 1e-6
                    )
                    total += weight
                    for b in range(bands):
                        interpolated[ray, b] += weight * values[i, j, b]
            if total > 0.0:
                break
        has_node[ray] = total > 0.0
        if total > 0.0:
            for b in range(bands):
                interpolated[ray, b] /= total
