"""Light tracing: paths started at lamps, for small bright patches that gather rays seldom meet.

A ray leaves the lamp by its intensity distribution; the surface that it hits is connected to the
gathering point. Gather rays sample the same patches, and both are combined by the balance heuristic
(Veach and Guibas, 1995), so that neither a patch close to the lamp nor one close to the point
causes bright outliers. It costs two to three rays for each gather ray and is used only for lamps
for which it reduces the variance strongly.
"""

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from simulate.radiance.geometry.embree import (
    COMPILED,
    INLINED,
    ROW,
    intersect,
    is_ray_occluded,
    meet_plane,
    set_ray,
    trace_occlusion,
    triangle_of,
)
from simulate.radiance.geometry.ray_tracer import NOTHING, RayTracer
from simulate.radiance.integrator.light_sources import SHORT, LampLight, lamp_factor, towards_lamp
from simulate.radiance.integrator.sampling import (
    cosine_lobe,
    set_ray_start,
    shading_frames,
    uniform,
)

Array = NDArray[np.floating]

# Rings of equal light about a lamp's axis, from which directions are drawn; samples in both angles
# that define them.
RINGS, ANGLES, AROUND = 64, 2000, 24
# Test rays that decide whether a lamp is light-traced: if light tracing would sample this fraction
# of its light, or if the mean square of the gather estimate is this many times larger.
TRIED, SHARE, GAIN = 512, 0.7, 20.0
# Below this weight only gather rays sample the light, which saves a shadow ray.
LEAST = 0.01


@dataclass(frozen=True, kw_only=True)
class LightTracingSettings:
    """Sampling of lamp directions by intensity."""

    worth: NDArray[np.bool_]  # whether each lamp is light-traced
    falls: Array  # 1 less the cosines between rings about the lamps' axes, shape (lamp, ring + 1)

    @classmethod
    def of(cls, lamps: tuple[LampLight, ...], tracer: RayTracer) -> "LightTracingSettings":
        """Return the settings of lamps among surfaces."""
        falls = np.array([_rings(lamp) for lamp in lamps]).reshape(-1, RINGS + 1)
        worth = [_worth(lamp, rings, tracer) for lamp, rings in zip(lamps, falls, strict=True)]
        return cls(worth=np.array(worth, np.bool_), falls=falls)

    def arrays(
        self, lamps: tuple[LampLight, ...], some: NDArray[np.bool_]
    ) -> tuple[NDArray, NDArray, NDArray]:
        """Return the probabilities of some of the lamps, their cumulative sums, and the ring
        limits.
        """
        power = np.array([float(lamp.spectrum.sum()) for lamp in lamps])[some]
        power[~self.worth[some]] = 0.0
        chance = power / power.sum() if power.sum() > 0.0 else np.zeros(0)
        return chance, np.cumsum(chance), self.falls[some]


def _rings(lamp: LampLight) -> Array:
    """Return 1 minus the cosines of the limits of rings of equal light about a lamp's axis, shape
    (ring + 1,).
    """
    polar = np.pi * np.linspace(0.0, 1.0, ANGLES) ** 2
    turn = 2.0 * np.pi * (np.arange(AROUND) + 0.5) / AROUND
    sine = np.sin(polar)[:, None]
    way = np.stack(
        np.broadcast_arrays(sine * np.cos(turn), sine * np.sin(turn), np.cos(polar)[:, None]),
        axis=-1,
    )
    density = (
        lamp.distribution.per_sr(way.reshape(-1, 3)).reshape(ANGLES, AROUND).mean(axis=1)
        * sine[:, 0]
    )
    so_far = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(polar))])
    # A uniform part of 1e-6 keeps rings distinct where a table is dark.
    so_far += 1e-6 * so_far[-1] * polar / np.pi
    edge = np.interp(np.linspace(0.0, so_far[-1], RINGS + 1), so_far, polar)
    return 2.0 * np.sin(0.5 * edge) ** 2


