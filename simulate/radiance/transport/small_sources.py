"""Lamps, sun and moon in the picture: too small for rays to meet, they are laid on the pixels that they cover."""

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.transport import direct
from simulate.radiance.transport.gather import Stage
from simulate.radiance.world.viewpoint import Viewpoint

# Places of each source that are looked at; its light is shared evenly among them.
PLACES = 1024


def add_small_sources(stage: Stage, view: Viewpoint, radiance: NDArray[np.float32], left_out: frozenset[str]) -> None:
    """Add what the camera sees of lamps, sun and moon to the radiance of pixels, shape (pixel, band).

    A scanner sees them from where it begins.

    Notes
    -----
    A source of irradiance E at the lens adds E / solid angle of the pixel, shared by the places of its disc.
    """
    rng = np.random.default_rng(0)
    eye = np.asarray(view.position_m, float)
    for disc in stage.lighting.discs:
        towards = direct.towards_disc(disc, PLACES, rng)
        clear = ~stage.surfaces.tracer.blocked(np.broadcast_to(eye, towards.shape), towards)
        _lay(view, radiance, towards[clear], disc.irradiance / np.float32(PLACES))
    for lamp in stage.lighting.lamps:
        if lamp.name in left_out:
            continue
        middle = lamp.position_m - eye
        distance = float(np.linalg.norm(middle))
        frame = direct.frames((middle / distance)[None])[0]
        radius, turn = lamp.radius_m * np.sqrt(rng.random(PLACES)), 2.0 * np.pi * rng.random(PLACES)
        way = middle + radius[:, None] * (np.cos(turn)[:, None] * frame[0] + np.sin(turn)[:, None] * frame[1])
        clear = ~stage.surfaces.tracer.blocked(np.broadcast_to(eye, way.shape), way, direct.SHORT)
        irradiance = lamp.spectrum * np.float32(lamp.pattern(-frame[2:])[0] / distance**2)
        if stage.air.absorbs:
            irradiance = irradiance * stage.air.through(np.array([distance]))[0]
        unit = way[clear] / np.linalg.norm(way[clear], axis=1, keepdims=True)
        _lay(view, radiance, unit, irradiance / np.float32(PLACES))


def _lay(
    view: Viewpoint, radiance: NDArray[np.float32], towards: NDArray[np.floating], share: NDArray[np.float32]
) -> None:
    row, col, inside = view.places(towards)
    row, col = np.floor(row[inside]).astype(np.int64), np.floor(col[inside]).astype(np.int64)
    pixel, times = np.unique(row * view.shape[1] + col, return_counts=True)
    if len(pixel):
        size_sr = view.solid_angle_sr(pixel // view.shape[1] + 0.5, pixel % view.shape[1] + 0.5)
        radiance[pixel] += (times / size_sr).astype(np.float32)[:, None] * share
