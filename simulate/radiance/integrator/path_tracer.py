"""Path tracer of diffuse surfaces, in compiled loops over waves of paths.

It computes for diffuse points what batches of NumPy (`outgoing_radiance`) compute for any surface:
paths by the cosine law, next-event estimation of all light sources at each vertex, multiple
importance sampling, and light tracing. Paths that meet a surface which is not diffuse are deferred
to the batches.
"""

from typing import Any, NamedTuple

import numba
import numpy as np

from simulate.arrays import Array, Array32, Index
from simulate.radiance.brdf.protocol import Lambert
from simulate.radiance.geometry.embree import (
    COMPILED,
    ROW,
    intersect,
    is_ray_occluded,
    meet_plane,
    new_packets,
    set_ray,
    trace_occlusion,
    triangle_of,
)
from simulate.radiance.integrator.environment_map import (
    SkyImportance,
    sky_arrays,
    sky_density,
    sky_light,
)
from simulate.radiance.integrator.integrator_settings import LIMITS, IntegratorSettings
from simulate.radiance.integrator.light_sources import disc_arrays, lamp_arrays, panel_arrays
from simulate.radiance.integrator.light_tracing import add_light_traced_paths
from simulate.radiance.integrator.sampling import (
    SequenceSlice,
    draw_disc_point,
    first_disc_point,
    next_disc_point,
    set_cosine_direction,
    set_ray_start,
    uniform,
)
from simulate.radiance.integrator.source_sampling_loops import (
    add_bright_sky,
    add_control_sky,
    add_discs,
    add_hit_emission,
    add_lamps,
    add_panels,
)
from simulate.radiance.integrator.spectral_scene import ShadingPoints, SpectralScene

# Paths traced together: enough that the active ones fill Embree's packets.
WAVE = 256
# Limits of the survival probability in Russian roulette.
MIN_SURVIVAL, MAX_SURVIVAL = 0.05, 0.95


class PathStates(NamedTuple):
    """The paths of a wave, one a row."""

    active: Index  # paths still followed, in order; their number is passed separately
    shadow_rays: Index  # paths with a shadow ray, by the slot of the ray
    point: Index  # shading point at which each path starts
    face: Index  # triangle of its current vertex
    weight: (
        Array32  # contribution to the irradiance of the start per radiance from ahead, (path, band)
    )
    throughput: Array32  # and per irradiance of the current vertex
    vertex: Array  # current vertex, (path, 3)
    start: Array  # ray start above it
    normal: Array  # on the side of the path
    direction: Array  # of the ray
    target_direction: Array  # of a shadow ray
    cosine: Array  # of the direction at the last vertex
    reflectance: Array  # mean reflectance of the current vertex
    factor: Array  # irradiance over spectrum of the chosen source
    source: Index  # number of the chosen source
    path_density: Array  # density with which paths reach the vertex, m-2

    @classmethod
    def of(cls, bands: int) -> "PathStates":
        """Return empty arrays for a wave."""
        shape = {"weight": (bands,), "throughput": (bands,)}
        shape |= dict.fromkeys(("vertex", "start", "normal", "direction", "target_direction"), (3,))
        integer_fields = ("active", "shadow_rays", "point", "face", "source")
        kind = dict.fromkeys(integer_fields, np.int64) | {
            "weight": np.float32,
            "throughput": np.float32,
        }
        arrays: Any = [
            np.zeros((WAVE, *shape.get(name, ())), kind.get(name, np.float64))
            for name in cls._fields
        ]
        return cls(*arrays)


class DeferredPaths(NamedTuple):
    """Paths that met a surface which is not diffuse, shape (path, ...)."""

    owner: Index  # point at which the path started
    depth: Index  # bounces between there and the surface that the camera sees
    face: Index  # of the last hit
    position_m: Array
    direction: Array  # of the last segment
    weight: (
        Array32  # contribution to the irradiance of the start per radiance from there, (path, band)
    )


