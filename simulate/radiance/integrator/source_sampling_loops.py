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
    draw_sky_direction,
    sky_density,
    sky_irradiance,
    sky_light,
)
from simulate.radiance.integrator.light_sources import SHORT, lamp_factor, towards_lamp
from simulate.radiance.integrator.light_tracing import light_tracing_weight
from simulate.radiance.integrator.sampling import set_ray_start, uniform


@numba.njit(**COMPILED)
def add_control_sky(
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
        i, normal = lanes.point[lane], lanes.normal[lane]
        control_fraction = float(control[i]) if sky_shadowing else 1.0
        if control_fraction != 0.0:
            sky_irradiance(
                irradiance,
                normal[0],
                normal[1],
                normal[2],
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
    for source in range(len(limb_cosines)):
        n_rays = 0
        for k in range(path_count):
            lane = lanes.active[k]
            z, azimuth = (
                1.0 - uniform(state) * (1.0 - limb_cosines[source]),
                2.0 * np.pi * uniform(state),
            )
            sine = np.sqrt(max(1.0 - z * z, 0.0))
            u, v, factor = sine * np.cos(azimuth), sine * np.sin(azimuth), 0.0
            for axis in range(3):
                component = (
                    u * axes[source, 0, axis]
                    + v * axes[source, 1, axis]
                    + z * axes[source, 2, axis]
                )
                lanes.direction[lane, axis] = component
                factor += component * lanes.normal[lane, axis]
            if factor > 0.0:
                lanes.source[lane], lanes.factor[lane], lanes.shadow_rays[n_rays] = (
                    source,
                    factor,
                    lane,
                )
                set_ray(packets, n_rays, scene[1], lanes.start[lane], lanes.direction[lane], np.inf)
                n_rays += 1
        _add_unoccluded(scene[0], packets, lanes, n_rays, light, irradiance)


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
        _choose_lamps(lamps, lamp, draws, lanes, path_count, state)
        if len(beams[0]):
            _subtract_light_traced(scene, lamps, beams, packets, lanes, path_count)
        n_rays = 0
        for k in range(path_count):
            lane = lanes.active[k]
            if lanes.factor[lane] > 0.0:
                lanes.shadow_rays[n_rays] = lane
                towards_lamp(
                    lamps, lanes.source[lane], lanes.vertex[lane], state, lanes.direction[lane]
                )
                set_ray(packets, n_rays, scene[1], lanes.start[lane], lanes.direction[lane], SHORT)
                n_rays += 1
        _add_unoccluded(scene[0], packets, lanes, n_rays, lamps[2], irradiance)


@numba.njit(**COMPILED)
def _choose_lamps(
    lamps: Any, lamp: int, draws: bool, lanes: Any, path_count: int, state: Any
) -> None:
    """Set the lamp that each path vertex samples, and its unoccluded irradiance."""
    for k in range(path_count):
        lane = lanes.active[k]
        chosen_lamp, probability = lamp, 1.0
        if draws:
            chosen_lamp, probability = _draw_lamp(
                lamps, lanes.vertex[lane], lanes.normal[lane], uniform(state)
            )
        lamp_irradiance = (
            lamp_factor(lamps, chosen_lamp, lanes.vertex[lane], lanes.normal[lane])
            if probability > 0.0
            else 0.0
        )
        lanes.source[lane], lanes.factor[lane] = (
            chosen_lamp,
            lamp_irradiance / probability if lamp_irradiance > 0.0 else 0.0,
        )


@numba.njit(**COMPILED)
def _subtract_light_traced(
    scene: Any, lamps: Any, beams: Any, packets: Any, lanes: Any, path_count: int
) -> None:
    """Remove the light-traced part (`add_light_traced_paths`) at vertices visible from the lamp's
    centre.
    """
    n_rays = 0
    for k in range(path_count):
        lane = lanes.active[k]
        if lanes.factor[lane] <= 0.0:
            continue
        lamp, vertex = lanes.source[lane], lanes.vertex[lane]
        if (
            light_tracing_weight(
                beams, lamps, lamp, vertex, lanes.normal[lane], lanes.path_density[lane]
            )
            > 0.0
        ):
            for axis in range(3):
                lanes.direction[lane, axis] = lamps[0][lamp, axis] - lanes.start[lane, axis]
            lanes.shadow_rays[n_rays] = lane
            set_ray(packets, n_rays, scene[1], lanes.start[lane], lanes.direction[lane], SHORT)
            n_rays += 1
    trace_occlusion(scene[0], packets, n_rays)
    for slot in range(n_rays):
        if not is_ray_occluded(packets, slot):
            lane = lanes.shadow_rays[slot]
            lamp, vertex = lanes.source[lane], lanes.vertex[lane]
            weight = light_tracing_weight(
                beams, lamps, lamp, vertex, lanes.normal[lane], lanes.path_density[lane]
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
    cumulative, faces, corners, normals, per_m2, kind, spectra = panels
    n_rays = 0
    for k in range(path_count):
        lane = lanes.active[k]
        panel = min(np.searchsorted(cumulative, uniform(state), side="right"), len(cumulative) - 1)
        root, v, face, target = (
            np.sqrt(uniform(state)),
            uniform(state),
            faces[panel],
            lanes.direction[lane],
        )
        square, cosine, source_cosine = 0.0, 0.0, 0.0
        for axis in range(3):
            a, b, c = corners[panel, 0, axis], corners[panel, 1, axis], corners[panel, 2, axis]
            target[axis] = (1.0 - root) * a + root * ((1.0 - v) * b + v * c)
            offset = target[axis] - lanes.vertex[lane, axis]
            square += offset * offset
            cosine += offset * lanes.normal[lane, axis]
            source_cosine -= offset * normals[panel, axis]
        if cosine <= 0.0 or source_cosine <= 0.0:
            continue
        distance = np.sqrt(square)
        cosine /= distance
        lanes.source[lane] = kind[face]
        lanes.factor[lane] = cosine / (
            per_m2[face] * square * distance / source_cosine + cosine / np.pi
        )
        set_ray_start(clearance, centre, face, target, normals[panel], target)
        for axis in range(3):
            target[axis] -= lanes.start[lane, axis]
        lanes.shadow_rays[n_rays] = lane
        set_ray(packets, n_rays, centre, lanes.start[lane], target, SHORT)
        n_rays += 1
    _add_unoccluded(address, packets, lanes, n_rays, spectra, irradiance)


@numba.njit(**COMPILED)
def add_hit_emission(
    panels: Any, planes: Any, lanes: Any, path_count: int, gather_rays: int, irradiance: Any
) -> None:
    """Add the emission of what rays have met with its multiple-importance weight: the counterpart
    of `add_panels`.

    `gather_rays` rays left the vertex where each started, by the cosine law.
    """
    per_m2, kind, spectra = panels[4], panels[5], panels[6]
    for k in range(path_count):
        lane = lanes.active[k]
        face = lanes.face[lane]
        if kind[face & ROW] < 0:
            continue
        normal = plane_of(planes, face)[1]
        square, source_cosine = 0.0, 0.0
        for axis in range(3):
            square += (lanes.vertex[lane, axis] - lanes.start[lane, axis]) ** 2
            source_cosine -= lanes.direction[lane, axis] * normal[axis]
        if source_cosine <= 0.0:
            continue
        gather_density = gather_rays * lanes.cosine[lane] / np.pi
        mis_weight = gather_density / (gather_density + per_m2[face & ROW] * square / source_cosine)
        for band in range(irradiance.shape[1]):
            irradiance[lanes.point[lane], band] += (
                mis_weight * lanes.weight[lane, band] * spectra[kind[face & ROW], band]
            )


@numba.njit(**COMPILED)
def _add_unoccluded(
    address: Any, packets: Any, lanes: Any, n_rays: int, spectra: Any, irradiance: Any
) -> None:
    """Add light of the chosen sources along shadow rays that are not occluded."""
    trace_occlusion(address, packets, n_rays)
    for slot in range(n_rays):
        if not is_ray_occluded(packets, slot):
            lane = lanes.shadow_rays[slot]
            point, source, factor = lanes.point[lane], lanes.source[lane], lanes.factor[lane]
            for band in range(irradiance.shape[1]):
                irradiance[point, band] += (
                    lanes.throughput[lane, band] * factor * spectra[source, band]
                )


@numba.njit(**COMPILED)
def add_bright_sky(
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
    radiance, _, _, cumulative, per_sr, sines = sky
    n_rays = 0
    for k in range(path_count):
        lane = lanes.active[k]
        direction, normal = lanes.direction[lane], lanes.normal[lane]
        draw_sky_direction(
            cumulative, sines, uniform(state), uniform(state), uniform(state), direction
        )
        cosine = direction[0] * normal[0] + direction[1] * normal[1] + direction[2] * normal[2]
        if cosine > 0.0:
            lanes.factor[lane] = cosine / (
                cosine / np.pi + sky_density(per_sr, direction[0], direction[1], direction[2])
            )
            lanes.shadow_rays[n_rays] = lane
            set_ray(packets, n_rays, scene[1], lanes.start[lane], direction, np.inf)
            n_rays += 1
    trace_occlusion(scene[0], packets, n_rays)
    for slot in range(n_rays):
        lane = lanes.shadow_rays[slot]
        i, direction = lanes.point[lane], lanes.direction[lane]
        sky_fraction = (
            -float(control[i]) if is_ray_occluded(packets, slot) else 1.0 - float(control[i])
        )
        sky_light(
            radiance,
            direction[0],
            direction[1],
            direction[2],
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
    cumulative, lamp_irradiance, source = 0.0, 0.0, 0
    for lamp in range(len(sums)):
        factor_sum = lamp_factor(lamps, lamp, vertex, normal) * sums[lamp]
        if factor_sum > 0.0:
            source, lamp_irradiance = lamp, factor_sum
        cumulative += factor_sum
        if cumulative > uniform_number * total:
            break
    return source, lamp_irradiance / total