def _worth(lamp: LampLight, falls: Array, tracer: RayTracer) -> bool:
    """Return whether light tracing samples a lamp's light by one reflection much better than gather
    rays.

    Notes
    -----
    Rays from the lamp give pairs of points. With the densities l and g of the first point by light
    tracing and by gather rays, and its radiance L, the weight of light tracing is l/(l + g); gather
    rays alone have the mean square of L, combined ones that of L g/(l + g).
    """
    rng = np.random.default_rng(0)
    ring, along, turn = (
        rng.integers(RINGS, size=TRIED),
        rng.random(TRIED),
        2.0 * np.pi * rng.random(TRIED),
    )
    fall, per_sr = (
        falls[ring] + along * np.diff(falls)[ring],
        1.0 / (2.0 * np.pi * RINGS * np.diff(falls)[ring]),
    )
    flat = np.sqrt(fall * (2.0 - fall))
    way = np.column_stack([flat * np.cos(turn), flat * np.sin(turn), 1.0 - fall]) @ lamp.frame
    first = tracer.hits(np.broadcast_to(lamp.position_m, way.shape), way)
    met = np.flatnonzero(first.face != NOTHING)
    way, face, range_m, per_sr = way[met], first.face[met], first.range_m[met], per_sr[met]
    position, (normal, leaving) = lamp.position_m + range_m[:, None] * way, tracer.facing(face, way)
    by_light = per_sr * leaving / range_m**2
    local = cosine_lobe(rng.random((len(met), 2)))
    onwards = np.einsum("ri,rij->rj", local, shading_frames(normal))
    then = tracer.hits(tracer.above(face, position, normal), onwards)
    back = np.flatnonzero(then.face != NOTHING)
    if not len(back):
        return False
    arriving = tracer.facing(then.face[back], onwards[back])[1]
    with np.errstate(divide="ignore"):
        by_ray = local[back, 2] * arriving / (np.pi * then.range_m[back] ** 2)
    light_tracing_fraction = by_light[back] / (by_light[back] + by_ray)
    bright = lamp.per_sr(way[back]) * leaving[back] / range_m[back] ** 2
    return bool(
        light_tracing_fraction.mean() >= SHARE
        or bright.sum() >= GAIN * (bright * (1.0 - light_tracing_fraction)).sum()
    )


@numba.njit(**INLINED)
def light_tracing_weight(
    beams: Any, lamps: Any, lamp: int, point: Any, normal: Any, by_ray: float
) -> float:
    """Return the balance-heuristic weight of light tracing for a lamp's light at a point.

    `by_ray` is the density with which gather rays reach the point, m-2.
    """
    chance, _, falls = beams
    if len(chance) == 0 or chance[lamp] == 0.0:
        return 0.0
    position, axes = lamps[0], lamps[4]
    square, leaving, up = 0.0, 0.0, 0.0
    for axis in range(3):
        way = point[axis] - position[lamp, axis]
        square += way * way
        leaving -= way * normal[axis]
        up += way * axes[lamp, 2, axis]
    distance = np.sqrt(square)
    if not (leaving > 0.0 and square > 0.0):
        return 0.0
    by_light = (
        chance[lamp] * _per_sr(falls[lamp], 1.0 - up / distance) * leaving / (distance * square)
    )
    weight = by_light / (by_light + by_ray)
    return weight if weight >= LEAST else 0.0


@numba.njit(**INLINED)
def _per_sr(falls: Any, fall: float) -> float:
    """Return the sampling density of the rings in a direction, sr-1."""
    ring = np.searchsorted(falls, fall, side="right") - 1
    if ring < 0 or ring >= RINGS:
        return 0.0
    return 1.0 / (2.0 * np.pi * RINGS * (falls[ring + 1] - falls[ring]))


@numba.njit(**INLINED)
def _shine(beams: Any, lamps: Any, state: Any, way: Any) -> int:
    """Draw a lamp, and set a direction by its intensity."""
    _, cumulated, falls = beams
    lamp = int(min(np.searchsorted(cumulated, uniform(state), side="right"), len(cumulated) - 1))
    at = uniform(state) * RINGS
    ring = int(at)
    fall = falls[lamp, ring] + (at - ring) * (falls[lamp, ring + 1] - falls[lamp, ring])
    flat, turn = np.sqrt(max(fall * (2.0 - fall), 0.0)), 2.0 * np.pi * uniform(state)
    u, v, up = flat * np.cos(turn), flat * np.sin(turn), 1.0 - fall
    axes = lamps[4][lamp]
    for axis in range(3):
        way[axis] = u * axes[0, axis] + v * axes[1, axis] + up * axes[2, axis]
    return lamp


