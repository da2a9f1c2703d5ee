"""How much of the sky is open before what pixels show: so much of its light is taken as known."""

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.outdoor.viewpoint import Viewpoint
from simulate.radiance.transport.spectral_scene import SpectralScene
from simulate.radiance.transport.tiles import Tiles

# Side of a tile, px; pixels of each by which it is tried how open the sky is, and rays of each of these.
TILE, TRIED, TRIES = 4, 2, 4


def sky_control_fraction(stage: SpectralScene, view: Viewpoint, seed: int) -> NDArray[np.float32]:
    """Return the share of the hemisphere that is open before what pixels show, on average over a tile, (row, col).

    Tried by a few places of each tile, with random numbers of their own.
    """
    rng = np.random.default_rng([seed, 1])
    tiles, columns, tracer = Tiles.of(view.shape, TILE), view.shape[1], stage.surfaces.tracer
    pixel = tiles.some_pixels(TRIED, rng)
    jitter = rng.random((2, len(pixel)))
    origin, towards = view.rays(pixel // columns + jitter[0], pixel % columns + jitter[1])
    hit = tracer.hits(origin, towards)
    met = hit.met
    points = stage.points(hit, origin, towards, met)
    hidden = np.zeros(len(pixel))
    for _ in range(TRIES):
        direction, _ = stage.bsdfs.drawn(points, rng.random((len(met), 2)), rng)
        start = tracer.above(points.face, points.place_m, points.normal)
        hidden[met] += tracer.is_occluded(start, direction) / TRIES
    share = hidden.reshape(*tiles.count, TRIED).mean(axis=-1)
    down, across = tiles.of_pixels
    return (1.0 - share)[down, across].astype(np.float32)