def follow_paths(
    scene: SpectralScene,
    points: ShadingPoints,
    sequence: SequenceSlice,
    effort: IntegratorSettings,
    sky_importance: SkyImportance | None,
    *,
    control: Array32,
    depth: int,
    seed: int,
) -> tuple[Array32, DeferredPaths]:
    """Return the indirect irradiance of points, shape (point, band), and the deferred paths.

    Parameters
    ----------
    scene, points, effort, sky_importance
        The scene, where, how far light is followed, and the importance sampling of the sky or None.
    sequence
        Pairs of numbers for each ray of each point: directions follow by the cosine law.
    control
        Control-variate fraction of the sky of each point, and of all that its rays meet.
    depth
        Bounces between the points and the surface that the camera sees.
    seed
        Seed of the random numbers.

    Notes
    -----
    pi/rays times the sum over rays. With the control-variate fraction c, a ray to the sky adds 1 -
    c of its radiance; one that hits a surface subtracts c of it and adds the outgoing radiance
    there. Emission is sampled by rays and by next-event estimation with multiple importance
    sampling; the latter is done elsewhere for the points themselves.
    """
    tracer, bsdfs, light, bands = scene.surfaces.tracer, scene.bsdfs, scene.lighting, scene.bands
    is_diffuse = np.array([isinstance(brdf, Lambert) for brdf in bsdfs.brdfs])
    is_active_lamp = np.array([lamp.name not in effort.neglected for lamp in light.lamps], np.bool_)
    irradiance = np.zeros((len(points), bands), np.float32)
    capacity = 0 if is_diffuse.all() else len(points) * sequence.rays
    owner, path_depth, face = (np.empty(capacity, np.int64) for _ in range(3))
    position, direction = np.empty((2, capacity, 3))
    deferred = DeferredPaths(
        owner, path_depth, face, position, direction, np.empty((capacity, bands), np.float32)
    )
    assert tracer.scene is not None
    start = tracer.ray_starts(points.face, points.position_m, points.normal)
    roulette = np.iinfo(np.int64).max if effort.roulette_depth is None else effort.roulette_depth
    count = _follow(
        (tracer.scene.address, tracer.centre_m, tracer.planes, tracer.clearance_m),
        (scene.surfaces.material_of, bsdfs.rho_by_pi, is_diffuse),
        (
            sky_arrays(light.environment_map, sky_importance),
            disc_arrays(effort.active_lights(light.discs), bands),
            lamp_arrays(effort.active_lights(light.lamps), bands),
            panel_arrays(light.panels, bands),
            scene.beams.arrays(light.lamps, is_active_lamp),
        ),
        (start, np.asarray(points.normal, np.float64), control),
        (sequence.start, sequence.rays),
        (depth, effort.max_bounces, roulette, effort.sky_shadowing, LIMITS.max_sampled_lamps),
        np.array([seed], np.uint64),
        (PathStates.of(bands), new_packets(WAVE)),
        irradiance,
        tuple(deferred),
    )
    deferred_arrays: Any = [values[:count] for values in deferred]
    return irradiance, DeferredPaths(*deferred_arrays)