@numba.njit(**COMPILED)
def add_light_traced_paths(
    scene: Any,
    bsdfs: Any,
    lamps: Any,
    beams: Any,
    packets: Any,
    lanes: Any,
    path_count: int,
    state: Any,
    irradiance: Any,
) -> None:
    """Add the light-traced part of lamp light by one reflection: the counterpart of `add_lamps`."""
    address, centre, planes, clearance = scene
    material_of, rho_by_pi, is_diffuse = bsdfs
    position, spectrum, vertices = lamps[0], lamps[2], lanes.vertex
    for k in range(path_count):
        lane = lanes.active[k]
        lanes.chosen[lane] = _shine(beams, lamps, state, vertices[lane])
        set_ray(packets, k, centre, position[lanes.chosen[lane]], vertices[lane], np.inf)
    intersect(address, packets, path_count)
    asked = 0
    for slot in range(path_count):
        face, lane = triangle_of(packets, slot, planes), lanes.active[slot]
        if face < 0 or not is_diffuse[material_of[face & ROW]]:
            continue
        # The vertex keeps its normal, from which the path continues; the array of shadow rays is
        # used for the new normal.
        up = lanes.target_direction[lane]
        origin = position[lanes.chosen[lane]]
        length, slope, normal = meet_plane(planes, face, origin, vertices[lane])
        for axis in range(3):
            vertices[lane, axis] = origin[axis] + length * vertices[lane, axis]
            up[axis] = -normal[axis] if slope > 0.0 else normal[axis]
        lanes.face[lane], lanes.factor[lane] = face, _path_irradiance(lamps, beams, lanes, lane, up)
        if lanes.factor[lane] > 0.0:
            set_ray_start(clearance, centre, face, vertices[lane], up, vertices[lane])
            for axis in range(3):
                up[axis] = vertices[lane, axis] - lanes.start[lane, axis]
            # Slots before this one have been read.
            set_ray(packets, asked, centre, lanes.start[lane], up, SHORT)
            lanes.shadow_rays[asked] = lane
            asked += 1
    trace_occlusion(address, packets, asked)
    free = 0
    for slot in range(asked):
        if not is_ray_occluded(packets, slot):
            lane = lanes.shadow_rays[slot]
            towards_lamp(
                lamps, lanes.chosen[lane], vertices[lane], state, lanes.target_direction[lane]
            )
            set_ray(packets, free, centre, vertices[lane], lanes.target_direction[lane], SHORT)
            lanes.shadow_rays[free] = lane
            free += 1
    trace_occlusion(address, packets, free)
    for slot in range(free):
        if not is_ray_occluded(packets, slot):
            lane = lanes.shadow_rays[slot]
            owner, chosen, material = (
                lanes.point[lane],
                lanes.chosen[lane],
                material_of[lanes.face[lane] & ROW],
            )
            for band in range(irradiance.shape[1]):
                light = lanes.factor[lane] * spectrum[chosen, band] * rho_by_pi[material, band]
                irradiance[owner, band] += lanes.throughput[lane, band] * light


@numba.njit(**INLINED)
def _path_irradiance(lamps: Any, beams: Any, lanes: Any, lane: int, up: Any) -> float:
    """Return the unoccluded, weighted irradiance by a light-traced point over spectrum and rho /
    pi.
    """
    vertex, start, normal, lamp = (
        lanes.vertex[lane],
        lanes.start[lane],
        lanes.normal[lane],
        lanes.chosen[lane],
    )
    square, cosine, leaving = 0.0, 0.0, 0.0
    for axis in range(3):
        off = vertex[axis] - start[axis]
        square += off * off
        cosine += off * normal[axis]
        leaving -= off * up[axis]
    if cosine <= 0.0 or leaving <= 0.0:
        return 0.0
    form = cosine * leaving / (square * square)
    by_ray = form / np.pi
    weight = light_tracing_weight(beams, lamps, lamp, vertex, up, by_ray)
    if weight == 0.0:
        return 0.0
    # The density of light tracing is by_ray * weight / (1 - weight); the estimate is weight over
    # that density.
    return lamp_factor(lamps, lamp, vertex, up) * form * (1.0 - weight) / by_ray
