"""What matt places get of the sky where of all that stands around only its shadow counts: in half the time of paths."""

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from simulate.radiance.embree import COMPILED, PACKET, aim, new_packets, stop, stopped
from simulate.radiance.trace import Tracer
from simulate.radiance.transport.compiled_lights import sky_light
from simulate.radiance.transport.dome import Dome
from simulate.radiance.transport.even import Even
from simulate.radiance.transport.lanes import by_cosine, first_even, next_even
from simulate.radiance.transport.points import Points
from simulate.radiance.uncounted import uncounted


def sky_beyond_known(points: Points, even: Even, dome: Dome, tracer: Tracer) -> NDArray[np.float32]:
    """Return the irradiance that rays add to the part of the sky that is taken as known, shape (point, band).

    Parameters
    ----------
    points
        Places, whose `known` says how much of the sky counts already.
    even
        Two numbers for each ray of each point: directions follow by the cosine law.
    dome, tracer
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
    place, normal, known = uncounted(points)
    begin, each = uncounted(even)
    table, found = uncounted(table), uncounted(found)
    packets, owner, ways, whole = uncounted(room)
    i, ray, now = 0, 0, (0.0, 1.0, 0.0)
    # Rays of all places one after the other, so that packets are full however few rays each place has.
    while i < len(place):
        asked = 0
        while asked < PACKET and i < len(place):
            now = next_even(now) if ray else first_even(begin[i])
            by_cosine(normal[i], now, ways[asked])
            if ways[asked, 2] >= 0.0:
                owner[asked] = i
                aim(packets, asked, centre, place[i], ways[asked], np.inf)
                asked += 1
            i, ray = (i, ray + 1) if ray + 1 < each else (i + 1, 0)
        stop(address, packets, asked)
        for slot in range(asked):
            one, way = owner[slot], ways[slot]
            share = -known[one] if stopped(packets, slot) else 1.0 - known[one]
            if share != 0.0:
                sky_light(table, way[0], way[1], way[2], share * np.pi / each, whole, found[one])