@numba.njit(**COMPILED)
def _follow(
    scene: Any,
    bsdfs: Any,
    lights: Any,
    points: Any,
    sequence: Any,
    limits: Any,
    state: Any,
    buffers: Any,
    irradiance: Any,
    deferred: Any,
) -> int:
    """Follow all paths of points, a wave at a time, and return the number of deferred ones."""
    sequence_starts, rays_per_point = sequence
    sky, discs, lamps, panels, beams = lights
    first_depth, max_bounces, _, sky_shadowing, max_lamps = limits
    lanes, packets = buffers
    samples_sky, has_panels = sky_shadowing and sky[2], len(panels[0]) > 0
    n_deferred, disc_point = 0, (0.0, 1.0, 0.0)
    for first_path in range(0, len(sequence_starts) * rays_per_point, WAVE):
        path_count, disc_point = _start_paths(
            lanes, points, sequence_starts, rays_per_point, disc_point, first_path
        )
        depth, gather_rays = first_depth, rays_per_point
        while True:
            continues = depth < max_bounces
            finds_hits = continues or has_panels
            if continues and len(beams[0]):
                add_light_traced_paths(
                    scene, bsdfs, lamps, beams, packets, lanes, path_count, state, irradiance
                )
            path_count = _trace_paths(scene, packets, lanes, path_count, finds_hits)
            path_count = _add_escaped_sky(
                scene,
                sky,
                packets,
                lanes,
                path_count,
                points[2],
                gather_rays,
                finds_hits,
                samples_sky,
                irradiance,
            )
            if finds_hits:
                _move_to_hits(scene, lanes, path_count)
            if has_panels:
                add_hit_emission(panels, scene[2], lanes, path_count, gather_rays, irradiance)
            if not continues:
                break
            path_count, n_deferred = _reflect(
                scene, bsdfs, lanes, path_count, depth, limits, state, n_deferred, deferred
            )
            if path_count == 0:
                break
            if sky[2]:
                add_control_sky(sky[1], lanes, path_count, points[2], sky_shadowing, irradiance)
            add_discs(scene, discs, packets, lanes, path_count, state, irradiance)
            add_lamps(scene, lamps, beams, max_lamps, packets, lanes, path_count, state, irradiance)
            if has_panels:
                add_panels(scene, panels, packets, lanes, path_count, state, irradiance)
            if samples_sky and len(sky[4]):
                add_bright_sky(scene, sky, packets, lanes, path_count, points[2], state, irradiance)
            depth, gather_rays = depth + 1, 1
            if not (depth < max_bounces or has_panels or samples_sky):
                break
            _draw_directions(lanes, path_count, state)
    return n_deferred


@numba.njit(**COMPILED)
def _start_paths(
    lanes: Any,
    points: Any,
    sequence_starts: Any,
    rays_per_point: int,
    disc_point: Any,
    first_path: int,
) -> Any:
    """Start paths at points, and return their number and the state of the last quasi-random
    slice.
    """
    starts, normals, _ = points
    path_count = min(WAVE, len(sequence_starts) * rays_per_point - first_path)
    i, ray = first_path // rays_per_point, first_path % rays_per_point
    for lane in range(path_count):
        disc_point = next_disc_point(disc_point) if ray else first_disc_point(sequence_starts[i])
        lanes.active[lane], lanes.point[lane], lanes.reflectance[lane] = lane, i, 1.0
        lanes.cosine[lane] = set_cosine_direction(normals[i], disc_point, lanes.direction[lane])
        for axis in range(3):
            lanes.start[lane, axis], lanes.normal[lane, axis] = starts[i, axis], normals[i, axis]
        for band in range(lanes.weight.shape[1]):
            lanes.weight[lane, band], lanes.throughput[lane, band] = (
                np.pi / rays_per_point,
                1.0 / rays_per_point,
            )
        i, ray = (i, ray + 1) if ray + 1 < rays_per_point else (i + 1, 0)
    return path_count, disc_point


@numba.njit(**COMPILED)
def _trace_paths(scene: Any, packets: Any, lanes: Any, path_count: int, finds_hits: bool) -> int:
    """Trace rays, or of last segments only their occlusion; return the number of rays traced."""
    address, centre = scene[0], scene[1]
    n_rays = 0
    for k in range(path_count):
        lane = lanes.active[k]
        # A last ray below the horizon cannot meet the sky.
        if finds_hits or lanes.direction[lane, 2] >= 0.0:
            set_ray(packets, n_rays, centre, lanes.start[lane], lanes.direction[lane], np.inf)
            lanes.active[n_rays] = lane
            n_rays += 1
    if finds_hits:
        intersect(address, packets, n_rays)
    else:
        trace_occlusion(address, packets, n_rays)
    return n_rays


