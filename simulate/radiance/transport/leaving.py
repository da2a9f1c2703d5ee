"""The radiance that leaves surfaces: direct light, the open sky, and what is gathered of the hemisphere around."""

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.transport import direct
from simulate.radiance.transport.asked import Asked
from simulate.radiance.transport.effort import ASKED_LAMPS, Effort
from simulate.radiance.transport.even import Even
from simulate.radiance.transport.gather.any_surface import add_by_batches
from simulate.radiance.transport.gather.matt import add_by_paths
from simulate.radiance.transport.parts import Parts
from simulate.radiance.transport.points import Points
from simulate.radiance.transport.stage import Stage

# Points whose irradiance by all but lamps and discs is known, and what it is, shape (sharing point, band).
Shared = tuple[NDArray[np.int64], NDArray[np.float32]]


def leaving(
    stage: Stage,
    points: Points,
    effort: Effort,
    rng: np.random.Generator,
    *,
    rays: int,
    into: tuple[Parts, NDArray[np.int64]] | None = None,
    split: bool = False,
    depth: int = 0,
    shared: Shared | None = None,
) -> Parts:
    """Return the radiance that points send to the eye by reflection, in parts of shape (point, band).

    Parameters
    ----------
    stage
        The scene.
    points
        Where.
    effort
        How far light is followed.
    rng
        Source of chance.
    rays
        Rays by which each point gathers.
    into
        Parts to add to, and the place there of each point; new ones if None.
    split
        Whether sources and bounces are kept apart: parts are sources by name, "glow" of panels, "sky", "hidden sky"
        (what objects take of it, never positive) and "bounce 1 of sun", "bounce 2 of sky" ... by number of
        reflections elsewhere and by source.
    depth
        Bounces between the points and the surface that the eye sees.
    shared
        Points that gather nothing, because it is known: their part is "shared".
    """
    parts, rows = into or _new(stage, points, split)
    asked = Asked(points=points, parts=parts, rows=rows, effort=effort, rng=rng, rays=rays, depth=depth)
    _add_direct(stage, asked)
    if shared is not None:
        sharing, irradiance = shared
        asked.add("shared", sharing, stage.coats.matt(points)[sharing] * irradiance)
        asked = asked.some(np.setdiff1d(np.arange(len(points)), sharing, assume_unique=True))
    if len(asked.points):
        _add_around(stage, asked)
    return parts


def lit(stage: Stage, points: Points, effort: Effort, rng: np.random.Generator) -> Parts:
    """Return what points send to the eye of lamps and discs alone, as `leaving`."""
    parts, rows = _new(stage, points)
    _add_direct(stage, Asked(points=points, parts=parts, rows=rows, effort=effort, rng=rng, rays=0))
    return parts


def around(
    stage: Stage, points: Points, effort: Effort, rng: np.random.Generator, *, rays: int, even: Even | None = None
) -> Parts:
    """Return what points send to the eye of all but lamps and discs, as `leaving`.

    Parameters
    ----------
    stage, points, effort, rng, rays
        As of `leaving`.
    even
        Two even numbers for each ray, from which directions follow; None: drawn.
    """
    parts, rows = _new(stage, points)
    _add_around(stage, Asked(points=points, parts=parts, rows=rows, effort=effort, rng=rng, rays=rays, even=even))
    return parts


def _new(stage: Stage, points: Points, split: bool = False) -> tuple[Parts, NDArray[np.int64]]:
    return Parts((len(points), stage.bands), split=split), np.arange(len(points))


def _add_direct(stage: Stage, asked: Asked) -> None:
    """Add light of lamps and discs."""
    points, rng, reflect = asked.points, asked.rng, (stage.coats, stage.surfaces.tracer)
    through = _between(stage, asked)
    for disc in asked.effort.kept(stage.lighting.discs):
        asked.add(disc.name, *direct.from_disc(points, disc, *reflect, rng))
    lamps = asked.effort.kept(stage.lighting.lamps)
    if asked.depth > 0 and len(lamps) > ASKED_LAMPS:
        for name, found in direct.from_one_lamp(points, lamps, *reflect, rng, through):
            asked.add(name, *found)
    else:
        for lamp in lamps:
            asked.add(lamp.name, *direct.from_lamp(points, lamp, *reflect, rng, through))


def _between(stage: Stage, asked: Asked) -> direct.Through | None:
    """What air takes between lamps and surfaces that the eye sees."""
    return stage.air.through if asked.effort.air_between and stage.air.absorbs and asked.depth == 0 else None


def _add_around(stage: Stage, asked: Asked) -> None:
    """Add light of panels, of the sky and of what stands around."""
    points, effort, light, coats = asked.points, asked.effort, stage.lighting, stage.coats
    # A gloss needs rays to find even the open sky.
    gathers = effort.gathers or bool(points.glossy)
    if light.panels is not None:
        through, sharing = _between(stage, asked), asked.rays if gathers else 0
        tracer = stage.surfaces.tracer
        asked.add("glow", *direct.from_panels(points, light.panels, coats, tracer, asked.rng, through, sharing))
    if not light.dome.dark:
        open_sky = coats.matt(points)
        open_sky *= light.dome.irradiance(points.normal)
        if effort.hidden_sky:
            open_sky *= points.known[:, None]
        asked.parts.add("sky", asked.rows, open_sky)
    if not gathers or stage.surfaces.tracer.scene is None:
        return

    def further(there: Points, depth: int) -> Parts:
        return leaving(stage, there, effort, asked.rng, rays=1, split=asked.parts.split, depth=depth)

    if asked.parts.split or coats.panes is not None:
        add_by_batches(stage, asked, further)
        return
    if points.glossy:
        add_by_batches(stage, asked.some(np.flatnonzero(~points.matt)), further)
        asked = asked.some(np.flatnonzero(points.matt))
    if len(asked.points):
        add_by_paths(stage, asked, further)
