"""Path tracer of diffuse surfaces, in compiled loops over waves of paths.

It computes for diffuse points what `final_gather` computes in batches for any surface. Paths that meet a surface which
is not diffuse are deferred to that code.
"""

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from simulate.radiance.geometry.embree import (
    COMPILED,
    ROW,
    intersect,
    is_ray_occluded,
    new_packets,
    plane_of,
    set_ray,
    trace_occlusion,
    triangle_of,
    without_reference_count,
)
from simulate.radiance.geometry.ray_tracer import RayTracer
from simulate.radiance.integrator.compiled_light_sources import bright_density, sky_light
from simulate.radiance.integrator.light_tracing import add_light_traced_paths
from simulate.radiance.integrator.low_discrepancy import SequenceSlice
from simulate.radiance.integrator.path_states import (
    WAVE,
    PathStates,
    by_cosine,
    first_even,
    in_disc,
    next_even,
    set_ray_start,
    uniform,
)
from simulate.radiance.integrator.shading_points import ShadingPoints
from simulate.radiance.integrator.source_sampling_loops import (
    add_bright,
    add_discs,
    add_glow,
    add_known_sky,
    add_lamps,
    add_panels,
)  # fmt: skip

# Limits of the survival probability in Russian roulette.
LEAST_CHANCE, MOST_CHANCE = 0.05, 0.95
NEVER = 1 << 30


@dataclass(frozen=True, kw_only=True)
class DeferredPaths:
    """Paths that met a surface which is not diffuse.

    Parameters
    ----------
    owner
        Point at which each path started, shape (ray,).
    depth
        Bounces between there and the surface that the camera sees, shape (ray,).
    face, place_m, direction
        Triangle and position of the last hit, and direction of the last segment, shapes (ray,), (ray, 3) and (ray, 3).
    weight
        Contribution to the irradiance of the start per radiance from there, shape (ray, band).
    """

    owner: NDArray[np.int64]
    depth: NDArray[np.int64]
    face: NDArray[np.int64]
    place_m: NDArray[np.float64]
    direction: NDArray[np.float64]
    weight: NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class CompiledScene:
    """A scene in the form of the compiled loops.

    Parameters
    ----------
    tracer
        Ray tracer of its surfaces, at least one.
    material_of
        Material of each triangle, shape (face,).
    rho_by_pi, is_diffuse
        Of each material, shape (material, band), sr-1, and (material,).
    sky, discs, lamps, panels
        Sources, see `compiled_lights`.
    beams
        How rays are drawn as lamps shine, see `lit_places.Beams`.
    """

    tracer: RayTracer
    material_of: NDArray[np.int64]
    rho_by_pi: NDArray[np.float32]
    is_diffuse: NDArray[np.bool_]
    sky: tuple
    discs: tuple
    lamps: tuple
    panels: tuple
    beams: tuple

    def irradiance(
        self,
        points: ShadingPoints,
        even: SequenceSlice,
        *,
        sky_control_fraction: NDArray[np.float32],
        sky_shadowing: bool,
        depth: int,
        max_bounces: int,
        roulette_depth: int | None,
        asked_lamps: int,
        seed: int,
    ) -> tuple[NDArray[np.float32], DeferredPaths]:
        """Return the indirect irradiance of points, shape (point, band), and the deferred paths.

        Parameters
        ----------
        points
            Places.
        even
            Two quasi-random numbers for each ray of each point: directions follow by the cosine law.
        sky_control_fraction
            Control-variate fraction of the sky of each point, and of all that its rays meet.
        sky_shadowing
            Whether objects occlude the sky.
        depth, max_bounces
            Bounces between the points and the surface that the camera sees, and most bounces.
        roulette_depth
            As of `Effort`.
        asked_lamps
            Most lamps that are all sampled at a vertex; with more, one is drawn.
        seed
            Seed of the random numbers.

        Notes
        -----
        pi/rays times the sum over rays. With the control-variate fraction c, a ray to the sky adds 1 - c of its
        radiance; one that hits a surface subtracts c of it and adds the outgoing radiance there. Emission is sampled by
        rays and by next-event estimation with multiple importance sampling; the latter is done elsewhere for the points
        themselves.
        """
        found = np.zeros((len(points), self.rho_by_pi.shape[1]), np.float32)
        tracer, room = self.tracer, 0 if self.is_diffuse.all() else len(points) * even.rays
        back = DeferredPaths(
            owner=np.empty(room, np.int64),
            depth=np.empty(room, np.int64),
            face=np.empty(room, np.int64),
            place_m=np.empty((room, 3)),
            direction=np.empty((room, 3)),
            weight=np.empty((room, found.shape[1]), np.float32),
        )
        assert tracer.scene is not None
        start = tracer.above(points.face, points.place_m, points.normal)
        roulette = NEVER if roulette_depth is None else roulette_depth
        count = _follow(
            (tracer.scene.address, tracer.centre_m, tracer.planes, tracer.clearance_m),
            (self.material_of, self.rho_by_pi, self.is_diffuse),
            (self.sky, self.discs, self.lamps, self.panels, self.beams),
            (start, np.asarray(points.normal, np.float64), sky_control_fraction),
            (even.start, even.rays),
            (depth, max_bounces, roulette, sky_shadowing, asked_lamps),
            np.array([seed], np.uint64),
            (PathStates.of(found.shape[1]), new_packets(WAVE)),
            found,
            (back.owner, back.depth, back.face, back.place_m, back.direction, back.weight),
        )
        return found, DeferredPaths(**{name: values[:count] for name, values in vars(back).items()})


