"""What matt places get of the sky where of all that stands around only its shadow counts: in half the time of paths."""

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from simulate.radiance.embree import COMPILED, DIRECTION, PACKET, REACH, aim, new_packet, stop
from simulate.radiance.trace import Tracer
from simulate.radiance.transport.compiled_lights import sky_light
from simulate.radiance.transport.dome import Dome
from simulate.radiance.transport.even import R2, Even
from simulate.radiance.transport.points import Points


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
    found = np.zeros((len(points), dome.radiance_table.shape[2]), np.float32)
    if tracer.scene is not None:
        start = tracer.above(points.face, points.place_m, points.normal)
        scene, rays = (tracer.scene.address, tracer.scene.centre_m), (even.start, even.rays, R2)
        _add_sky(*scene, start, points.normal, points.known, *rays, dome.radiance_table, found)
    return found


@numba.njit(**COMPILED)
def _add_sky(
    scene: Any,
    centre: Any,
    place: Any,
    normal: Any,
    known: Any,
    start: Any,
    rays: int,
    step: Any,
    table: Any,
    found: Any,
) -> None:
    packet, counts = new_packet()
    whole = np.ones(found.shape[1], np.float32)
    way, total = np.zeros(3), len(place) * rays
    step_x, step_y = np.cos(2.0 * np.pi * step[1]), np.sin(2.0 * np.pi * step[1])
    square, along, across = 0.0, 1.0, 0.0
    # Rays of all places one after the other, so that packets are full however few rays each place has.
    for first in range(0, total, PACKET):
        many = min(PACKET, total - first)
        counts[:] = 0
        for lane in range(many):
            i = (first + lane) // rays
            if (first + lane) % rays == 0:
                square, turn = start[i, 0], 2.0 * np.pi * start[i, 1]
                along, across = np.cos(turn), np.sin(turn)
            x, y, z = normal[i, 0], normal[i, 1], normal[i, 2]
            # The frame of `points.frames`.
            sign = 1.0 if z >= 0.0 else -1.0
            a = -1.0 / (sign + z)
            b = x * y * a
            radius, w = np.sqrt(square), np.sqrt(1.0 - square)
            u, v = radius * along, radius * across
            # From ray to ray the turn about the normal grows by as much: no sine is computed anew.
            square = (square + step[0]) % 1.0
            along, across = along * step_x - across * step_y, along * step_y + across * step_x
            way[0] = u * (1.0 + sign * x * x * a) + v * b + w * x
            way[1] = u * sign * b + v * (sign + y * y * a) + w * y
            way[2] = -u * sign * x - v * y + w * z
            if way[2] >= 0.0:
                aim(packet, counts, lane, centre, place[i], way, np.inf)
        stop(scene, packet, counts)
        for lane in range(many):
            i = (first + lane) // rays
            share = -known[i] if packet[REACH, lane] < 0.0 else 1.0 - known[i]
            if counts[lane] != 0 and share != 0.0:
                for axis in range(3):
                    way[axis] = packet[DIRECTION + axis, lane]
                sky_light(table, way[0], way[1], way[2], share * np.pi / rays, whole, found[i])
