"""Light by way of matt surfaces, followed by compiled loops: rays from place to place until nothing counts any more.

What `gather` does in batches for all kinds of surfaces is done here, sixteen rays at a time, where places are matt and
nothing glows. Rays that meet a surface which is not matt are handed back from where they met it.
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
from simulate.radiance.trace import CLEARANCE_SHARE, Tracer
from simulate.radiance.transport.compiled_lights import (
    bright_density,
    bright_way,
    lamp_pattern,
    sky_irradiance,
    sky_light,
)  # fmt: skip
from simulate.radiance.transport.even import R2, Even
from simulate.radiance.transport.points import Points

# A ray to a lamp ends so far before it.
SHORT = 1.0 - 1e-4
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
    sky, discs, lamps
        Sources, see `compiled_lights`.
    """

    tracer: Tracer
    material_of: NDArray[np.int64]
    rho_by_pi: NDArray[np.float32]
    matt: NDArray[np.bool_]
    sky: tuple
    discs: tuple
    lamps: tuple

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
        known of it away and adds what leaves from where it stops.
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
            (self.sky, self.discs, self.lamps),
            (start, np.asarray(points.normal, np.float64), known, even.start),
            (even.rays, R2),
            (depth, bounces, roulette, hidden_sky, asked_lamps),
            np.array([seed], np.uint64),
            found,
            (back.owner, back.depth, back.face, back.place_m, back.direction, back.weight),
        )
        return found, HandedBack(**{name: values[:count] for name, values in vars(back).items()})


