"""Outgoing radiance of surfaces and radiance along camera rays: direct light, sky, final gather, panes and air."""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.geometry.ray_tracer import NOTHING
from simulate.radiance.integrator import direct_lighting
from simulate.radiance.integrator.final_gather import add_by_batches, add_by_paths
from simulate.radiance.integrator.integrator_settings import LIMITS, IntegratorSettings
from simulate.radiance.integrator.low_discrepancy import SequenceSlice
from simulate.radiance.integrator.panes import Met, Panes, choose_mirror_rays, reflect_direction
from simulate.radiance.integrator.shading_points import ShadingPoints
from simulate.radiance.integrator.shading_request import RadianceComponents, ShadingRequest
from simulate.radiance.integrator.spectral_scene import SpectralScene

# Points with a cached irradiance (without lamps and discs), and that irradiance, shape (cached point, band).
Shared = tuple[NDArray[np.int64], NDArray[np.float32]]


def outgoing_radiance(
    stage: SpectralScene,
    points: ShadingPoints,
    effort: IntegratorSettings,
    rng: np.random.Generator,
    *,
    rays: int,
    into: tuple[RadianceComponents, NDArray[np.int64]] | None = None,
    split: bool = False,
    depth: int = 0,
    shared: Shared | None = None,
) -> RadianceComponents:
    """Return the reflected outgoing radiance of points, in components of shape (point, band).

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
        Gather rays of each point.
    into
        Components to add to, and the row of each point there; new ones if None.
    split
        Whether sources and bounces are separate components: sources by name, "glow" of panels, "sky", "hidden sky"
        (the occluded part of the control variate, never positive) and "bounce 1 of sun", "bounce 2 of sky" ... by
        number of reflections elsewhere and by source.
    depth
        Bounces between the points and the surface that the camera sees.
    shared
        Points with a cached irradiance, which do not gather: their component is "shared".
    """
    parts, rows = into or _new(stage, points, split)
    asked = ShadingRequest(points=points, parts=parts, rows=rows, effort=effort, rng=rng, rays=rays, depth=depth)
    _add_direct(stage, asked)
    if shared is not None:
        sharing, irradiance = shared
        asked.add("shared", sharing, stage.bsdfs.diffuse_brdf(points)[sharing] * irradiance)
        asked = asked.some(np.setdiff1d(np.arange(len(points)), sharing, assume_unique=True))
    if len(asked.points):
        _add_around(stage, asked)
    return parts


def lamp_and_disc_radiance(
    stage: SpectralScene, points: ShadingPoints, effort: IntegratorSettings, rng: np.random.Generator
) -> RadianceComponents:
    """Return the outgoing radiance by lamps and discs alone, as `outgoing_radiance`."""
    parts, rows = _new(stage, points)
    _add_direct(stage, ShadingRequest(points=points, parts=parts, rows=rows, effort=effort, rng=rng, rays=0))
    return parts


def surroundings_radiance(
    stage: SpectralScene,
    points: ShadingPoints,
    effort: IntegratorSettings,
    rng: np.random.Generator,
    *,
    rays: int,
    even: SequenceSlice | None = None,
) -> RadianceComponents:
    """Return the outgoing radiance by all light but lamps and discs, as `outgoing_radiance`.

    Parameters
    ----------
    stage, points, effort, rng, rays
        As of `outgoing_radiance`.
    even
        Two quasi-random numbers for each ray, from which directions follow; None: drawn.
    """
    parts, rows = _new(stage, points)
    _add_around(
        stage, ShadingRequest(points=points, parts=parts, rows=rows, effort=effort, rng=rng, rays=rays, even=even)
    )
    return parts


def _new(
    stage: SpectralScene, points: ShadingPoints, split: bool = False
) -> tuple[RadianceComponents, NDArray[np.int64]]:
    return RadianceComponents((len(points), stage.bands), split=split), np.arange(len(points))


def _add_direct(stage: SpectralScene, asked: ShadingRequest) -> None:
    """Add light of lamps and discs."""
    points, rng, reflect = asked.points, asked.rng, (stage.bsdfs, stage.surfaces.tracer)
    through = _between(stage, asked)
    for disc in asked.effort.active_lights(stage.lighting.discs):
        asked.add(disc.name, *direct_lighting.from_disc(points, disc, *reflect, rng))
    lamps = asked.effort.active_lights(stage.lighting.lamps)
    if asked.depth > 0 and len(lamps) > LIMITS.max_sampled_lamps:
        for name, found in direct_lighting.from_one_lamp(points, lamps, *reflect, rng, through):
            asked.add(name, *found)
    else:
        for lamp in lamps:
            asked.add(lamp.name, *direct_lighting.from_lamp(points, lamp, *reflect, rng, through))


def _between(stage: SpectralScene, asked: ShadingRequest) -> direct_lighting.Through | None:
    """Return the transmittance of air between lamps and surfaces that the camera sees, if it is included."""
    return stage.air.through if asked.effort.path_air and stage.air.absorbs and asked.depth == 0 else None


