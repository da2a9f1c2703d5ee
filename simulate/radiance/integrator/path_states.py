"""Path states of the compiled path tracer, and the sampling of their directions."""

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from simulate.radiance.geometry.embree import INLINED, ROW
from simulate.radiance.geometry.ray_tracer import CLEARANCE_SHARE
from simulate.radiance.integrator.low_discrepancy import R2

# Paths traced together: enough that the active ones fill Embree's packets.
WAVE = 256
# What each pair of an `Even` stretch adds: to the square of the radius, and to the turn.
STEP, TURN_X, TURN_Y = float(R2[0]), float(np.cos(2.0 * np.pi * R2[1])), float(np.sin(2.0 * np.pi * R2[1]))


@numba.njit(**INLINED)
def uniform(state: Any) -> float:
    """Draw a uniform number in [0, 1): SplitMix64 (Steele, Lea and Flood, 2014)."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return float((z ^ (z >> np.uint64(31))) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@numba.njit(**INLINED)
def set_direction(normal: Any, u: float, v: float, w: float, way: Any) -> None:
    """Set a direction from its components in the frame of a normal, as `shading_frames`."""
    x, y, z = normal[0], normal[1], normal[2]
    sign = 1.0 if z >= 0.0 else -1.0
    a = -1.0 / (sign + z)
    b = x * y * a
    way[0] = u * (1.0 + sign * x * x * a) + v * b + w * x
    way[1] = u * sign * b + v * (sign + y * y * a) + w * y
    way[2] = -u * sign * x - v * y + w * z


@numba.njit(**INLINED)
def in_disc(state: Any) -> tuple[float, float, float]:
    """Draw a uniform point of the unit disc, in the form of `first_even`, by rejection."""
    square, x, y = 2.0, 1.0, 0.0
    while square > 1.0:
        x, y = 2.0 * uniform(state) - 1.0, 2.0 * uniform(state) - 1.0
        square = x * x + y * y
    radius = np.sqrt(square)
    return (square, x / radius, y / radius) if radius > 0.0 else (0.0, 1.0, 0.0)


@numba.njit(**INLINED)
def first_even(pair: Any) -> tuple[float, float, float]:
    """Return the point of the unit disc of a quasi-random pair: radius squared, cosine and sine of its angle."""
    turn = 2.0 * np.pi * pair[1]
    return pair[0], np.cos(turn), np.sin(turn)


@numba.njit(**INLINED)
def next_even(now: Any) -> tuple[float, float, float]:
    """Go one step along an `Even` stretch: from ray to ray the turn grows by as much, so no sine is computed anew."""
    square, along, across = now[0] + STEP, now[1], now[2]
    if square >= 1.0:
        square -= 1.0
    return square, along * TURN_X - across * TURN_Y, along * TURN_Y + across * TURN_X


@numba.njit(**INLINED)
def by_cosine(normal: Any, foot: Any, way: Any) -> float:
    """Set a direction by the cosine law, over a uniform point of the disc (Malley), and return its cosine."""
    radius, cosine = np.sqrt(foot[0]), np.sqrt(max(1.0 - foot[0], 0.0))
    set_direction(normal, radius * foot[1], radius * foot[2], cosine, way)
    return cosine


@numba.njit(**INLINED)
def set_ray_start(clearance: Any, centre: Any, face: Any, place: Any, normal: Any, start: Any) -> None:
    """Set where a ray from a surface starts, as `Tracer.above`."""
    shift = 0.0
    for axis in range(3):
        shift = max(shift, abs(place[axis] - centre[axis]))
    shift = max(clearance[face & ROW], CLEARANCE_SHARE * shift)
    for axis in range(3):
        start[axis] = place[axis] + shift * normal[axis]


class PathStates(NamedTuple):
    """The paths of a wave, one a row.

    Parameters
    ----------
    active
        Indices of active paths, in order; their number is passed separately.
    shadow_rays
        Indices of paths with a shadow ray, by the slot of the ray.
    point, face
        Shading point at which each path starts, and the triangle of its current vertex.
    weight, throughput
        Contribution to the irradiance of the start per radiance from ahead, and per irradiance of the current vertex,
        shape (path, band).
    place, start, normal, direction, target_direction
        Current vertex, ray start above it, normal on the side of the path, ray direction, and direction of a shadow
        ray, shape (path, 3).
    cosine, reflectance
        Cosine of the direction at the last vertex, and mean reflectance of the current one.
    factor, chosen
        Factor of the chosen source, and its number.
    by_ray
        Density with which paths reach the vertex, m-2.
    """

    active: NDArray[np.int64]
    shadow_rays: NDArray[np.int64]
    point: NDArray[np.int64]
    face: NDArray[np.int64]
    weight: NDArray[np.float32]
    throughput: NDArray[np.float32]
    place: NDArray[np.float64]
    start: NDArray[np.float64]
    normal: NDArray[np.float64]
    direction: NDArray[np.float64]
    target_direction: NDArray[np.float64]
    cosine: NDArray[np.float64]
    reflectance: NDArray[np.float64]
    factor: NDArray[np.float64]
    chosen: NDArray[np.int64]
    by_ray: NDArray[np.float64]

    @classmethod
    def of(cls, bands: int) -> "PathStates":
        """Return empty arrays for a wave."""

        def index() -> NDArray[np.int64]:
            return np.zeros(WAVE, np.int64)

        def light() -> NDArray[np.float32]:
            return np.zeros((WAVE, bands), np.float32)

        def real(*axes: int) -> NDArray[np.float64]:
            return np.zeros((WAVE, *axes))

        return cls(
            active=index(), shadow_rays=index(), point=index(), face=index(),
            weight=light(), throughput=light(),
            place=real(3), start=real(3), normal=real(3), direction=real(3), target_direction=real(3),
            cosine=real(), reflectance=real(), factor=real(), chosen=index(), by_ray=real(),
        )  # fmt: skip