@numba.njit(**COMPILED)
def _follow(
    scene: Any,
    bsdfs: Any,
    lights: Any,
    points: Any,
    even: Any,
    limits: Any,
    state: Any,
    room: Any,
    found: Any,
    back: Any,
) -> int:
    """Follow all paths of points, a wave at a time, and return the number of deferred ones."""
    scene, bsdfs, lights, points = (
        without_reference_count(scene),
        without_reference_count(bsdfs),
        without_reference_count(lights),
        without_reference_count(points),
    )
    state, room, found, back = (
        without_reference_count(state),
        without_reference_count(room),
        without_reference_count(found),
        without_reference_count(back),
    )
    begin, each = without_reference_count(even)
    sky, discs, lamps, panels, beams = lights
    depth_first, max_bounces, _, sky_shadowing, asked_lamps = limits
    lanes, packets = room
    sky_counts, glows = sky_shadowing and sky[2], len(panels[0]) > 0
    n_deferred, now = 0, (0.0, 1.0, 0.0)
    for first in range(0, len(begin) * each, WAVE):
        many, now = _send(lanes, points, begin, each, now, first)
        depth, sent = depth_first, each
        while True:
            goes_on = depth < max_bounces
            meets = goes_on or glows
            if goes_on and len(beams[0]):
                add_light_traced_paths(scene, bsdfs, lamps, beams, packets, lanes, many, state, found)
            many = _ask(scene, packets, lanes, many, meets)
            many = _meet_sky(scene, sky, packets, lanes, many, points[2], sent, meets, sky_counts, found)
            if meets:
                _arrive(scene, lanes, many)
            if glows:
                add_glow(panels, scene[2], lanes, many, sent, found)
            if not goes_on:
                break
            many, n_deferred = _reflect(scene, bsdfs, lanes, many, depth, limits, state, n_deferred, back)
            if many == 0:
                break
            if sky[2]:
                add_known_sky(sky[1], lanes, many, points[2], sky_shadowing, found)
            add_discs(scene, discs, packets, lanes, many, state, found)
            add_lamps(scene, lamps, beams, asked_lamps, packets, lanes, many, state, found)
            if glows:
                add_panels(scene, panels, packets, lanes, many, state, found)
            if sky_counts and len(sky[4]):
                add_bright(scene, sky, packets, lanes, many, points[2], state, found)
            depth, sent = depth + 1, 1
            if not (depth < max_bounces or glows or sky_counts):
                break
            _turn(lanes, many, state)
    return n_deferred


@numba.njit(**COMPILED)
def _send(lanes: Any, points: Any, begin: Any, each: int, now: Any, first: int) -> Any:
    """Start paths at points, and return their number and the state of the last quasi-random slice."""
    starts, normals, _ = points
    many = min(WAVE, len(begin) * each - first)
    i, ray = first // each, first % each
    for lane in range(many):
        now = next_even(now) if ray else first_even(begin[i])
        lanes.active[lane], lanes.point[lane], lanes.reflectance[lane] = lane, i, 1.0
        lanes.cosine[lane] = by_cosine(normals[i], now, lanes.direction[lane])
        for axis in range(3):
            lanes.start[lane, axis], lanes.normal[lane, axis] = starts[i, axis], normals[i, axis]
        for band in range(lanes.weight.shape[1]):
            lanes.weight[lane, band], lanes.throughput[lane, band] = np.pi / each, 1.0 / each
        i, ray = (i, ray + 1) if ray + 1 < each else (i + 1, 0)
    return many, now


