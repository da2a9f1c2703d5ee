"""Light by way of matt surfaces, followed by compiled loops: rays from place to place until nothing counts any more.

What `gather` does in batches for all kinds of surfaces is done here, sixteen rays at a time, where places are matt.
Rays that meet a surface which is not matt are handed back from where they met it.
"""

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from simulate.radiance.embree import (
    COMPILED,
    GEOMETRY,
    NONE,
    PACKET,
    REACH,
    TRIANGLE,
    aim,
    intersect,
    new_packet,
    stop,
)  # fmt: skip
from simulate.radiance.trace import Tracer
from simulate.radiance.transport.arrivals import (
    add_bright,
    add_discs,
    add_glow,
    add_known_sky,
    add_lamps,
    add_panels,
)  # fmt: skip
from simulate.radiance.transport.compiled_lights import bright_density, sky_light
from simulate.radiance.transport.even import R2, Even
from simulate.radiance.transport.lanes import by_cosine, new_lanes, raised, uniform
from simulate.radiance.transport.lit_places import add_lit_places
from simulate.radiance.transport.points import Points

# Chances with which paths go on, at least and at most.
LEAST_CHANCE, MOST_CHANCE = 0.05, 0.95
NEVER = 1 << 30


@dataclass(frozen=True, kw_only=True)
class HandedBack:
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
class Plain:
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

    tracer: Tracer
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
        points: Points,
        even: Even,
        *,
        known: NDArray[np.float32],
        hidden_sky: bool,
        depth: int,
        bounces: int,
        roulette_from: int | None,
        asked_lamps: int,
        seed: int,
    ) -> tuple[NDArray[np.float32], HandedBack]:
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
        back = HandedBack(
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
            (tracer.scene.address, tracer.centre_m, tracer.corner_m, tracer.normal, tracer.clearance_m),
            (self.material_of, self.rho_by_pi, self.matt),
            (self.sky, self.discs, self.lamps, self.panels, self.beams),
            (start, np.asarray(points.normal, np.float64), known, even.start),
            (even.rays, R2),
            (depth, bounces, roulette, hidden_sky, asked_lamps),
            np.array([seed], np.uint64),
            found,
            (back.owner, back.depth, back.face, back.place_m, back.direction, back.weight),
        )
        return found, HandedBack(**{name: values[:count] for name, values in vars(back).items()})


@numba.njit(**COMPILED)
def _follow(scene: Any, coats: Any, lights: Any, points: Any, rays: Any, limits: Any, state: Any, found: Any, back: Any
            ) -> int:  # fmt: skip
    """Follow all rays of points, a packet at a time, and return how many are handed back."""
    each, step = rays
    sky, discs, lamps, panels, beams = lights
    depth_first, bounces, _, hidden_sky, asked_lamps = limits
    sky_counts, glows = hidden_sky and sky[2], len(panels[0]) > 0
    packet, counts = new_packet()
    lanes = new_lanes(found.shape[1])
    alive, total, handed = lanes[0], len(points[0]) * each, 0
    for first in range(0, total, PACKET):
        _send(lanes, points, each, step, first, total)
        depth, sent = depth_first, each
        while alive.any():
            meets = depth < bounces or glows
            if depth < bounces and len(beams[0]):
                add_lit_places(scene, coats, lamps, beams, packet, counts, lanes, state, found)
            _ask(scene, packet, counts, lanes, meets)
            _meet_sky(sky, packet, lanes, points[2], sent, meets, sky_counts, found)
            if meets:
                _arrive(scene, packet, lanes)
            if glows:
                add_glow(panels, scene[3], lanes, sent, found)
            if depth >= bounces:
                alive[:] = False
            handed = _reflect(scene, coats, lanes, depth, limits, state, handed, back)
            if not alive.any():
                break
            if sky[2]:
                add_known_sky(sky[1], lanes, points[2], hidden_sky, found)
            add_discs(scene, discs, packet, counts, lanes, state, found)
            add_lamps(scene, lamps, beams, asked_lamps, packet, counts, lanes, state, found)
            if glows:
                add_panels(scene, panels, packet, counts, lanes, state, found)
            if sky_counts and len(sky[4]):
                add_bright(scene, sky, packet, counts, lanes, points[2], state, found)
            depth, sent = depth + 1, 1
            _turn(lanes, depth < bounces or glows or sky_counts, state)
    return handed


@numba.njit(**COMPILED)
def _send(lanes: Any, points: Any, each: int, step: Any, first: int, total: int) -> None:
    """Set out from points."""
    alive, owner, _, weight, leaves, _, start, normal, way, cosine, last, _, _, _ = lanes
    starts, normals, _, even = points
    for lane in range(PACKET):
        alive[lane] = first + lane < total
        if not alive[lane]:
            continue
        i = (first + lane) // each
        ray = first + lane - i * each
        owner[lane], last[lane] = i, 1.0
        square, turn = (even[i, 0] + ray * step[0]) % 1.0, (even[i, 1] + ray * step[1]) % 1.0
        cosine[lane] = by_cosine(normals[i], square, turn, way[lane])
        for axis in range(3):
            start[lane, axis], normal[lane, axis] = starts[i, axis], normals[i, axis]
        weight[lane], leaves[lane] = np.pi / each, 1.0 / each


