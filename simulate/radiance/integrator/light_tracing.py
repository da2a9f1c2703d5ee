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

from simulate.arrays import Array, Mask
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

# Rings of equal light about a lamp's axis, from which directions are drawn; samples in both angles
# that define them.
RINGS, N_POLARS, N_AZIMUTHS = 64, 2000, 24
# Test rays that decide whether a lamp is light-traced: if light tracing would sample this fraction
# of its light, or if the mean square of the gather estimate is this many times larger.
N_TEST_RAYS, MIN_FRACTION, MIN_GAIN = 512, 0.7, 20.0
# Below this weight only gather rays sample the light, which saves a shadow ray.
MIN_WEIGHT = 0.01


@dataclass(frozen=True, kw_only=True)
class LightTracingSettings:
    """Sampling of lamp directions by intensity."""

    is_efficient: Mask  # whether each lamp is light-traced
    versines: (
        Array  # 1 less the cosines between rings about the lamps' axes, shape (lamp, ring + 1)
    )

    @classmethod
    def of(cls, lamps: tuple[LampLight, ...], tracer: RayTracer) -> "LightTracingSettings":
        """Return the settings of lamps among surfaces."""
        versines = np.array([_rings(lamp) for lamp in lamps]).reshape(-1, RINGS + 1)
        is_efficient = [
            _is_efficient(lamp, rings, tracer) for lamp, rings in zip(lamps, versines, strict=True)
        ]
        return cls(is_efficient=np.array(is_efficient, np.bool_), versines=versines)

    def arrays(self, lamps: tuple[LampLight, ...], mask: Mask) -> tuple[NDArray, NDArray, NDArray]:
        """Return the probabilities of some of the lamps, their cumulative sums, and the ring
        limits.
        """
        power = np.array([float(lamp.spectrum.sum()) for lamp in lamps])[mask]
        power[~self.is_efficient[mask]] = 0.0
        probability = power / power.sum() if power.sum() > 0.0 else np.zeros(0)
        return probability, np.cumsum(probability), self.versines[mask]


def _rings(lamp: LampLight) -> Array:
    """Return 1 minus the cosines of the limits of rings of equal light about a lamp's axis, shape
    (ring + 1,).
    """
    polar = np.pi * np.linspace(0.0, 1.0, N_POLARS) ** 2
    azimuth = 2.0 * np.pi * (np.arange(N_AZIMUTHS) + 0.5) / N_AZIMUTHS
    sine = np.sin(polar)[:, None]
    direction = np.stack(
        np.broadcast_arrays(sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(polar)[:, None]),
        axis=-1,
    )
    density = (
        lamp.distribution.per_sr(direction.reshape(-1, 3))
        .reshape(N_POLARS, N_AZIMUTHS)
        .mean(axis=1)
        * sine[:, 0]
    )
    cumulative = np.concatenate(
        [[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(polar))]
    )
    # A uniform part of 1e-6 keeps rings distinct where a table is dark.
    cumulative += 1e-6 * cumulative[-1] * polar / np.pi
    ring_polar = np.interp(np.linspace(0.0, cumulative[-1], RINGS + 1), cumulative, polar)
    return 2.0 * np.sin(0.5 * ring_polar) ** 2