@numba.njit(**COMPILED)
def _ask(scene: Any, packets: Any, lanes: Any, many: int, meets: bool) -> int:
    """Trace rays, or of last segments only their occlusion; return the number of rays traced."""
    address, centre = scene[0], scene[1]
    asked = 0
    for k in range(many):
        lane = lanes.active[k]
        # A last ray below the horizon cannot meet the sky.
        if meets or lanes.direction[lane, 2] >= 0.0:
            set_ray(packets, asked, centre, lanes.start[lane], lanes.direction[lane], np.inf)
            lanes.active[asked] = lane
            asked += 1
    if meets:
        intersect(address, packets, asked)
    else:
        trace_occlusion(address, packets, asked)
    return asked


@numba.njit(**COMPILED)
def _meet_sky(
    scene: Any,
    sky: Any,
    packets: Any,
    lanes: Any,
    many: int,
    sky_control_fraction: Any,
    sent: int,
    meets: bool,
    sky_counts: bool,
    found: Any,
) -> int:
    """Add the sky for rays that escape, subtract the control variate for others; return the number that continue."""
    kept = 0
    for slot in range(many):
        lane = lanes.active[slot]
        i = lanes.point[lane]
        if meets:
            lanes.face[lane] = triangle_of(packets, slot, scene[2])
            hit = lanes.face[lane] >= 0
        else:
            hit = is_ray_occluded(packets, slot)
        share = -float(sky_control_fraction[i]) if hit else 1.0 - float(sky_control_fraction[i])
        if hit and meets:
            lanes.active[kept] = lane
            kept += 1
        x, y, z = lanes.direction[lane, 0], lanes.direction[lane, 1], lanes.direction[lane, 2]
        if sky_counts and z >= 0.0 and share != 0.0:
            own = sent * lanes.cosine[lane] / np.pi
            share *= own / (own + bright_density(sky[4], x, y, z))
            sky_light(sky[0], x, y, z, share, lanes.weight[lane], found[i])
    return kept


@numba.njit(**COMPILED)
def _arrive(scene: Any, lanes: Any, many: int) -> None:
    """Move paths to the surfaces that they met."""
    for k in range(many):
        lane = lanes.active[k]
        height, slope = 0.0, 0.0
        corner, normal = plane_of(scene[2], lanes.face[lane])
        for axis in range(3):
            height += (corner[axis] - lanes.start[lane, axis]) * normal[axis]
            slope += lanes.direction[lane, axis] * normal[axis]
        length = height / slope
        length = max(length, 0.0) if np.isfinite(length) else 0.0
        side = 1.0 if slope < 0.0 else -1.0
        lanes.by_ray[lane] = lanes.cosine[lane] * abs(slope) / (np.pi * length * length)
        for axis in range(3):
            lanes.place[lane, axis] = lanes.start[lane, axis] + length * lanes.direction[lane, axis]
            lanes.normal[lane, axis] = side * normal[axis]


@numba.njit(**COMPILED)
def _reflect(
    scene: Any, bsdfs: Any, lanes: Any, many: int, depth: int, limits: Any, state: Any, n_deferred: int, back: Any
) -> tuple[int, int]:
    """Reflect paths, with Russian roulette; defer those on surfaces that are not diffuse."""
    _, centre, _, clearance = scene
    material_of, rho_by_pi, is_diffuse = bsdfs
    kept = 0
    for k in range(many):
        lane = lanes.active[k]
        weight, leaves = lanes.weight[lane], lanes.throughput[lane]
        if depth >= limits[2]:
            chance = min(max(lanes.reflectance[lane], LEAST_CHANCE), MOST_CHANCE)
            if uniform(state) >= chance:
                continue
            for band in range(len(weight)):
                weight[band] /= np.float32(chance)
        face = lanes.face[lane]
        material = material_of[face & ROW]
        if not is_diffuse[material]:
            owners, depths, faces, places, ways, weights = back
            owners[n_deferred], depths[n_deferred], faces[n_deferred] = lanes.point[lane], depth + 1, face
            places[n_deferred], ways[n_deferred], weights[n_deferred] = lanes.place[lane], lanes.direction[lane], weight
            n_deferred += 1
            continue
        reflected = 0.0
        for band in range(len(weight)):
            leaves[band] = weight[band] * rho_by_pi[material, band]
            weight[band] = leaves[band] * np.pi
            reflected += rho_by_pi[material, band]
        lanes.reflectance[lane] = reflected * np.pi / len(weight)
        set_ray_start(clearance, centre, face, lanes.place[lane], lanes.normal[lane], lanes.start[lane])
        lanes.active[kept] = lane
        kept += 1
    return kept, n_deferred


@numba.njit(**COMPILED)
def _turn(lanes: Any, many: int, state: Any) -> None:
    """Draw new directions by the cosine law."""
    for k in range(many):
        lane = lanes.active[k]
        lanes.cosine[lane] = by_cosine(lanes.normal[lane], in_disc(state), lanes.direction[lane])