@numba.njit(**COMPILED)
def _add_escaped_sky(
    scene: Any,
    sky: Any,
    packets: Any,
    lanes: Any,
    path_count: int,
    control: Any,
    gather_rays: int,
    finds_hits: bool,
    samples_sky: bool,
    irradiance: Any,
) -> int:
    """Add the sky for rays that escape, subtract the control variate for others; return the number
    that continue.
    """
    n_active = 0
    for slot in range(path_count):
        lane = lanes.active[slot]
        i = lanes.point[lane]
        if finds_hits:
            lanes.face[lane] = triangle_of(packets, slot, scene[2])
            hit = lanes.face[lane] >= 0
        else:
            hit = is_ray_occluded(packets, slot)
        sky_fraction = -float(control[i]) if hit else 1.0 - float(control[i])
        if hit and finds_hits:
            lanes.active[n_active] = lane
            n_active += 1
        x, y, z = lanes.direction[lane, 0], lanes.direction[lane, 1], lanes.direction[lane, 2]
        if samples_sky and z >= 0.0 and sky_fraction != 0.0:
            gather_density = gather_rays * lanes.cosine[lane] / np.pi
            sky_fraction *= gather_density / (gather_density + sky_density(sky[4], x, y, z))
            sky_light(sky[0], x, y, z, sky_fraction, lanes.weight[lane], irradiance[i])
    return n_active


@numba.njit(**COMPILED)
def _move_to_hits(scene: Any, lanes: Any, path_count: int) -> None:
    """Move paths to the surfaces that they met."""
    for k in range(path_count):
        lane = lanes.active[k]
        length, slope, normal = meet_plane(
            scene[2], lanes.face[lane], lanes.start[lane], lanes.direction[lane]
        )
        side = 1.0 if slope < 0.0 else -1.0
        lanes.path_density[lane] = lanes.cosine[lane] * abs(slope) / (np.pi * length * length)
        for axis in range(3):
            lanes.vertex[lane, axis] = (
                lanes.start[lane, axis] + length * lanes.direction[lane, axis]
            )
            lanes.normal[lane, axis] = side * normal[axis]


@numba.njit(**COMPILED)
def _reflect(
    scene: Any,
    bsdfs: Any,
    lanes: Any,
    path_count: int,
    depth: int,
    limits: Any,
    state: Any,
    n_deferred: int,
    deferred: Any,
) -> tuple[int, int]:
    """Reflect paths, with Russian roulette; defer those on surfaces that are not diffuse."""
    _, centre, _, clearance = scene
    material_of, rho_by_pi, is_diffuse = bsdfs
    n_active = 0
    for k in range(path_count):
        lane = lanes.active[k]
        weight, throughput = lanes.weight[lane], lanes.throughput[lane]
        if depth >= limits[2]:
            survival = min(max(lanes.reflectance[lane], MIN_SURVIVAL), MAX_SURVIVAL)
            if uniform(state) >= survival:
                continue
            for band in range(len(weight)):
                weight[band] /= np.float32(survival)
        face = lanes.face[lane]
        material = material_of[face & ROW]
        if not is_diffuse[material]:
            owners, depths, faces, positions, directions, weights = deferred
            owners[n_deferred], depths[n_deferred], faces[n_deferred] = (
                lanes.point[lane],
                depth + 1,
                face,
            )
            positions[n_deferred], directions[n_deferred], weights[n_deferred] = (
                lanes.vertex[lane],
                lanes.direction[lane],
                weight,
            )
            n_deferred += 1
            continue
        reflectance_sum = 0.0
        for band in range(len(weight)):
            throughput[band] = weight[band] * rho_by_pi[material, band]
            weight[band] = throughput[band] * np.pi
            reflectance_sum += rho_by_pi[material, band]
        lanes.reflectance[lane] = reflectance_sum * np.pi / len(weight)
        set_ray_start(
            clearance, centre, face, lanes.vertex[lane], lanes.normal[lane], lanes.start[lane]
        )
        lanes.active[n_active] = lane
        n_active += 1
    return n_active, n_deferred


@numba.njit(**COMPILED)
def _draw_directions(lanes: Any, path_count: int, state: Any) -> None:
    """Draw new directions by the cosine law."""
    for k in range(path_count):
        lane = lanes.active[k]
        lanes.cosine[lane] = set_cosine_direction(
            lanes.normal[lane], draw_disc_point(state), lanes.direction[lane]
        )