def _is_efficient(lamp: LampLight, versines: Array, tracer: RayTracer) -> bool:
    """Return whether light tracing samples a lamp's light by one reflection much better than gather
    rays.

    Notes
    -----
    Rays from the lamp give pairs of points. With the densities l and g of the first point by light
    tracing and by gather rays, and its radiance L, the weight of light tracing is l/(l + g); gather
    rays alone have the mean square of L, combined ones that of L g/(l + g).
    """
    rng = np.random.default_rng(0)
    ring, ring_fraction, azimuth = (
        rng.integers(RINGS, size=N_TEST_RAYS),
        rng.random(N_TEST_RAYS),
        2.0 * np.pi * rng.random(N_TEST_RAYS),
    )
    versine, per_sr = (
        versines[ring] + ring_fraction * np.diff(versines)[ring],
        1.0 / (2.0 * np.pi * RINGS * np.diff(versines)[ring]),
    )
    sine = np.sqrt(versine * (2.0 - versine))
    direction = (
        np.column_stack([sine * np.cos(azimuth), sine * np.sin(azimuth), 1.0 - versine])
        @ lamp.frame
    )
    first_hits = tracer.hits(np.broadcast_to(lamp.position_m, direction.shape), direction)
    hit_rays = np.flatnonzero(first_hits.face != NOTHING)
    direction, face, range_m, per_sr = (
        direction[hit_rays],
        first_hits.face[hit_rays],
        first_hits.range_m[hit_rays],
        per_sr[hit_rays],
    )
    position, (normal, hit_cosine) = (
        lamp.position_m + range_m[:, None] * direction,
        tracer.sided_normals(face, direction),
    )
    light_density = per_sr * hit_cosine / range_m**2
    local = cosine_lobe(rng.random((len(hit_rays), 2)))
    reflected_direction = np.einsum("ri,rij->rj", local, shading_frames(normal))
    second_hits = tracer.hits(tracer.ray_starts(face, position, normal), reflected_direction)
    reflected_rays = np.flatnonzero(second_hits.face != NOTHING)
    if not len(reflected_rays):
        return False
    second_cosine = tracer.sided_normals(
        second_hits.face[reflected_rays], reflected_direction[reflected_rays]
    )[1]
    with np.errstate(divide="ignore"):
        path_density = (
            local[reflected_rays, 2]
            * second_cosine
            / (np.pi * second_hits.range_m[reflected_rays] ** 2)
        )
    light_tracing_fraction = light_density[reflected_rays] / (
        light_density[reflected_rays] + path_density
    )
    irradiance_by_ray = (
        lamp.per_sr(direction[reflected_rays])
        * hit_cosine[reflected_rays]
        / range_m[reflected_rays] ** 2
    )
    return bool(
        light_tracing_fraction.mean() >= MIN_FRACTION
        or irradiance_by_ray.sum()
        >= MIN_GAIN * (irradiance_by_ray * (1.0 - light_tracing_fraction)).sum()
    )


@numba.njit(**INLINED)
def light_tracing_weight(
    beams: Any, lamps: Any, lamp: int, point: Any, normal: Any, path_density: float
) -> float:
    """Return the balance-heuristic weight of light tracing for a lamp's light at a point.

    `path_density` is the density with which gather rays reach the point, m-2.
    """
    probability, _, versines = beams
    if len(probability) == 0 or probability[lamp] == 0.0:
        return 0.0
    position, axes = lamps[0], lamps[4]
    square, hit_cosine, axial = 0.0, 0.0, 0.0
    for axis in range(3):
        offset = point[axis] - position[lamp, axis]
        square += offset * offset
        hit_cosine -= offset * normal[axis]
        axial += offset * axes[lamp, 2, axis]
    distance = np.sqrt(square)
    if not (hit_cosine > 0.0 and square > 0.0):
        return 0.0
    light_density = (
        probability[lamp]
        * _per_sr(versines[lamp], 1.0 - axial / distance)
        * hit_cosine
        / (distance * square)
    )
    weight = light_density / (light_density + path_density)
    return weight if weight >= MIN_WEIGHT else 0.0


@numba.njit(**INLINED)
def _per_sr(versines: Any, versine: float) -> float:
    """Return the sampling density of the rings in a direction, sr-1."""
    ring = np.searchsorted(versines, versine, side="right") - 1
    if ring < 0 or ring >= RINGS:
        return 0.0
    return 1.0 / (2.0 * np.pi * RINGS * (versines[ring + 1] - versines[ring]))


