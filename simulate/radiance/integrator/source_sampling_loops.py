"""Next-event estimation at the path vertices of a wave: compiled loops over sky, discs, lamps and
panels.
"""

from typing import Any

import numba
import numpy as np

from simulate.radiance.geometry.embree import (
    COMPILED,
    INLINED,
    ROW,
    is_ray_occluded,
    plane_of,
    set_ray,
    trace_occlusion,
)
from simulate.radiance.integrator.environment_map import (
    bright_density,
    bright_way,
    sky_irradiance,
    sky_light,
)
from simulate.radiance.integrator.light_sources import SHORT, lamp_factor, towards_lamp
from simulate.radiance.integrator.light_tracing import light_tracing_weight
from simulate.radiance.integrator.sampling import set_ray_start, uniform


@numba.njit(**COMPILED)
def add_known_sky(
    irradiance: Any,
    lanes: Any,
    path_count: int,
    control: Any,
    sky_shadowing: bool,
    irradiance_sums: Any,
) -> None:
    """Add the control variate of the sky at path vertices."""
    for k in range(path_count):
        lane = lanes.active[k]
        i, up = lanes.point[lane], lanes.normal[lane]
        control_fraction = float(control[i]) if sky_shadowing else 1.0
        if control_fraction != 0.0:
            sky_irradiance(
                irradiance,
                up[0],
                up[1],
                up[2],
                control_fraction,
                lanes.throughput[lane],
                irradiance_sums[i],
            )


@numba.njit(**COMPILED)
def add_discs(
    scene: Any, discs: Any, packets: Any, lanes: Any, path_count: int, state: Any, irradiance: Any
) -> None:
    """Add light of sun and moon at path vertices."""
    axes, limb_cosines, light = discs
    for disc in range(len(limb_cosines)):
        asked = 0
        for k in range(path_count):
            lane = lanes.active[k]
            up, turn = (
                1.0 - uniform(state) * (1.0 - limb_cosines[disc]),
                2.0 * np.pi * uniform(state),
            )
            flat = np.sqrt(max(1.0 - up * up, 0.0))
            u, v, factor = flat * np.cos(turn), flat * np.sin(turn), 0.0
            for axis in range(3):
                way = u * axes[disc, 0, axis] + v * axes[disc, 1, axis] + up * axes[disc, 2, axis]
                lanes.direction[lane, axis] = way
                factor += way * lanes.normal[lane, axis]
            if factor > 0.0:
                lanes.chosen[lane], lanes.factor[lane], lanes.shadow_rays[asked] = (
                    disc,
                    factor,
                    lane,
                )
                set_ray(packets, asked, scene[1], lanes.start[lane], lanes.direction[lane], np.inf)
                asked += 1
        _add_unless_stopped(scene[0], packets, lanes, asked, light, irradiance)


@numba.njit(**COMPILED)
def add_lamps(
    scene: Any,
    lamps: Any,
    beams: Any,
    max_lamps: int,
    packets: Any,
    lanes: Any,
    path_count: int,
    state: Any,
    irradiance: Any,
) -> None:
    """Add light of lamps at path vertices, less the light-traced part: of all lamps if few, else of
    one drawn.
    """
    draws = len(lamps[0]) > max_lamps
    for lamp in range(1 if draws else len(lamps[0])):
        _choose(lamps, lamp, draws, lanes, path_count, state)
        if len(beams[0]):
            _leave_to_light(scene, lamps, beams, packets, lanes, path_count)
        asked = 0
        for k in range(path_count):
            lane = lanes.active[k]
            if lanes.factor[lane] > 0.0:
                lanes.shadow_rays[asked] = lane
                towards_lamp(
                    lamps, lanes.chosen[lane], lanes.vertex[lane], state, lanes.direction[lane]
                )
                set_ray(packets, asked, scene[1], lanes.start[lane], lanes.direction[lane], SHORT)
                asked += 1
        _add_unless_stopped(scene[0], packets, lanes, asked, lamps[2], irradiance)


