"""What sources send to the places where the rays of a packet are, each looked for by name: compiled loops."""

from typing import Any

import numba
import numpy as np

from simulate.radiance.embree import COMPILED, PACKET, REACH, aim, stop
from simulate.radiance.transport.compiled_lights import (
    SHORT,
    bright_density,
    bright_way,
    lamp_factor,
    sky_irradiance,
    sky_light,
    towards_lamp,
)  # fmt: skip
from simulate.radiance.transport.lanes import raised, uniform
from simulate.radiance.transport.lit_places import share_by_light


@numba.njit(**COMPILED)
def add_known_sky(irradiance: Any, lanes: Any, known: Any, hidden_sky: bool, found: Any) -> None:
    """Add the part of the sky that is taken as known at places."""
    alive, owner, leaves, normal = lanes[0], lanes[1], lanes[4], lanes[7]
    for lane in range(PACKET):
        if alive[lane]:
            i, up = owner[lane], normal[lane]
            share = float(known[i]) if hidden_sky else 1.0
            sky_irradiance(irradiance, up[0], up[1], up[2], share, leaves[lane], found[i])


@numba.njit(**COMPILED)
def add_discs(scene: Any, discs: Any, packet: Any, counts: Any, lanes: Any, state: Any, found: Any) -> None:
    """Add light of sun and moon at places."""
    axes, least, light = discs
    alive, start, normal, way, factor, chosen = lanes[0], lanes[6], lanes[7], lanes[8], lanes[11], lanes[12]
    for disc in range(len(least)):
        counts[:] = 0
        for lane in range(PACKET):
            if not alive[lane]:
                continue
            up, turn = 1.0 - uniform(state) * (1.0 - least[disc]), 2.0 * np.pi * uniform(state)
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
def add_lamps(
    scene: Any, lamps: Any, beams: Any, asked: int, packet: Any, counts: Any, lanes: Any, state: Any, found: Any
) -> None:
    """Add light of lamps at places, less what is found from the lamps: of all if few are asked, else of one drawn."""
    place, start, way, chosen = lanes[5], lanes[6], lanes[8], lanes[12]
    draws = len(lamps[0]) > asked
    for lamp in range(1 if draws else len(lamps[0])):
        _choose(lamps, lamp, draws, lanes, state)
        if len(beams[0]):
            _leave_to_light(scene, lamps, beams, packet, counts, lanes)
        counts[:] = 0
        for lane in range(PACKET):
            if lanes[0][lane] and lanes[11][lane] > 0.0:
                towards_lamp(lamps, chosen[lane], place[lane], state, way[lane])
                aim(packet, counts, lane, scene[1], start[lane], way[lane], SHORT)
        _add_unless_stopped(scene[0], packet, counts, lanes, lamps[2], found)


@numba.njit(**COMPILED)
def _choose(lamps: Any, lamp: int, draws: bool, lanes: Any, state: Any) -> None:
    """Set which lamp each place asks, and what it would get of it."""
    alive, place, normal, factor, chosen = lanes[0], lanes[5], lanes[7], lanes[11], lanes[12]
    for lane in range(PACKET):
        if not alive[lane]:
            continue
        one, chance = lamp, 1.0
        if draws:
            one, chance = _drawn(lamps, place[lane], normal[lane], uniform(state))
        might = lamp_factor(lamps, one, place[lane], normal[lane]) if chance > 0.0 else 0.0
        chosen[lane], factor[lane] = one, might / chance if might > 0.0 else 0.0


@numba.njit(**COMPILED)
def _leave_to_light(scene: Any, lamps: Any, beams: Any, packet: Any, counts: Any, lanes: Any) -> None:
    """Take from what places get the share that `lit_places.add_lit_places` finds: where the lamp's middle sees them."""
    alive, place, start, normal = lanes[0], lanes[5], lanes[6], lanes[7]
    factor, chosen, by_ray = lanes[11], lanes[12], lanes[13]
    share, way = np.zeros(PACKET), np.empty(3)
    counts[:] = 0
    for lane in range(PACKET):
        if not alive[lane] or factor[lane] <= 0.0:
            continue
        lamp = chosen[lane]
        share[lane] = share_by_light(beams, lamps, lamp, place[lane], normal[lane], by_ray[lane])
        if share[lane] > 0.0:
            for axis in range(3):
                way[axis] = lamps[0][lamp, axis] - start[lane, axis]
            aim(packet, counts, lane, scene[1], start[lane], way, SHORT)
    stop(scene[0], packet, counts)
    for lane in range(PACKET):
        if counts[lane] != 0 and packet[REACH, lane] >= 0.0:
            factor[lane] *= 1.0 - share[lane]


