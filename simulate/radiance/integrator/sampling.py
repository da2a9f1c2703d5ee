"""Random and low-discrepancy samples (R2 sequence) of discs and hemispheres, in NumPy and in
compiled loops.
"""

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from simulate.arrays import Array, Index
from simulate.radiance.geometry.embree import INLINED, ROW
from simulate.radiance.geometry.ray_tracer import CLEARANCE_SHARE

# Increments of the R2 sequence (Roberts, 2018): powers of the inverse plastic number.
R2 = np.array([0.7548776662466927, 0.5698402909980532])
# Inverse of the increment of that sequence in six dimensions, x^7 = x + 1.
R6 = 1.1127756842787055
# Points along the side of a tile of a grid that use one sequence.
TILE = 8
# What a step of the sequence adds to the square of the radius, and the turn by which it rotates a
# point of the disc.
STEP, TURN_X, TURN_Y = (
    float(R2[0]),
    float(np.cos(2.0 * np.pi * R2[1])),
    float(np.sin(2.0 * np.pi * R2[1])),
)


def fraction(values: Array) -> Array:
    """Return the fractional part, in [0, 1): ten times as fast as NumPy's remainder."""
    return values - np.floor(values)


@dataclass(frozen=True)
class SequenceSlice:
    """A slice of the sequence for each of several points: its first pair, shape (point, 2), and its
    length.
    """

    start: Array
    rays: int

    @classmethod
    def random(cls, points: int, rays: int, rng: np.random.Generator) -> "SequenceSlice":
        """Return slices with independent random starts."""
        return cls(rng.random((points, 2)), rays)

    def select(self, indices: Index) -> "SequenceSlice":
        """Return the slices of some points."""
        return SequenceSlice(self.start[indices], self.rays)

    def divide(self, parts: int) -> "SequenceSlice":
        """Split each slice into equal consecutive parts."""
        part_rays = self.rays // parts
        start = self.start[:, None] + (part_rays * np.arange(parts))[:, None] * R2
        return SequenceSlice(fraction(start.reshape(-1, 2)), part_rays)

    def pairs(self) -> Array:
        """Return all pairs, shape (point, ray, 2)."""
        return fraction(self.start[:, None] + np.arange(self.rays)[:, None] * R2)


@dataclass
class LowDiscrepancyNumbers:
    """Numbers of a low-discrepancy sequence in place of a generator's, for rays of several points.

    Each number of a ray is a further dimension of the R sequence (Roberts, 2018), with a random
    shift for each point.
    """

    points: int
    rays: int
    rng: np.random.Generator
    dimensions: int = 0  # dimensions so far

    def random(self, shape: Any) -> Array:
        """Return numbers in [0, 1) of a shape whose first axis is the rays, point by point."""
        count = int(np.prod(np.atleast_1d(shape))) // (self.points * self.rays)
        step = R6 ** -(self.dimensions + 1.0 + np.arange(count))
        self.dimensions += count
        start = self.rng.random((self.points, 1, count))
        return fraction(start + (np.arange(self.rays)[:, None] + 1.0) * step).reshape(shape)