@numba.njit(**COMPILED)
def _choose(lamps: Any, lamp: int, draws: bool, lanes: Any, path_count: int, state: Any) -> None:
    """Set the lamp that each path vertex samples, and its unoccluded irradiance."""
    for k in range(path_count):
        lane = lanes.active[k]
        chosen_lamp, chance = lamp, 1.0
        if draws:
            chosen_lamp, chance = _draw_lamp(
                lamps, lanes.vertex[lane], lanes.normal[lane], uniform(state)
            )
        might = (
            lamp_factor(lamps, chosen_lamp, lanes.vertex[lane], lanes.normal[lane])
            if chance > 0.0
            else 0.0
        )
        lanes.chosen[lane], lanes.factor[lane] = chosen_lamp, might / chance if might > 0.0 else 0.0


@numba.njit(**COMPILED)
def _leave_to_light(
    scene: Any, lamps: Any, beams: Any, packets: Any, lanes: Any, path_count: int
) -> None:
    """Remove the light-traced part (`add_light_traced_paths`) at vertices visible from the lamp's
    centre.
    """
    asked = 0
    for k in range(path_count):
        lane = lanes.active[k]
        if lanes.factor[lane] <= 0.0:
            continue
        lamp, vertex = lanes.chosen[lane], lanes.vertex[lane]
        if (
            light_tracing_weight(beams, lamps, lamp, vertex, lanes.normal[lane], lanes.by_ray[lane])
            > 0.0
        ):
            for axis in range(3):
                lanes.direction[lane, axis] = lamps[0][lamp, axis] - lanes.start[lane, axis]
            lanes.shadow_rays[asked] = lane
            set_ray(packets, asked, scene[1], lanes.start[lane], lanes.direction[lane], SHORT)
            asked += 1
    trace_occlusion(scene[0], packets, asked)
    for slot in range(asked):
        if not is_ray_occluded(packets, slot):
            lane = lanes.shadow_rays[slot]
            lamp, vertex = lanes.chosen[lane], lanes.vertex[lane]
            weight = light_tracing_weight(
                beams, lamps, lamp, vertex, lanes.normal[lane], lanes.by_ray[lane]
            )
            lanes.factor[lane] *= 1.0 - weight


@numba.njit(**COMPILED)
def add_panels(
    scene: Any, panels: Any, packets: Any, lanes: Any, path_count: int, state: Any, irradiance: Any
) -> None:
    """Add light of emitting surfaces from points drawn by power, as
    `direct_lighting.sample_panels`.
    """
    address, centre, _, clearance = scene
    cumulated, faces, corners, normals, per_m2, kind, spectra = panels
    asked = 0
    for k in range(path_count):
        lane = lanes.active[k]
        panel = min(np.searchsorted(cumulated, uniform(state), side="right"), len(cumulated) - 1)
        root, v, face, way = (
            np.sqrt(uniform(state)),
            uniform(state),
            faces[panel],
            lanes.direction[lane],
        )
        square, cosine, leaving = 0.0, 0.0, 0.0
        for axis in range(3):
            a, b, c = corners[panel, 0, axis], corners[panel, 1, axis], corners[panel, 2, axis]
            way[axis] = (1.0 - root) * a + root * ((1.0 - v) * b + v * c)
            off = way[axis] - lanes.vertex[lane, axis]
            square += off * off
            cosine += off * lanes.normal[lane, axis]
            leaving -= off * normals[panel, axis]
        if cosine <= 0.0 or leaving <= 0.0:
            continue
        distance = np.sqrt(square)
        cosine /= distance
        lanes.chosen[lane] = kind[face]
        lanes.factor[lane] = cosine / (per_m2[face] * square * distance / leaving + cosine / np.pi)
        set_ray_start(clearance, centre, face, way, normals[panel], way)
        for axis in range(3):
            way[axis] -= lanes.start[lane, axis]
        lanes.shadow_rays[asked] = lane
        set_ray(packets, asked, centre, lanes.start[lane], way, SHORT)
        asked += 1
    _add_unless_stopped(address, packets, lanes, asked, spectra, irradiance)