@numba.njit(**COMPILED)
def _ask(scene: Any, packet: Any, counts: Any, lanes: Any, meets: bool) -> None:
    """Find what rays meet, or of last ones whether they meet anything."""
    address, centre = scene[0], scene[1]
    alive, start, way = lanes[0], lanes[6], lanes[8]
    number = packet.view(np.uint32)
    counts[:] = 0
    for lane in range(PACKET):
        # A last ray that points below the horizon has nothing to find.
        alive[lane] &= meets or way[lane, 2] >= 0.0
        if alive[lane]:
            aim(packet, counts, lane, centre, start[lane], way[lane], np.inf)
            number[GEOMETRY, lane] = NONE
    if meets:
        intersect(counts.ctypes.data, address, packet.ctypes.data, 0)
    else:
        stop(address, packet, counts)


@numba.njit(**COMPILED)
def _meet_sky(
    sky: Any, packet: Any, lanes: Any, known: Any, sent: int, meets: bool, sky_counts: bool, found: Any
) -> None:
    """Add what free rays find of the sky, and take away what stopped ones hide of it; rays that go no farther end."""
    alive, owner, _, weight, _, _, _, _, way, cosine, _, _, _, _ = lanes
    number = packet.view(np.uint32)
    for lane in range(PACKET):
        if not alive[lane]:
            continue
        i = owner[lane]
        hit = number[GEOMETRY, lane] != NONE if meets else packet[REACH, lane] < 0.0
        share = -float(known[i]) if hit else 1.0 - float(known[i])
        alive[lane] = hit and meets
        x, y, z = way[lane, 0], way[lane, 1], way[lane, 2]
        if sky_counts and z >= 0.0 and share != 0.0:
            own = sent * cosine[lane] / np.pi
            share *= own / (own + bright_density(sky[4], x, y, z))
            sky_light(sky[0], x, y, z, share, weight[lane], found[i])


@numba.njit(**COMPILED)
def _arrive(scene: Any, packet: Any, lanes: Any) -> None:
    """Bring rays to what they met."""
    _, _, corner, face_normal, _ = scene
    alive, face, place, start, normal, way = lanes[0], lanes[2], lanes[5], lanes[6], lanes[7], lanes[8]
    cosine, by_ray = lanes[9], lanes[13]
    number = packet.view(np.uint32)
    for lane in range(PACKET):
        if not alive[lane]:
            continue
        one = np.int64(number[TRIANGLE, lane])
        face[lane] = one
        height, slope = 0.0, 0.0
        for axis in range(3):
            height += (corner[one, axis] - start[lane, axis]) * face_normal[one, axis]
            slope += way[lane, axis] * face_normal[one, axis]
        length = height / slope
        length = max(length, 0.0) if np.isfinite(length) else 0.0
        side = 1.0 if slope < 0.0 else -1.0
        by_ray[lane] = cosine[lane] * abs(slope) / (np.pi * length * length)
        for axis in range(3):
            place[lane, axis] = start[lane, axis] + length * way[lane, axis]
            normal[lane, axis] = side * face_normal[one, axis]


@numba.njit(**COMPILED)
def _reflect(scene: Any, coats: Any, lanes: Any, depth: int, limits: Any, state: Any, handed: int, back: Any) -> int:
    """Let rays leave from where they are, unless chance ends them; from what is not matt they are handed back."""
    _, centre, _, _, clearance = scene
    material_of, rho_by_pi, matt = coats
    alive, owner, face, weight, leaves, place, start, normal, way, _, last, _, _, _ = lanes
    for lane in range(PACKET):
        if not alive[lane]:
            continue
        if depth >= limits[2]:
            chance = min(max(last[lane], LEAST_CHANCE), MOST_CHANCE)
            alive[lane] = uniform(state) < chance
            if not alive[lane]:
                continue
            weight[lane] /= np.float32(chance)
        one = face[lane]
        material = material_of[one]
        if not matt[material]:
            owners, depths, faces, places, ways, weights = back
            owners[handed], depths[handed], faces[handed] = owner[lane], depth + 1, one
            places[handed], ways[handed], weights[handed] = place[lane], way[lane], weight[lane]
            handed += 1
            alive[lane] = False
            continue
        last[lane] = 0.0
        for band in range(len(weight[lane])):
            leaves[lane, band] = weight[lane, band] * rho_by_pi[material, band]
            weight[lane, band] = leaves[lane, band] * np.pi
            last[lane] += rho_by_pi[material, band] * np.pi / len(weight[lane])
        raised(clearance, centre, one, place[lane], normal[lane], start[lane])
    return handed


@numba.njit(**COMPILED)
def _turn(lanes: Any, goes_on: bool, state: Any) -> None:
    """Turn rays into new directions by the cosine law, or end all."""
    alive, normal, way, cosine = lanes[0], lanes[7], lanes[8], lanes[9]
    for lane in range(PACKET):
        alive[lane] &= goes_on
        if alive[lane]:
            cosine[lane] = by_cosine(normal[lane], uniform(state), uniform(state), way[lane])