@numba.njit(**COMPILED)
def _uniform(state: Any) -> float:
    """Draw an even number in [0, 1): SplitMix64 (Steele, Lea and Flood, 2014)."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return float((z ^ (z >> np.uint64(31))) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@numba.njit(**COMPILED)
def _turned(normal: Any, u: float, v: float, w: float, way: Any) -> None:
    """Set a direction from its parts in the frame of a normal, that of `points.frames`."""
    x, y, z = normal[0], normal[1], normal[2]
    sign = 1.0 if z >= 0.0 else -1.0
    a = -1.0 / (sign + z)
    b = x * y * a
    way[0] = u * (1.0 + sign * x * x * a) + v * b + w * x
    way[1] = u * sign * b + v * (sign + y * y * a) + w * y
    way[2] = -u * sign * x - v * y + w * z


@numba.njit(**COMPILED)
def _by_cosine(normal: Any, square: float, turn: float, way: Any) -> float:
    """Set a direction by the cosine law from two even numbers, and return its cosine."""
    radius, cosine = np.sqrt(square), np.sqrt(1.0 - square)
    _turned(normal, radius * np.cos(2.0 * np.pi * turn), radius * np.sin(2.0 * np.pi * turn), cosine, way)
    return cosine


@numba.njit(**COMPILED)
def _above(clearance: Any, centre: Any, face: Any, place: Any, normal: Any, start: Any) -> None:
    """Set where a ray from a surface starts, as `Tracer.above`."""
    shift = 0.0
    for axis in range(3):
        shift = max(shift, abs(place[axis] - centre[axis]))
    shift = max(clearance[face], CLEARANCE_SHARE * shift)
    for axis in range(3):
        start[axis] = place[axis] + shift * normal[axis]


@numba.njit(**COMPILED)
def _follow(scene: Any, coats: Any, lights: Any, points: Any, rays: Any, limits: Any, state: Any, found: Any, back: Any
            ) -> int:  # fmt: skip
    """Follow all rays of points, a packet at a time, and return how many are handed back."""
    each, step = rays
    sky = lights[0]
    depth_first, bounces, _, hidden_sky, asked_lamps = limits
    packet, counts = new_packet()
    lanes = _lanes(found.shape[1])
    alive, total, handed = lanes[0], len(points[0]) * each, 0
    for first in range(0, total, PACKET):
        _send(lanes, points, each, step, first, total)
        depth, sent = depth_first, each
        while alive.any():
            onwards = depth < bounces
            _ask(scene, packet, counts, lanes, onwards)
            _meet_sky(sky, packet, lanes, points[2], sent, onwards, hidden_sky, found)
            handed = _meet(scene, coats, packet, lanes, depth, limits, state, handed, back)
            if not alive.any():
                break
            if sky[2]:
                _add_known_sky(sky[1], lanes, points[2], hidden_sky, found)
            _add_discs(scene, lights[1], packet, counts, lanes, state, found)
            _add_lamps(scene, lights[2], asked_lamps, packet, counts, lanes, state, found)
            if hidden_sky and sky[2] and len(sky[4]):
                _add_bright(scene, sky, packet, counts, lanes, points[2], state, found)
            depth, sent = depth + 1, 1
            _turn(lanes, depth < bounces or (hidden_sky and sky[2]), state)
    return handed


@numba.njit(**COMPILED)
def _lanes(bands: int) -> Any:
    """Room for the rays of a packet, a row for each.

    Whether it goes on, its owner, the triangle it is at, weight and light leaving by band; place, start above it,
    normal and direction; cosine of the direction, mean of what the place reflects, a factor, and the source asked.
    """
    return (
        np.zeros(PACKET, np.bool_), np.zeros(PACKET, np.int64), np.zeros(PACKET, np.int64),
        np.zeros((PACKET, bands), np.float32), np.zeros((PACKET, bands), np.float32),
        np.zeros((PACKET, 3)), np.zeros((PACKET, 3)), np.zeros((PACKET, 3)), np.zeros((PACKET, 3)),
        np.zeros(PACKET), np.zeros(PACKET), np.zeros(PACKET), np.zeros(PACKET, np.int64),
    )  # fmt: skip


@numba.njit(**COMPILED)
def _send(lanes: Any, points: Any, each: int, step: Any, first: int, total: int) -> None:
    """Set out from points."""
    alive, owner, _, weight, _, _, start, _, way, cosine, last, _, _ = lanes
    starts, normals, _, even = points
    for lane in range(PACKET):
        alive[lane] = first + lane < total
        if not alive[lane]:
            continue
        i = (first + lane) // each
        ray = first + lane - i * each
        owner[lane], last[lane] = i, 1.0
        square, turn = (even[i, 0] + ray * step[0]) % 1.0, (even[i, 1] + ray * step[1]) % 1.0
        cosine[lane] = _by_cosine(normals[i], square, turn, way[lane])
        for axis in range(3):
            start[lane, axis] = starts[i, axis]
        weight[lane] = np.pi / each


@numba.njit(**COMPILED)
def _ask(scene: Any, packet: Any, counts: Any, lanes: Any, onwards: bool) -> None:
    """Find what rays meet, or of last ones whether they meet anything."""
    address, centre = scene[0], scene[1]
    alive, start, way = lanes[0], lanes[6], lanes[8]
    number = packet.view(np.uint32)
    counts[:] = 0
    for lane in range(PACKET):
        # A last ray that points below the horizon has nothing to find.
        alive[lane] &= onwards or way[lane, 2] >= 0.0
        if alive[lane]:
            aim(packet, counts, lane, centre, start[lane], way[lane], np.inf)
            number[GEOMETRY, lane] = NONE
    if onwards:
        intersect(counts.ctypes.data, address, packet.ctypes.data, 0)
    else:
        stop(address, packet, counts)


@numba.njit(**COMPILED)
def _meet_sky(
    sky: Any, packet: Any, lanes: Any, known: Any, sent: int, onwards: bool, hidden: bool, found: Any
) -> None:
    """Add what free rays find of the sky, and take away what stopped ones hide of it; rays that go no farther end."""
    alive, owner, _, weight, _, _, _, _, way, cosine, _, _, _ = lanes
    number = packet.view(np.uint32)
    for lane in range(PACKET):
        if not alive[lane]:
            continue
        i = owner[lane]
        hit = number[GEOMETRY, lane] != NONE if onwards else packet[REACH, lane] < 0.0
        share = -float(known[i]) if hit else 1.0 - float(known[i])
        alive[lane] = hit and onwards
        x, y, z = way[lane, 0], way[lane, 1], way[lane, 2]
        if sky[2] and hidden and z >= 0.0 and share != 0.0:
            own = sent * cosine[lane] / np.pi
            share *= own / (own + bright_density(sky[4], x, y, z))
            sky_light(sky[0], x, y, z, share, weight[lane], found[i])


@numba.njit(**COMPILED)
def _meet(scene: Any, coats: Any, packet: Any, lanes: Any, depth: int, limits: Any, state: Any, handed: int, back: Any
          ) -> int:  # fmt: skip
    """Bring rays to what they met, unless chance ends them; those that met what is not matt are handed back."""
    _, centre, corner, face_normal, clearance = scene
    material_of, rho_by_pi, matt = coats
    alive, owner, face, weight, leaves, place, start, normal, way, _, last, _, _ = lanes
    number = packet.view(np.uint32)
    for lane in range(PACKET):
        if not alive[lane]:
            continue
        if depth >= limits[2]:
            chance = min(max(last[lane], LEAST_CHANCE), MOST_CHANCE)
            alive[lane] = _uniform(state) < chance
            if not alive[lane]:
                continue
            weight[lane] /= np.float32(chance)
        one = np.int64(number[TRIANGLE, lane])
        face[lane] = one
        height, slope = 0.0, 0.0
        for axis in range(3):
            height += (corner[one, axis] - start[lane, axis]) * face_normal[one, axis]
            slope += way[lane, axis] * face_normal[one, axis]
        length = height / slope
        length = max(length, 0.0) if np.isfinite(length) else 0.0
        side = 1.0 if slope < 0.0 else -1.0
        for axis in range(3):
            place[lane, axis] = start[lane, axis] + length * way[lane, axis]
            normal[lane, axis] = side * face_normal[one, axis]
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
        _above(clearance, centre, one, place[lane], normal[lane], start[lane])
    return handed


@numba.njit(**COMPILED)
def _turn(lanes: Any, goes_on: bool, state: Any) -> None:
    """Turn rays into new directions by the cosine law, or end all."""
    alive, normal, way, cosine = lanes[0], lanes[7], lanes[8], lanes[9]
    for lane in range(PACKET):
        alive[lane] &= goes_on
        if alive[lane]:
            cosine[lane] = _by_cosine(normal[lane], _uniform(state), _uniform(state), way[lane])


@numba.njit(**COMPILED)
def _add_known_sky(irradiance: Any, lanes: Any, known: Any, hidden_sky: bool, found: Any) -> None:
    """Add the part of the sky that is taken as known at places."""
    alive, owner, leaves, normal = lanes[0], lanes[1], lanes[4], lanes[7]
    for lane in range(PACKET):
        if alive[lane]:
            i, up = owner[lane], normal[lane]
            share = float(known[i]) if hidden_sky else 1.0
            sky_irradiance(irradiance, up[0], up[1], up[2], share, leaves[lane], found[i])


@numba.njit(**COMPILED)
def _add_discs(scene: Any, discs: Any, packet: Any, counts: Any, lanes: Any, state: Any, found: Any) -> None:
    """Add light of sun and moon at places."""
    axes, least, light = discs
    alive, start, normal, way, factor, chosen = lanes[0], lanes[6], lanes[7], lanes[8], lanes[11], lanes[12]
    for disc in range(len(least)):
        counts[:] = 0
        for lane in range(PACKET):
            if not alive[lane]:
                continue
            up, turn = 1.0 - _uniform(state) * (1.0 - least[disc]), 2.0 * np.pi * _uniform(state)
            flat = np.sqrt(max(1.0 - up * up, 0.0))
            u, v = flat * np.cos(turn), flat * np.sin(turn)
            chosen[lane], factor[lane] = disc, 0.0
            for axis in range(3):
                way[lane, axis] = u * axes[disc, 0, axis] + v * axes[disc, 1, axis] + up * axes[disc, 2, axis]
                factor[lane] += way[lane, axis] * normal[lane, axis]
            if factor[lane] > 0.0:
                aim(packet, counts, lane, scene[1], start[lane], way[lane], np.inf)
        _add_unless_stopped(scene[0], packet, counts, lanes, light, found)


@numba.njit(**COMPILED)
def _add_lamps(
    scene: Any, lamps: Any, asked: int, packet: Any, counts: Any, lanes: Any, state: Any, found: Any
) -> None:
    """Add light of lamps at places: of all if few are asked, else of one that is drawn."""
    position, radius, spectrum = lamps[0], lamps[1], lamps[2]
    alive, place, start, normal = lanes[0], lanes[5], lanes[6], lanes[7]
    way, factor, chosen = lanes[8], lanes[11], lanes[12]
    draws = len(radius) > asked
    for lamp in range(1 if draws else len(radius)):
        counts[:] = 0
        for lane in range(PACKET):
            if not alive[lane]:
                continue
            one, chance = lamp, 1.0
            if draws:
                one, chance = _drawn(lamps, place[lane], normal[lane], _uniform(state))
            might = _lamp_factor(lamps, one, place[lane], normal[lane]) if chance > 0.0 else 0.0
            if might <= 0.0:
                continue
            chosen[lane], factor[lane], square = one, might / chance, 0.0
            for axis in range(3):
                way[lane, axis] = position[one, axis] - place[lane, axis]
                square += way[lane, axis] ** 2
            distance = np.sqrt(square)
            middle = (way[lane, 0] / distance, way[lane, 1] / distance, way[lane, 2] / distance)
            off, turn = radius[one] * np.sqrt(_uniform(state)), 2.0 * np.pi * _uniform(state)
            _turned(middle, off * np.cos(turn), off * np.sin(turn), distance, way[lane])
            aim(packet, counts, lane, scene[1], start[lane], way[lane], SHORT)
        _add_unless_stopped(scene[0], packet, counts, lanes, spectrum, found)


@numba.njit(**COMPILED)
def _add_unless_stopped(address: Any, packet: Any, counts: Any, lanes: Any, spectra: Any, found: Any) -> None:
    """Add light of the chosen sources of a packet's rays that reach them."""
    owner, leaves, factor, chosen = lanes[1], lanes[4], lanes[11], lanes[12]
    stop(address, packet, counts)
    for lane in range(PACKET):
        if counts[lane] != 0 and packet[REACH, lane] >= 0.0:
            for band in range(found.shape[1]):
                found[owner[lane], band] += leaves[lane, band] * factor[lane] * spectra[chosen[lane], band]