@numba.njit(**COMPILED)
def add_panels(scene: Any, panels: Any, packet: Any, counts: Any, lanes: Any, state: Any, found: Any) -> None:
    """Add light of a glowing surface at places, from a place on it that is drawn by power, as `direct.from_panels`."""
    address, centre, _, _, clearance = scene
    cumulated, faces, corners, normals, per_m2, kind, spectra = panels
    alive, place, start, normal = lanes[0], lanes[5], lanes[6], lanes[7]
    way, factor, chosen = lanes[8], lanes[11], lanes[12]
    counts[:] = 0
    for lane in range(PACKET):
        if not alive[lane]:
            continue
        panel = min(np.searchsorted(cumulated, uniform(state), side="right"), len(cumulated) - 1)
        root, v, face = np.sqrt(uniform(state)), uniform(state), faces[panel]
        square, cosine, leaving = 0.0, 0.0, 0.0
        for axis in range(3):
            a, b, c = corners[panel, 0, axis], corners[panel, 1, axis], corners[panel, 2, axis]
            way[lane, axis] = (1.0 - root) * a + root * ((1.0 - v) * b + v * c)
            off = way[lane, axis] - place[lane, axis]
            square += off * off
            cosine += off * normal[lane, axis]
            leaving -= off * normals[panel, axis]
        if cosine <= 0.0 or leaving <= 0.0:
            continue
        distance = np.sqrt(square)
        cosine /= distance
        chosen[lane] = kind[face]
        factor[lane] = cosine / (per_m2[face] * square * distance / leaving + cosine / np.pi)
        raised(clearance, centre, face, way[lane], normals[panel], way[lane])
        for axis in range(3):
            way[lane, axis] -= start[lane, axis]
        aim(packet, counts, lane, centre, start[lane], way[lane], SHORT)
    _add_unless_stopped(address, packet, counts, lanes, spectra, found)


@numba.njit(**COMPILED)
def add_glow(panels: Any, face_normal: Any, lanes: Any, sent: int, found: Any) -> None:
    """Add the glow of what rays have met, the share that is theirs: the counterpart of `add_panels`.

    `sent` rays came from the place where each set out, by the cosine law.
    """
    per_m2, kind, spectra = panels[4], panels[5], panels[6]
    alive, owner, face, weight, place = lanes[0], lanes[1], lanes[2], lanes[3], lanes[5]
    start, way, cosine = lanes[6], lanes[8], lanes[9]
    for lane in range(PACKET):
        if not alive[lane] or kind[face[lane]] < 0:
            continue
        square, leaving = 0.0, 0.0
        for axis in range(3):
            square += (place[lane, axis] - start[lane, axis]) ** 2
            leaving -= way[lane, axis] * face_normal[face[lane], axis]
        if leaving <= 0.0:
            continue
        own = sent * cosine[lane] / np.pi
        share = own / (own + per_m2[face[lane]] * square / leaving)
        for band in range(found.shape[1]):
            found[owner[lane], band] += share * weight[lane, band] * spectra[kind[face[lane]], band]


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
def add_bright(scene: Any, sky: Any, packet: Any, counts: Any, lanes: Any, known: Any, state: Any, found: Any) -> None:
    """Add the share of the sky that is looked for by its brightness, see `Stage._add_bright_sky`."""
    alive, owner, leaves, start = lanes[0], lanes[1], lanes[4], lanes[6]
    normal, way, factor = lanes[7], lanes[8], lanes[11]
    radiance, _, _, cumulated, per_sr, sines = sky
    counts[:] = 0
    for lane in range(PACKET):
        if not alive[lane]:
            continue
        bright_way(cumulated, sines, uniform(state), uniform(state), uniform(state), way[lane])
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
def _drawn(lamps: Any, place: Any, normal: Any, even: float) -> tuple[int, float]:
    """Draw one of several lamps by what it might give, and return it with its chance; zero where none gives any."""
    sums, total = lamps[3], 0.0
    for lamp in range(len(sums)):
        total += lamp_factor(lamps, lamp, place, normal) * sums[lamp]
    if not total > 0.0:
        return 0, 0.0
    so_far, might, chosen = 0.0, 0.0, 0
    for lamp in range(len(sums)):
        this = lamp_factor(lamps, lamp, place, normal) * sums[lamp]
        if this > 0.0:
            chosen, might = lamp, this
        so_far += this
        if so_far > even * total:
            break
    return chosen, might / total