@numba.njit(**INLINED)
def _draw_lamp_direction(beams: Any, lamps: Any, state: Any, direction: Any) -> int:
    """Draw a lamp, and set a direction by its intensity."""
    _, cumulative, versines = beams
    lamp = int(min(np.searchsorted(cumulative, uniform(state), side="right"), len(cumulative) - 1))
    ring_position = uniform(state) * RINGS
    ring = int(ring_position)
    versine = versines[lamp, ring] + (ring_position - ring) * (
        versines[lamp, ring + 1] - versines[lamp, ring]
    )
    sine, azimuth = np.sqrt(max(versine * (2.0 - versine), 0.0)), 2.0 * np.pi * uniform(state)
    u, v, w = sine * np.cos(azimuth), sine * np.sin(azimuth), 1.0 - versine
    axes = lamps[4][lamp]
    for axis in range(3):
        direction[axis] = u * axes[0, axis] + v * axes[1, axis] + w * axes[2, axis]
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
        lanes.source[lane] = _draw_lamp_direction(beams, lamps, state, vertices[lane])
        set_ray(packets, k, centre, position[lanes.source[lane]], vertices[lane], np.inf)
    intersect(address, packets, path_count)
    n_gather_rays = 0
    for slot in range(path_count):
        face, lane = triangle_of(packets, slot, planes), lanes.active[slot]
        if face < 0 or not is_diffuse[material_of[face & ROW]]:
            continue
        # The vertex keeps its normal, from which the path continues; the array of shadow rays is
        # used for the new normal.
        hit_normal = lanes.target_direction[lane]
        origin = position[lanes.source[lane]]
        length, slope, normal = meet_plane(planes, face, origin, vertices[lane])
        for axis in range(3):
            vertices[lane, axis] = origin[axis] + length * vertices[lane, axis]
            hit_normal[axis] = -normal[axis] if slope > 0.0 else normal[axis]
        lanes.face[lane], lanes.factor[lane] = (
            face,
            _path_irradiance(lamps, beams, lanes, lane, hit_normal),
        )
        if lanes.factor[lane] > 0.0:
            set_ray_start(clearance, centre, face, vertices[lane], hit_normal, vertices[lane])
            for axis in range(3):
                hit_normal[axis] = vertices[lane, axis] - lanes.start[lane, axis]
            # Slots before this one have been read.
            set_ray(packets, n_gather_rays, centre, lanes.start[lane], hit_normal, SHORT)
            lanes.shadow_rays[n_gather_rays] = lane
            n_gather_rays += 1
    trace_occlusion(address, packets, n_gather_rays)
    n_lamp_rays = 0
    for slot in range(n_gather_rays):
        if not is_ray_occluded(packets, slot):
            lane = lanes.shadow_rays[slot]
            towards_lamp(
                lamps, lanes.source[lane], vertices[lane], state, lanes.target_direction[lane]
            )
            set_ray(
                packets, n_lamp_rays, centre, vertices[lane], lanes.target_direction[lane], SHORT
            )
            lanes.shadow_rays[n_lamp_rays] = lane
            n_lamp_rays += 1
    trace_occlusion(address, packets, n_lamp_rays)
    for slot in range(n_lamp_rays):
        if not is_ray_occluded(packets, slot):
            lane = lanes.shadow_rays[slot]
            point, source, material = (
                lanes.point[lane],
                lanes.source[lane],
                material_of[lanes.face[lane] & ROW],
            )
            for band in range(irradiance.shape[1]):
                light = lanes.factor[lane] * spectrum[source, band] * rho_by_pi[material, band]
                irradiance[point, band] += lanes.throughput[lane, band] * light


@numba.njit(**INLINED)
def _path_irradiance(lamps: Any, beams: Any, lanes: Any, lane: int, hit_normal: Any) -> float:
    """Return the unoccluded, weighted irradiance by a light-traced point over spectrum and rho /
    pi.
    """
    vertex, start, normal, lamp = (
        lanes.vertex[lane],
        lanes.start[lane],
        lanes.normal[lane],
        lanes.source[lane],
    )
    square, cosine, hit_cosine = 0.0, 0.0, 0.0
    for axis in range(3):
        offset = vertex[axis] - start[axis]
        square += offset * offset
        cosine += offset * normal[axis]
        hit_cosine -= offset * hit_normal[axis]
    if cosine <= 0.0 or hit_cosine <= 0.0:
        return 0.0
    geometry_term = cosine * hit_cosine / (square * square)
    path_density = geometry_term / np.pi
    weight = light_tracing_weight(beams, lamps, lamp, vertex, hit_normal, path_density)
    if weight == 0.0:
        return 0.0
    # The density of light tracing is by_ray * weight / (1 - weight); the estimate is weight over
    # that density.
    return (
        lamp_factor(lamps, lamp, vertex, hit_normal) * geometry_term * (1.0 - weight) / path_density
    )