@numba.njit(**COMPILED)
def _add_bright(scene: Any, sky: Any, packet: Any, counts: Any, lanes: Any, known: Any, state: Any, found: Any) -> None:
    """Add the share of the sky that is looked for by its brightness, see `Stage._add_bright_sky`."""
    alive, owner, leaves, start = lanes[0], lanes[1], lanes[4], lanes[6]
    normal, way, factor = lanes[7], lanes[8], lanes[11]
    radiance, _, _, cumulated, per_sr, sines = sky
    counts[:] = 0
    for lane in range(PACKET):
        if not alive[lane]:
            continue
        bright_way(cumulated, sines, _uniform(state), _uniform(state), _uniform(state), way[lane])
        x, y, z = way[lane, 0], way[lane, 1], way[lane, 2]
        cosine = x * normal[lane, 0] + y * normal[lane, 1] + z * normal[lane, 2]
        if cosine > 0.0:
            factor[lane] = cosine / (cosine / np.pi + bright_density(per_sr, x, y, z))
            aim(packet, counts, lane, scene[1], start[lane], way[lane], np.inf)
    stop(scene[0], packet, counts)
    for lane in range(PACKET):
        if counts[lane] != 0:
            i = owner[lane]
            share = -float(known[i]) if packet[REACH, lane] < 0.0 else 1.0 - float(known[i])
            x, y, z = way[lane, 0], way[lane, 1], way[lane, 2]
            sky_light(radiance, x, y, z, share * factor[lane], leaves[lane], found[i])