@numba.njit(**COMPILED)
def add_glow(
    panels: Any, planes: Any, lanes: Any, path_count: int, sent: int, irradiance: Any
) -> None:
    """Add the emission of what rays have met with its multiple-importance weight: the counterpart
    of `add_panels`.

    `sent` rays left the vertex where each started, by the cosine law.
    """
    per_m2, kind, spectra = panels[4], panels[5], panels[6]
    for k in range(path_count):
        lane = lanes.active[k]
        face = lanes.face[lane]
        if kind[face & ROW] < 0:
            continue
        normal = plane_of(planes, face)[1]
        square, leaving = 0.0, 0.0
        for axis in range(3):
            square += (lanes.vertex[lane, axis] - lanes.start[lane, axis]) ** 2
            leaving -= lanes.direction[lane, axis] * normal[axis]
        if leaving <= 0.0:
            continue
        gather_density = sent * lanes.cosine[lane] / np.pi
        mis_weight = gather_density / (gather_density + per_m2[face & ROW] * square / leaving)
        for band in range(irradiance.shape[1]):
            irradiance[lanes.point[lane], band] += (
                mis_weight * lanes.weight[lane, band] * spectra[kind[face & ROW], band]
            )


@numba.njit(**COMPILED)
def _add_unless_stopped(
    address: Any, packets: Any, lanes: Any, asked: int, spectra: Any, irradiance: Any
) -> None:
    """Add light of the chosen sources along shadow rays that are not occluded."""
    trace_occlusion(address, packets, asked)
    for slot in range(asked):
        if not is_ray_occluded(packets, slot):
            lane = lanes.shadow_rays[slot]
            owner, chosen, factor = lanes.point[lane], lanes.chosen[lane], lanes.factor[lane]
            for band in range(irradiance.shape[1]):
                irradiance[owner, band] += (
                    lanes.throughput[lane, band] * factor * spectra[chosen, band]
                )


@numba.njit(**COMPILED)
def add_bright(
    scene: Any,
    sky: Any,
    packets: Any,
    lanes: Any,
    path_count: int,
    control: Any,
    state: Any,
    irradiance: Any,
) -> None:
    """Add the importance-sampled part of the sky, as `outgoing_radiance` does in batches."""
    radiance, _, _, cumulated, per_sr, sines = sky
    asked = 0
    for k in range(path_count):
        lane = lanes.active[k]
        way, up = lanes.direction[lane], lanes.normal[lane]
        bright_way(cumulated, sines, uniform(state), uniform(state), uniform(state), way)
        cosine = way[0] * up[0] + way[1] * up[1] + way[2] * up[2]
        if cosine > 0.0:
            lanes.factor[lane] = cosine / (
                cosine / np.pi + bright_density(per_sr, way[0], way[1], way[2])
            )
            lanes.shadow_rays[asked] = lane
            set_ray(packets, asked, scene[1], lanes.start[lane], way, np.inf)
            asked += 1
    trace_occlusion(scene[0], packets, asked)
    for slot in range(asked):
        lane = lanes.shadow_rays[slot]
        i, way = lanes.point[lane], lanes.direction[lane]
        sky_fraction = (
            -float(control[i]) if is_ray_occluded(packets, slot) else 1.0 - float(control[i])
        )
        sky_light(
            radiance,
            way[0],
            way[1],
            way[2],
            sky_fraction * lanes.factor[lane],
            lanes.throughput[lane],
            irradiance[i],
        )


@numba.njit(**INLINED)
def _draw_lamp(lamps: Any, vertex: Any, normal: Any, uniform_number: float) -> tuple[int, float]:
    """Draw one lamp by its unoccluded irradiance, and return it with its probability; zero if no
    lamp gives light.
    """
    sums, total = lamps[3], 0.0
    for lamp in range(len(sums)):
        total += lamp_factor(lamps, lamp, vertex, normal) * sums[lamp]
    if not total > 0.0:
        return 0, 0.0
    so_far, might, chosen = 0.0, 0.0, 0
    for lamp in range(len(sums)):
        this = lamp_factor(lamps, lamp, vertex, normal) * sums[lamp]
        if this > 0.0:
            chosen, might = lamp, this
        so_far += this
        if so_far > uniform_number * total:
            break
    return chosen, might / total