def _add_around(stage: SpectralScene, asked: ShadingRequest) -> None:
    """Add light of panels, of the sky and of other surfaces."""
    points, effort, light, bsdfs = asked.points, asked.effort, stage.lighting, stage.bsdfs
    # Glossy points need rays even for an unoccluded sky.
    gathers = effort.gathers or bool(points.glossy)
    if light.panels is not None:
        through, sharing = _between(stage, asked), asked.rays if gathers else 0
        tracer = stage.surfaces.tracer
        asked.add(
            "glow", *direct_lighting.from_panels(points, light.panels, bsdfs, tracer, asked.rng, through, sharing)
        )
    if not light.environment_map.dark:
        open_sky = bsdfs.diffuse_brdf(points)
        open_sky *= light.environment_map.irradiance(points.normal)
        if effort.sky_shadowing:
            open_sky *= points.sky_control_fraction[:, None]
        asked.parts.add("sky", asked.rows, open_sky)
    if not gathers or stage.surfaces.tracer.scene is None:
        return

    def further(there: ShadingPoints, depth: int) -> RadianceComponents:
        return outgoing_radiance(stage, there, effort, asked.rng, rays=1, split=asked.parts.split, depth=depth)

    if asked.parts.split or bsdfs.panes is not None:
        add_by_batches(stage, asked, further)
        return
    if points.glossy:
        add_by_batches(stage, asked.some(np.flatnonzero(~points.is_diffuse)), further)
        asked = asked.some(np.flatnonzero(points.is_diffuse))
    if len(asked.points):
        add_by_paths(stage, asked, further)


Array = NDArray[np.floating]
# Cached irradiance of points, by the numbers of the rays that met them.
Sharing = Callable[[ShadingPoints, NDArray[np.int64]], Shared]


def radiance_along(
    stage: SpectralScene,
    origin: Array,
    towards: Array,
    effort: IntegratorSettings,
    rng: np.random.Generator,
    *,
    gather_rays: int,
    sky_control_fraction: NDArray[np.float32] | None = None,
    split: bool = False,
    share: Sharing | None = None,
    behind: int = 0,
) -> RadianceComponents:
    """Return the radiance along rays of unit direction (ray, 3), in components as of `outgoing_radiance`.

    Apart from the sources, components are "in view" (sky and emission that the ray meets) and "air" (path radiance less
    the light that air removes from all other components). `share` gives the cached irradiance of points by ray number.
    Rays that meet a pane continue both transmitted and reflected; after a few panes (`behind`) one of both at random.
    """
    hit = stage.surfaces.tracer.hits(origin, towards)
    parts = RadianceComponents((len(towards), stage.bands), split=split)
    here = np.ones(len(towards), np.bool_)
    if stage.bsdfs.panes is not None:
        glass = stage.bsdfs.panes.met(origin, towards, hit.range_m)
        here[glass.which] = False
        for which, start, ways, left, straight in _ways_on(stage.bsdfs.panes, glass, towards, behind, rng):
            seen = None if sky_control_fraction is None else sky_control_fraction[which]
            sharing = _of_some(share, which) if straight else None
            onwards = radiance_along(
                stage, start, ways, effort, rng,
                gather_rays=gather_rays, sky_control_fraction=seen, split=split, share=sharing, behind=behind + 1,
            )  # fmt: skip
            for name, light in onwards.found.items():
                parts.add(name, which, light * left)
        if stage.air.absorbs and "air" not in effort.neglected:
            _through_air(stage, parts, glass.range_m, towards[glass.which], glass.which)
    met = np.flatnonzero(here & (hit.face != NOTHING))
    away = np.flatnonzero(here & (hit.face == NOTHING))
    parts.add("in view", away, stage.lighting.environment_map.radiance(towards[away]))
    points = stage.points(
        hit, origin, towards, met, None if sky_control_fraction is None else sky_control_fraction[met]
    )
    glows, glow = stage.emission(points)
    parts.add("in view", met[glows], glow)
    shared = None if share is None else share(points, met)
    outgoing_radiance(stage, points, effort, rng, rays=gather_rays, into=(parts, met), shared=shared)
    if stage.air.absorbs and "air" not in effort.neglected:
        _through_air(stage, parts, hit.range_m[met], towards[met], met)
    return parts


def _of_some(share: Sharing | None, which: NDArray[np.int64]) -> Sharing | None:
    """Restrict a cache look-up to some of the rays."""
    return None if share is None else lambda points, numbers: share(points, which[numbers])


def _ways_on(
    panes: Panes, glass: Met, towards: Array, behind: int, rng: np.random.Generator
) -> Iterator[tuple[NDArray[np.int64], Array, Array, NDArray[np.float32], bool]]:
    """Yield continuations at panes: ray numbers, starts, directions, fractions of light, and whether transmitted."""
    if not len(glass.which) or behind >= LIMITS.max_panes:
        return
    ahead = towards[glass.which]
    by_chance = choose_mirror_rays(glass, rng) if behind >= LIMITS.max_pane_splits else None
    for turns, start, ways, left in (
        (False, panes.beyond(glass), ahead, glass.through),
        (True, panes.before(glass), reflect_direction(ahead, glass.normal), glass.mirrored),
    ):
        rows = np.arange(len(ahead)) if by_chance is None else np.flatnonzero(by_chance[0] == turns)
        if len(rows):
            share = left[rows] if by_chance is None else by_chance[1][rows]
            yield glass.which[rows], start[rows], ways[rows], share, not turns


def _through_air(
    stage: SpectralScene, parts: RadianceComponents, range_m: Array, towards: Array, met: NDArray[np.int64]
) -> None:
    """Add the path radiance of air, and subtract the light that it removes from all other components."""
    parts.add("air", met, stage.air.change_of(parts.total()[met], range_m, towards))
