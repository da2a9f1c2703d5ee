"""Light by way of matt surfaces, followed by compiled loops: rays from place to place until nothing counts any more.

What `gather.any_surface` does in batches is done here, a wave of rays at a time, where places are matt.
Rays that meet a surface which is not matt are handed back from where they met it.
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

# Chances with which paths go on, at least and at most.
LEAST_CHANCE, MOST_CHANCE = 0.05, 0.95
NEVER = 1 << 30


@dataclass(frozen=True, kw_only=True)
class DeferredPaths:
    """Rays that met what is not matt.

    Parameters
    ----------
    owner
        Point that sent each path, shape (ray,).
    depth
        Bounces between there and the surface that the eye sees, shape (ray,).
    face, place_m, direction
        What the last leg met, where, and its direction, shapes (ray,), (ray, 3) and (ray, 3).
    weight
        Irradiance of the owner for radiance from there, shape (ray, band).
    """

    owner: NDArray[np.int64]
    depth: NDArray[np.int64]
    face: NDArray[np.int64]
    place_m: NDArray[np.float64]
    direction: NDArray[np.float64]
    weight: NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class CompiledScene:
    """A scene as compiled loops need it.

    Parameters
    ----------
    tracer
        Its surfaces; there are some.
    material_of
        Material of each triangle, shape (face,).
    rho_by_pi, matt
        Of each material, shape (material, band), sr-1, and (material,).
    sky, discs, lamps, panels
        Sources, see `compiled_lights`.
    beams
        How rays are drawn as lamps shine, see `lit_places.Beams`.
    """

    tracer: RayTracer
    material_of: NDArray[np.int64]
    rho_by_pi: NDArray[np.float32]
    matt: NDArray[np.bool_]
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
        known: NDArray[np.float32],
        hidden_sky: bool,
        depth: int,
        bounces: int,
        roulette_from: int | None,
        asked_lamps: int,
        seed: int,
    ) -> tuple[NDArray[np.float32], DeferredPaths]:
        """Return the irradiance that rays of points find, shape (point, band), and rays that are handed back.

        Parameters
        ----------
        points
            Places.
        even
            Two numbers for each ray of each point: directions follow by the cosine law.
        known
            Share of the open sky's light that each point, and all that its rays meet, takes as known.
        hidden_sky
            Whether objects hide the sky.
        depth, bounces
            Bounces between the points and the surface that the eye sees, and at most.
        roulette_from
            As of `Effort`.
        asked_lamps
            Lamps that are all asked; of more one is drawn.
        seed
            Seed of all that is drawn.

        Notes
        -----
        pi/rays times the sum over rays. A free one adds (1 - known) of the sky's radiance, one that is stopped takes
        known of it away and adds what leaves from where it stops. What glows is found by rays and by name, by shares
        (`direct.found_by_gathering`); at the points themselves it is left to others to look for it by name.
        """
        found = np.zeros((len(points), self.rho_by_pi.shape[1]), np.float32)
        tracer, room = self.tracer, 0 if self.matt.all() else len(points) * even.rays
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
        roulette = NEVER if roulette_from is None else roulette_from
        count = _follow(
            (tracer.scene.address, tracer.centre_m, tracer.planes, tracer.clearance_m),
            (self.material_of, self.rho_by_pi, self.matt),
            (self.sky, self.discs, self.lamps, self.panels, self.beams),
            (start, np.asarray(points.normal, np.float64), known),
            (even.start, even.rays),
            (depth, bounces, roulette, hidden_sky, asked_lamps),
            np.array([seed], np.uint64),
            (PathStates.of(found.shape[1]), new_packets(WAVE)),
            found,
            (back.owner, back.depth, back.face, back.place_m, back.direction, back.weight),
        )
        return found, DeferredPaths(**{name: values[:count] for name, values in vars(back).items()})


@numba.njit(**COMPILED)
def _follow(scene: Any, coats: Any, lights: Any, points: Any, even: Any, limits: Any, state: Any, room: Any, found: Any,
            back: Any) -> int:  # fmt: skip
    """Follow all rays of points, a wave at a time, and return how many are handed back."""
    scene, coats, lights, points = (
        without_reference_count(scene),
        without_reference_count(coats),
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
    depth_first, bounces, _, hidden_sky, asked_lamps = limits
    lanes, packets = room
    sky_counts, glows = hidden_sky and sky[2], len(panels[0]) > 0
    handed, now = 0, (0.0, 1.0, 0.0)
    for first in range(0, len(begin) * each, WAVE):
        many, now = _send(lanes, points, begin, each, now, first)
        depth, sent = depth_first, each
        while True:
            goes_on = depth < bounces
            meets = goes_on or glows
            if goes_on and len(beams[0]):
                add_light_traced_paths(scene, coats, lamps, beams, packets, lanes, many, state, found)
            many = _ask(scene, packets, lanes, many, meets)
            many = _meet_sky(scene, sky, packets, lanes, many, points[2], sent, meets, sky_counts, found)
            if meets:
                _arrive(scene, lanes, many)
            if glows:
                add_glow(panels, scene[2], lanes, many, sent, found)
            if not goes_on:
                break
            many, handed = _reflect(scene, coats, lanes, many, depth, limits, state, handed, back)
            if many == 0:
                break
            if sky[2]:
                add_known_sky(sky[1], lanes, many, points[2], hidden_sky, found)
            add_discs(scene, discs, packets, lanes, many, state, found)
            add_lamps(scene, lamps, beams, asked_lamps, packets, lanes, many, state, found)
            if glows:
                add_panels(scene, panels, packets, lanes, many, state, found)
            if sky_counts and len(sky[4]):
                add_bright(scene, sky, packets, lanes, many, points[2], state, found)
            depth, sent = depth + 1, 1
            if not (depth < bounces or glows or sky_counts):
                break
            _turn(lanes, many, state)
    return handed


@numba.njit(**COMPILED)
def _send(lanes: Any, points: Any, begin: Any, each: int, now: Any, first: int) -> Any:
    """Set out from points, and return how many rays do and where in its stretch the last one is."""
    starts, normals, _ = points
    many = min(WAVE, len(begin) * each - first)
    i, ray = first // each, first % each
    for lane in range(many):
        now = next_even(now) if ray else first_even(begin[i])
        lanes.going[lane], lanes.owner[lane], lanes.last[lane] = lane, i, 1.0
        lanes.cosine[lane] = by_cosine(normals[i], now, lanes.way[lane])
        for axis in range(3):
            lanes.start[lane, axis], lanes.normal[lane, axis] = starts[i, axis], normals[i, axis]
        for band in range(lanes.weight.shape[1]):
            lanes.weight[lane, band], lanes.leaves[lane, band] = np.pi / each, 1.0 / each
        i, ray = (i, ray + 1) if ray + 1 < each else (i + 1, 0)
    return many, now


@numba.njit(**COMPILED)
def _ask(scene: Any, packets: Any, lanes: Any, many: int, meets: bool) -> int:
    """Find what rays meet, or of last ones whether they meet anything; return how many ask."""
    address, centre = scene[0], scene[1]
    asked = 0
    for k in range(many):
        lane = lanes.going[k]
        # A last ray that points below the horizon has nothing to find.
        if meets or lanes.way[lane, 2] >= 0.0:
            set_ray(packets, asked, centre, lanes.start[lane], lanes.way[lane], np.inf)
            lanes.going[asked] = lane
            asked += 1
    if meets:
        intersect(address, packets, asked)
    else:
        trace_occlusion(address, packets, asked)
    return asked


@numba.njit(**COMPILED)
def _meet_sky(scene: Any, sky: Any, packets: Any, lanes: Any, many: int, known: Any, sent: int, meets: bool,
              sky_counts: bool, found: Any) -> int:  # fmt: skip
    """Add what free rays find of the sky, and take away what stopped ones hide of it; return how many go farther."""
    kept = 0
    for slot in range(many):
        lane = lanes.going[slot]
        i = lanes.owner[lane]
        if meets:
            lanes.face[lane] = triangle_of(packets, slot, scene[2])
            hit = lanes.face[lane] >= 0
        else:
            hit = is_ray_occluded(packets, slot)
        share = -float(known[i]) if hit else 1.0 - float(known[i])
        if hit and meets:
            lanes.going[kept] = lane
            kept += 1
        x, y, z = lanes.way[lane, 0], lanes.way[lane, 1], lanes.way[lane, 2]
        if sky_counts and z >= 0.0 and share != 0.0:
            own = sent * lanes.cosine[lane] / np.pi
            share *= own / (own + bright_density(sky[4], x, y, z))
            sky_light(sky[0], x, y, z, share, lanes.weight[lane], found[i])
    return kept


@numba.njit(**COMPILED)
def _arrive(scene: Any, lanes: Any, many: int) -> None:
    """Bring rays to what they met."""
    for k in range(many):
        lane = lanes.going[k]
        height, slope = 0.0, 0.0
        corner, normal = plane_of(scene[2], lanes.face[lane])
        for axis in range(3):
            height += (corner[axis] - lanes.start[lane, axis]) * normal[axis]
            slope += lanes.way[lane, axis] * normal[axis]
        length = height / slope
        length = max(length, 0.0) if np.isfinite(length) else 0.0
        side = 1.0 if slope < 0.0 else -1.0
        lanes.by_ray[lane] = lanes.cosine[lane] * abs(slope) / (np.pi * length * length)
        for axis in range(3):
            lanes.place[lane, axis] = lanes.start[lane, axis] + length * lanes.way[lane, axis]
            lanes.normal[lane, axis] = side * normal[axis]


@numba.njit(**COMPILED)
def _reflect(scene: Any, coats: Any, lanes: Any, many: int, depth: int, limits: Any, state: Any, handed: int, back: Any
             ) -> tuple[int, int]:  # fmt: skip
    """Let rays leave from where they are, unless chance ends them; from what is not matt they are handed back."""
    _, centre, _, clearance = scene
    material_of, rho_by_pi, matt = coats
    kept = 0
    for k in range(many):
        lane = lanes.going[k]
        weight, leaves = lanes.weight[lane], lanes.leaves[lane]
        if depth >= limits[2]:
            chance = min(max(lanes.last[lane], LEAST_CHANCE), MOST_CHANCE)
            if uniform(state) >= chance:
                continue
            for band in range(len(weight)):
                weight[band] /= np.float32(chance)
        face = lanes.face[lane]
        material = material_of[face & ROW]
        if not matt[material]:
            owners, depths, faces, places, ways, weights = back
            owners[handed], depths[handed], faces[handed] = lanes.owner[lane], depth + 1, face
            places[handed], ways[handed], weights[handed] = lanes.place[lane], lanes.way[lane], weight
            handed += 1
            continue
        reflected = 0.0
        for band in range(len(weight)):
            leaves[band] = weight[band] * rho_by_pi[material, band]
            weight[band] = leaves[band] * np.pi
            reflected += rho_by_pi[material, band]
        lanes.last[lane] = reflected * np.pi / len(weight)
        set_ray_start(clearance, centre, face, lanes.place[lane], lanes.normal[lane], lanes.start[lane])
        lanes.going[kept] = lane
        kept += 1
    return kept, handed


@numba.njit(**COMPILED)
def _turn(lanes: Any, many: int, state: Any) -> None:
    """Turn rays into new directions by the cosine law."""
    for k in range(many):
        lane = lanes.going[k]
        lanes.cosine[lane] = by_cosine(lanes.normal[lane], in_disc(state), lanes.way[lane])