def low_discrepancy_points(row: Index, col: Index, rays: int, seed: list[int]) -> SequenceSlice:
    """Return slices for rays of points on a grid, with a random shift for each tile.

    The points of a tile use consecutive slices in Morton order, so that every quarter of a tile is
    one slice: the rays of a neighbourhood are together as uniform as those of one point.
    """
    tiles = (int(row.max(initial=0)) // TILE + 1, int(col.max(initial=0)) // TILE + 1)
    shift = np.random.default_rng(seed).random((*tiles, 2))[row // TILE, col // TILE]
    azimuth = np.zeros(len(row), np.int64)
    for bit in range(TILE.bit_length() - 1):
        azimuth |= (col >> bit & 1) << 2 * bit | (row >> bit & 1) << 2 * bit + 1
    return SequenceSlice(fraction(shift + (azimuth * rays)[:, None] * R2), rays)


def shading_frames(normal: Array) -> Array:
    """Return axes (x, y, z) with z along unit normals, as rows: shape (point, 3, 3).

    Notes
    -----
    Duff et al., Building an Orthonormal Basis, Revisited, JCGT 6 (2017) 1: no branch, no loss near
    any pole.
    """
    x, y, z = normal[:, 0], normal[:, 1], normal[:, 2]
    sign = np.where(z >= 0.0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    x_axis = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=1)
    y_axis = np.stack([b, sign + y * y * a, -y], axis=1)
    return np.stack([x_axis, y_axis, normal], axis=1).astype(np.float64)


def cosine_lobe(pairs: Array) -> Array:
    """Return directions by the cosine law about z for pairs of numbers in [0, 1), shape (ray, 3)
    (Malley).
    """
    radius, azimuth = np.sqrt(pairs[:, 0]), 2.0 * np.pi * pairs[:, 1]
    return np.stack(
        [radius * np.cos(azimuth), radius * np.sin(azimuth), np.sqrt(1.0 - pairs[:, 0])], axis=1
    )


@numba.njit(**INLINED)
def uniform(state: Any) -> float:
    """Draw a uniform number in [0, 1): SplitMix64 (Steele, Lea and Flood, 2014)."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return float((z ^ (z >> np.uint64(31))) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@numba.njit(**INLINED)
def set_direction(normal: Any, u: float, v: float, w: float, direction: Any) -> None:
    """Set a direction from its components in the frame of a normal, as `shading_frames`."""
    x, y, z = normal[0], normal[1], normal[2]
    sign = 1.0 if z >= 0.0 else -1.0
    a = -1.0 / (sign + z)
    b = x * y * a
    direction[0] = u * (1.0 + sign * x * x * a) + v * b + w * x
    direction[1] = u * sign * b + v * (sign + y * y * a) + w * y
    direction[2] = -u * sign * x - v * y + w * z


@numba.njit(**INLINED)
def draw_disc_point(state: Any) -> tuple[float, float, float]:
    """Draw a uniform point of the unit disc, in the form of `first_disc_point`, by rejection."""
    square, x, y = 2.0, 1.0, 0.0
    while square > 1.0:
        x, y = 2.0 * uniform(state) - 1.0, 2.0 * uniform(state) - 1.0
        square = x * x + y * y
    radius = np.sqrt(square)
    return (square, x / radius, y / radius) if radius > 0.0 else (0.0, 1.0, 0.0)


@numba.njit(**INLINED)
def first_disc_point(pair: Any) -> tuple[float, float, float]:
    """Return the point of the unit disc of a pair: radius squared, cosine and sine of its angle."""
    azimuth = 2.0 * np.pi * pair[1]
    return pair[0], np.cos(azimuth), np.sin(azimuth)


@numba.njit(**INLINED)
def next_disc_point(point: Any) -> tuple[float, float, float]:
    """Go one step along a slice: the turn grows by a constant, so that no sine is computed."""
    square, cosine, sine = point[0] + STEP, point[1], point[2]
    if square >= 1.0:
        square -= 1.0
    return square, cosine * TURN_X - sine * TURN_Y, cosine * TURN_Y + sine * TURN_X


@numba.njit(**INLINED)
def set_cosine_direction(normal: Any, point: Any, direction: Any) -> float:
    """Set a direction by the cosine law, over a uniform point of the disc (Malley), and return its
    cosine.
    """
    radius, cosine = np.sqrt(point[0]), np.sqrt(max(1.0 - point[0], 0.0))
    set_direction(normal, radius * point[1], radius * point[2], cosine, direction)
    return cosine


@numba.njit(**INLINED)
def set_ray_start(
    clearance: Any, centre: Any, face: Any, position: Any, normal: Any, start: Any
) -> None:
    """Set where a ray from a surface starts, as `RayTracer.ray_starts`."""
    shift = 0.0
    for axis in range(3):
        shift = max(shift, abs(position[axis] - centre[axis]))
    shift = max(clearance[face & ROW], CLEARANCE_SHARE * shift)
    for axis in range(3):
        start[axis] = position[axis] + shift * normal[axis]
