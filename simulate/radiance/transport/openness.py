"""What matt places get of the sky where of all that stands around only its shadow counts: compiled."""

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from simulate.radiance.embree import COMPILED, new_ray, stopped
from simulate.radiance.trace import Tracer
from simulate.radiance.transport.dome import Dome
from simulate.radiance.transport.points import Points

Array = NDArray[np.floating]


def sky_beyond_known(points: Points, even: Array, dome: Dome, tracer: Tracer) -> NDArray[np.float32]:
    """Return the irradiance that rays add to the part of the sky that is taken as known, shape (point, band).

    Parameters
    ----------
    points
        Places, whose `known` says how much of the sky counts already.
    even
        Two numbers in [0, 1) for each ray, shape (point, ray, 2): directions follow by the cosine law.
    dome, tracer
        The sky, and what may hide it.

    Notes
    -----
    pi/rays times the sum of (1 - known) L where a ray is free and of -known L where it is not.
    """
    found = np.zeros((len(points), dome.radiance_table.shape[2]), np.float32)
    if tracer.scene is not None:
        start = tracer.above(points.face, points.place_m, points.normal)
        scene = (tracer.scene.address, tracer.scene.centre_m)
        _add_sky(*scene, start, points.normal, points.known, even, dome.radiance_table, found)
    return found


@numba.njit(**COMPILED)
def _add_sky(scene: Any, centre: Any, start: Any, normal: Any, known: Any, even: Any, table: Any, found: Any) -> None:
    rows, columns, bands = table.shape
    rays = even.shape[1]
    ray, way = new_ray(), np.zeros(3)
    for i in range(len(start)):
        x, y, z = normal[i, 0], normal[i, 1], normal[i, 2]
        # The frame of `points.frames`.
        sign = 1.0 if z >= 0.0 else -1.0
        a = -1.0 / (sign + z)
        b = x * y * a
        for k in range(rays):
            radius, turn = np.sqrt(even[i, k, 0]), 2.0 * np.pi * even[i, k, 1]
            u, v, w = radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1.0 - even[i, k, 0])
            way[0] = u * (1.0 + sign * x * x * a) + v * b + w * x
            way[1] = u * sign * b + v * (sign + y * y * a) + w * y
            way[2] = -u * sign * x - v * y + w * z
            if way[2] < 0.0:
                continue
            hidden = stopped(scene, ray, centre, start[i], way)
            share = -known[i] if hidden else 1.0 - known[i]
            if share == 0.0:
                continue
            row = np.arcsin(min(way[2], 1.0)) / (0.5 * np.pi) * (rows - 1)
            col = np.arctan2(way[1], way[0]) / (2.0 * np.pi)
            col = (col - np.floor(col)) * (columns - 1)
            top, left = min(int(row), rows - 2), min(int(col), columns - 2)
            below, right = row - top, col - left
            share *= np.pi / rays
            for band in range(bands):
                upper = table[top, left, band] * (1.0 - right) + table[top, left + 1, band] * right
                lower = table[top + 1, left, band] * (1.0 - right) + table[top + 1, left + 1, band] * right
                found[i, band] += share * (upper * (1.0 - below) + lower * below)
