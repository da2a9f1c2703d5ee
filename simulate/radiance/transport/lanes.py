"""The rays of a packet as compiled loops keep them, and the directions that they take."""

from typing import Any

import numba
import numpy as np

from simulate.radiance.embree import COMPILED, PACKET
from simulate.radiance.trace import CLEARANCE_SHARE


@numba.njit(**COMPILED)
def uniform(state: Any) -> float:
    """Draw an even number in [0, 1): SplitMix64 (Steele, Lea and Flood, 2014)."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return float((z ^ (z >> np.uint64(31))) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@numba.njit(**COMPILED)
def turned(normal: Any, u: float, v: float, w: float, way: Any) -> None:
    """Set a direction from its parts in the frame of a normal, that of `points.frames`."""
    x, y, z = normal[0], normal[1], normal[2]
    sign = 1.0 if z >= 0.0 else -1.0
    a = -1.0 / (sign + z)
    b = x * y * a
    way[0] = u * (1.0 + sign * x * x * a) + v * b + w * x
    way[1] = u * sign * b + v * (sign + y * y * a) + w * y
    way[2] = -u * sign * x - v * y + w * z


@numba.njit(**COMPILED)
def by_cosine(normal: Any, square: float, turn: float, way: Any) -> float:
    """Set a direction by the cosine law from two even numbers, and return its cosine."""
    radius, cosine = np.sqrt(square), np.sqrt(1.0 - square)
    turned(normal, radius * np.cos(2.0 * np.pi * turn), radius * np.sin(2.0 * np.pi * turn), cosine, way)
    return cosine


@numba.njit(**COMPILED)
def raised(clearance: Any, centre: Any, face: Any, place: Any, normal: Any, start: Any) -> None:
    """Set where a ray from a surface starts, as `Tracer.above`."""
    shift = 0.0
    for axis in range(3):
        shift = max(shift, abs(place[axis] - centre[axis]))
    shift = max(clearance[face], CLEARANCE_SHARE * shift)
    for axis in range(3):
        start[axis] = place[axis] + shift * normal[axis]


@numba.njit(**COMPILED)
def new_lanes(bands: int) -> Any:
    """Room for the rays of a packet, a row for each.

    Whether it goes on, its owner, the triangle it is at, weight and light leaving by band; place, start above it,
    normal and direction; cosine of the direction, mean of what the place reflects, a factor, the source asked, and the
    density per m2 with which rays find the place.
    """
    return (
        np.zeros(PACKET, np.bool_), np.zeros(PACKET, np.int64), np.zeros(PACKET, np.int64),
        np.zeros((PACKET, bands), np.float32), np.zeros((PACKET, bands), np.float32),
        np.zeros((PACKET, 3)), np.zeros((PACKET, 3)), np.zeros((PACKET, 3)), np.zeros((PACKET, 3)),
        np.zeros(PACKET), np.zeros(PACKET), np.zeros(PACKET), np.zeros(PACKET, np.int64), np.zeros(PACKET),
    )  # fmt: skip