@numba.njit(**COMPILED)
def _lamp_factor(lamps: Any, lamp: int, place: Any, normal: Any) -> float:
    """Irradiance of a lamp over its spectrum were nothing in the way, as `direct.lamp_factor`."""
    position, _, _, _, axes, ends, tables = lamps
    x, y, z = (position[lamp, 0] - place[0], position[lamp, 1] - place[1], position[lamp, 2] - place[2])
    square = x * x + y * y + z * z
    distance = np.sqrt(square)
    cosine = (x * normal[0] + y * normal[1] + z * normal[2]) / distance
    if not cosine > 0.0:
        return 0.0
    pattern = tables[ends[lamp] : ends[lamp + 1]]
    return cosine * lamp_pattern(pattern, axes[lamp], -x / distance, -y / distance, -z / distance) / square


@numba.njit(**COMPILED)
def _drawn(lamps: Any, place: Any, normal: Any, even: float) -> tuple[int, float]:
    """Draw one of several lamps by what it might give, and return it with its chance; zero where none gives any."""
    sums, total = lamps[3], 0.0
    for lamp in range(len(sums)):
        total += _lamp_factor(lamps, lamp, place, normal) * sums[lamp]
    if not total > 0.0:
        return 0, 0.0
    so_far, might, chosen = 0.0, 0.0, 0
    for lamp in range(len(sums)):
        this = _lamp_factor(lamps, lamp, place, normal) * sums[lamp]
        if this > 0.0:
            chosen, might = lamp, this
        so_far += this
        if so_far > even * total:
            break
    return chosen, might / total
