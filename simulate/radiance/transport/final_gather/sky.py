"""The sky that rays of gathering meet or miss, shared with rays that look for its bright parts by name."""

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.transport import direct_lighting
from simulate.radiance.transport.final_gather.hemisphere_rays import Around
from simulate.radiance.transport.shading_request import ShadingRequest
from simulate.radiance.transport.spectral_scene import SpectralScene


def add_sky(stage: SpectralScene, asked: ShadingRequest, around: Around) -> None:
    """Add the sky that gathering meets, and take what objects hide of the sky that is known."""
    dome, hidden_sky, known = (
        stage.lighting.environment_map,
        asked.effort.hidden_sky,
        np.repeat(asked.known, asked.rays),
    )
    # Where panes are in the way, nothing is known of what comes by them, but all of the sky behind.
    unknown = np.float32(1.0) - known * ~(around.has_pane_hits & hidden_sky)
    seen = np.flatnonzero(around.open & (unknown > 0.0))
    light = around.weight(stage.bsdfs, seen)
    light *= dome.radiance(around.last_direction[seen])
    light *= (unknown[seen] * _share(stage, asked, around, seen))[:, None]
    around.weaken(seen, light)
    asked.add_found("sky", seen, light)
    hides = (~around.open | around.has_pane_hits) & (around.factor > 0.0)
    behind = np.flatnonzero(hides & (known > 0.0)) if hidden_sky else around.met[:0]
    light = around.weight(stage.bsdfs, behind)
    light *= dome.radiance(around.direction[behind])
    light *= (-known[behind] * _share(stage, asked, around, behind))[:, None]
    asked.add_found("hidden sky", behind, light)


def _share(
    stage: SpectralScene, asked: ShadingRequest, around: Around, which: NDArray[np.int64]
) -> NDArray[np.float32]:
    """What gathering finds of the sky in its own directions, beside `add_bright_sky`, shape (ray,)."""
    bright = stage.bright_sky
    if bright is None:
        return np.ones(len(which), np.float32)
    own = asked.rays * around.density[which]
    return (own / (own + bright.density(around.direction[which]))).astype(np.float32)


def add_bright_sky(stage: SpectralScene, asked: ShadingRequest) -> None:
    """Add the share of the sky that is looked for by name, one ray from each point (balance heuristic, Veach 1995).

    What gathering counts of a free or a hidden direction counts here too: the unknown, or less the known.
    """
    bright, points, hidden_sky, known = stage.bright_sky, asked.points, asked.effort.hidden_sky, asked.known
    if bright is None:
        return
    asks = (known < 1.0) | hidden_sky
    towards = bright.draw(len(points), asked.rng)
    cosine = np.einsum("ij,ij->i", points.normal, towards)
    which = np.flatnonzero(asks & (cosine > 0.0))
    some, towards = points.some(which), towards[which]
    hidden = direct_lighting.is_occluded(points, which, towards, stage.surfaces.tracer, None)
    counts = (1.0 - known[which] - hidden) if hidden_sky else np.where(hidden, 0.0, 1.0 - known[which])
    density = asked.rays * stage.bsdfs.density(some, towards) + bright.density(towards)
    light = stage.bsdfs.value(some, towards)
    light *= (counts * cosine[which] / density).astype(np.float32)[:, None]
    light *= stage.lighting.environment_map.radiance(towards)
    for name, these in (("sky", ~hidden), ("hidden sky", hidden)):
        asked.add(name, which[these], light[these])
