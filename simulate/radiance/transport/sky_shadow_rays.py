"""What matt places get of the sky where of all that stands around only its shadow counts: in half the time of paths."""

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from simulate.radiance.embree import COMPILED, PACKET, is_ray_occluded, new_packets, set_ray, trace_occlusion
from simulate.radiance.no_reference_count import without_reference_count
from simulate.radiance.ray_tracer import RayTracer
from simulate.radiance.transport.compiled_light_sources import sky_light
from simulate.radiance.transport.environment_map import EnvironmentMap
from simulate.radiance.transport.low_discrepancy import SequenceSlice
from simulate.radiance.transport.path_states import by_cosine, first_even, next_even
from simulate.radiance.transport.shading_points import ShadingPoints


def sky_residual_irradiance(
    points: ShadingPoints, even: SequenceSlice, dome: EnvironmentMap, tracer: RayTracer
) -> NDArray[np.float32]:
    """Return the irradiance that rays add to the part of the sky that is taken as known, shape (point, band).

    Parameters
    ----------
    points
        Places, whose `known` says how much of the sky counts already.
    even
        Two numbers for each ray of each point: directions follow by the cosine law.
    environment_map, tracer
        The sky, and what may hide it.

    Notes
    -----
    pi/rays times the sum of (1 - known) L where a ray is free and of -known L where it is not.
    """
    bands = dome.radiance_table.shape[2]
    found = np.zeros((len(points), bands), np.float32)
    if tracer.scene is not None:
        start = tracer.above(points.face, points.place_m, points.normal)
        room = (new_packets(PACKET), np.zeros(PACKET, np.int64), np.zeros((PACKET, 3)), np.ones(bands, np.float32))
        scene, here = (tracer.scene.address, tracer.scene.centre_m), (start, points.normal, points.known)
        _add_sky(scene, here, (even.start, even.rays), dome.radiance_table, room, found)
    return found


@numba.njit(**COMPILED)
def _add_sky(scene: Any, points: Any, even: Any, table: Any, room: Any, found: Any) -> None:
    address, centre = scene
    place, normal, known = without_reference_count(points)
    begin, each = without_reference_count(even)
    table, found = without_reference_count(table), without_reference_count(found)
    packets, owner, ways, whole = without_reference_count(room)
    i, ray, now = 0, 0, (0.0, 1.0, 0.0)
    # Rays of all places one after the other, so that packets are full however few rays each place has.
    while i < len(place):
        asked = 0
        while asked < PACKET and i < len(place):
            now = next_even(now) if ray else first_even(begin[i])
            by_cosine(normal[i], now, ways[asked])
            if ways[asked, 2] >= 0.0:
                owner[asked] = i
                set_ray(packets, asked, centre, place[i], ways[asked], np.inf)
                asked += 1
            i, ray = (i, ray + 1) if ray + 1 < each else (i + 1, 0)
        trace_occlusion(address, packets, asked)
        for slot in range(asked):
            one, way = owner[slot], ways[slot]
            share = -known[one] if is_ray_occluded(packets, slot) else 1.0 - known[one]
            if share != 0.0:
                sky_light(table, way[0], way[1], way[2], share * np.pi / each, whole, found[one])
