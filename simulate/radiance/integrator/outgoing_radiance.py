"""Outgoing radiance of surfaces and radiance along camera rays: direct light, sky, final gather,
panes and air.

The unoccluded sky irradiance is a control variate. A gather ray that meets nothing adds nothing, so
that a point in the open has no noise; a ray that meets an object adds the object's radiance and
subtracts the sky behind it. Where little of the sky is visible the fraction of the control variate
is low, see `ShadingPoints`.

Diffuse points gather by the compiled path tracer. Batches of NumPy gather at glossy points and
behind panes, and where light is requested by source and bounce.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.geometry.ray_tracer import NOTHING
from simulate.radiance.integrator import direct_lighting
from simulate.radiance.integrator.direct_lighting import LightSamples
from simulate.radiance.integrator.integrator_settings import LIMITS, IntegratorSettings
from simulate.radiance.integrator.path_tracer import LEAST_CHANCE, MOST_CHANCE, follow_paths
from simulate.radiance.integrator.sampling import SequenceSlice
from simulate.radiance.integrator.spectral_scene import (
    Segments,
    ShadingPoints,
    SpectralScene,
    reflect_direction,
    trace_segments,
)

Array = NDArray[np.floating]
Rows = NDArray[np.int64]
Light = NDArray[np.float32]
# Points with a cached irradiance (without lamps and discs), and that irradiance, shape (cached
# point, band).
Shared = tuple[Rows, Light]
# Cached irradiance of points, by the numbers of the rays that met them.
Sharing = Callable[[ShadingPoints, Rows], Shared]


class RadianceComponents:
    """Radiance (point, band) in components by name, or their sum if not split."""

    def __init__(self, shape: tuple[int, int], *, split: bool = False) -> None:
        self.shape, self.split = shape, split
        self.found: dict[str, Light] = {}

    def add(self, name: str, which: Rows, light: Array) -> None:
        """Add light to a component at some points, each named once."""
        if len(which):
            component = self.found.setdefault(
                name if self.split else "", np.zeros(self.shape, np.float32)
            )
            component[slice(None) if len(which) == self.shape[0] else which] += light

    def total(self) -> Light:
        """Return the sum of all components."""
        return sum(self.found.values(), start=np.zeros(self.shape, np.float32))


def bounce_order(name: str) -> tuple[int, str]:
    """Return the number of reflections of a component of `outgoing_radiance`, and its source."""
    if not name.startswith("bounce "):
        return 0, name
    order, source = name.removeprefix("bounce ").split(" of ", 1)
    return int(order), source


@dataclass(frozen=True, kw_only=True)
class ShadingRequest:
    """Points whose outgoing radiance is requested."""

    points: ShadingPoints
    parts: RadianceComponents  # that the light is added to
    rows: Rows  # row of each point there
    effort: IntegratorSettings
    rng: np.random.Generator
    rays: int  # gather rays of each point
    depth: int = 0  # bounces between the points and the surface that the camera sees
    # pairs from which directions of gather rays follow; None: drawn
    sequence: SequenceSlice | None = None

    @property
    def reflections(self) -> bool:
        """Whether indirect light (at least one reflection before the points) is included."""
        return self.depth < self.effort.max_bounces

    @property
    def slices(self) -> SequenceSlice:
        """The pairs of the gather rays, drawn where none are given."""
        return (
            SequenceSlice.random(len(self.points), self.rays, self.rng)
            if self.sequence is None
            else self.sequence
        )

    @cached_property
    def control(self) -> Light:
        """Control-variate fraction of the sky: 0 where not diffuse, 1 where sky shadowing is
        off.
        """
        diffuse = self.points.is_diffuse.astype(np.float32)
        return self.points.sky_control_fraction * diffuse if self.effort.sky_shadowing else diffuse

    def some(self, which: Rows) -> "ShadingRequest":
        """Return the request for some of the points."""
        sequence = None if self.sequence is None else self.sequence.some(which)
        return replace(
            self, points=self.points.some(which), rows=self.rows[which], sequence=sequence
        )

    def add(self, name: str, which: Rows, light: Array) -> None:
        """Add light to a component at some of the points, each named once."""
        self.parts.add(name, self.rows[which], light)

    def add_rays(self, name: str, which: Rows, light: Array) -> None:
        """Add light of some gather rays to a component; the rays of a point are consecutive."""
        if len(which):
            owner = which // self.rays
            first = np.flatnonzero(np.diff(owner, prepend=-1))
            self.parts.add(name, self.rows[owner[first]], np.add.reduceat(light, first, axis=0))


def outgoing_radiance(
    stage: SpectralScene,
    points: ShadingPoints,
    effort: IntegratorSettings,
    rng: np.random.Generator,
    *,
    rays: int,
    into: tuple[RadianceComponents, Rows] | None = None,
    split: bool = False,
    depth: int = 0,
    shared: Shared | None = None,
    sequence: SequenceSlice | None = None,
    light: Literal["all", "lamps and discs", "surroundings"] = "all",
) -> RadianceComponents:
    """Return the reflected outgoing radiance of points, in components of shape (point, band).

    Parameters
    ----------
    stage, points, effort, rng
        The scene, where, how far light is followed, and the random generator.
    rays
        Gather rays of each point.
    into
        Components to add to, and the row of each point there; new ones if None.
    split
        Whether sources and bounces are separate components: sources by name, "glow" of panels,
        "sky", "hidden sky" (the occluded part of the control variate, never positive) and "bounce 1
        of sun", "bounce 2 of sky" ... by number of reflections elsewhere and by source.
    depth
        Bounces between the points and the surface that the camera sees.
    shared
        Points with a cached irradiance, which do not gather: their component is "shared".
    sequence
        Pairs of numbers from which the directions of gather rays follow; None: drawn.
    light
        All light, that of lamps and discs alone, or all other.
    """
    parts, rows = into or (
        RadianceComponents((len(points), stage.bands), split=split),
        np.arange(len(points)),
    )
    asked = ShadingRequest(
        points=points,
        parts=parts,
        rows=rows,
        effort=effort,
        rng=rng,
        rays=rays,
        depth=depth,
        sequence=sequence,
    )
    if light != "surroundings":
        _add_direct(stage, asked)
    if light == "lamps and discs":
        return parts
    if shared is not None:
        sharing, irradiance = shared
        asked.add("shared", sharing, stage.bsdfs.diffuse_brdf(points)[sharing] * irradiance)
        asked = asked.some(np.setdiff1d(np.arange(len(points)), sharing, assume_unique=True))
    if len(asked.points):
        _add_around(stage, asked)
    return parts


def _add_direct(stage: SpectralScene, asked: ShadingRequest) -> None:
    """Add light of lamps and discs."""
    points, rng, through = asked.points, asked.rng, _air_before(stage, asked)

    def add(name: str, samples: LightSamples) -> None:
        asked.add(name, *direct_lighting.reflect(stage, points, samples, through))

    for disc in asked.effort.active_lights(stage.lighting.discs):
        add(disc.name, direct_lighting.sample_disc(points, disc, rng))
    lamps = asked.effort.active_lights(stage.lighting.lamps)
    if asked.depth > 0 and len(lamps) > LIMITS.max_sampled_lamps:
        for name, samples in direct_lighting.sample_one_lamp(points, lamps, rng):
            add(name, samples)
    else:
        for lamp in lamps:
            add(lamp.name, direct_lighting.sample_lamp(points, lamp, rng))


def _air_before(stage: SpectralScene, asked: ShadingRequest) -> direct_lighting.Through | None:
    """Return the transmittance of air between lamps and surfaces that the camera sees, if it is
    included.
    """
    return (
        stage.air.through
        if asked.effort.path_air and stage.air.absorbs and asked.depth == 0
        else None
    )


def _add_around(stage: SpectralScene, asked: ShadingRequest) -> None:
    """Add light of panels, of the sky and of other surfaces."""
    points, effort, light, bsdfs = asked.points, asked.effort, stage.lighting, stage.bsdfs
    # Glossy points need rays even for an unoccluded sky.
    gathers = effort.gathers or bool(points.glossy)
    if light.panels is not None:
        tracer, rays = stage.surfaces.tracer, asked.rays if gathers else 0
        samples = direct_lighting.sample_panels(
            points, light.panels, bsdfs, tracer, asked.rng, rays
        )
        asked.add(
            "glow", *direct_lighting.reflect(stage, points, samples, _air_before(stage, asked))
        )
    if not light.environment_map.dark:
        open_sky = bsdfs.diffuse_brdf(points) * light.environment_map.irradiance(points.normal)
        asked.parts.add("sky", asked.rows, open_sky * asked.control[:, None])
    if not gathers or stage.surfaces.tracer.scene is None:
        return
    if asked.parts.split or bsdfs.panes is not None:
        _gather(stage, asked)
        return
    if points.glossy:
        _gather(stage, asked.some(np.flatnonzero(~points.is_diffuse)))
        asked = asked.some(np.flatnonzero(points.is_diffuse))
    if len(asked.points):
        _add_paths(stage, asked)


def _beyond(
    stage: SpectralScene, asked: ShadingRequest, met_points: ShadingPoints, depth: int
) -> RadianceComponents:
    """Return the outgoing radiance of points that rays of a request meet."""
    return outgoing_radiance(
        stage, met_points, asked.effort, asked.rng, rays=1, split=asked.parts.split, depth=depth
    )


def _add_paths(stage: SpectralScene, asked: ShadingRequest) -> None:
    """Add indirect light on diffuse points by the compiled path tracer, which defers what is not
    diffuse.
    """
    points, light = asked.points, stage.lighting
    last = not asked.reflections and light.panels is None
    if last and (not asked.effort.sky_shadowing or light.environment_map.dark):
        return
    # Low-discrepancy rays of neighbouring points sample the sky well enough where only its
    # shadowing is computed.
    bright = None if asked.sequence is not None and last else stage.bright_sky
    sequence = asked.slices
    if bright is not None:
        _add_bright_sky(stage, asked)
    irradiance, back = follow_paths(
        stage,
        points,
        sequence,
        asked.effort,
        bright,
        control=asked.control,
        depth=asked.depth,
        seed=int(asked.rng.integers(1 << 63)),
    )
    for behind in np.unique(back.depth).tolist():
        these = np.flatnonzero(back.depth == behind)
        owner, at = (
            back.owner[these],
            (back.face[these], back.place_m[these], back.direction[these]),
        )
        met_points = stage.bsdfs.points(stage.surfaces, *at, points.sky_control_fraction[owner])
        np.add.at(
            irradiance,
            owner,
            _beyond(stage, asked, met_points, behind).total() * back.weight[these],
        )
    asked.parts.add("around", asked.rows, irradiance * stage.bsdfs.diffuse_brdf(points))


def _gather(stage: SpectralScene, asked: ShadingRequest) -> None:
    """Add indirect light on any surface, in batches of rays."""
    rays, bsdfs, tracer = asked.rays, stage.bsdfs, stage.surfaces.tracer
    ray_points = (
        asked.points
        if rays == 1
        else asked.points.some(np.repeat(np.arange(len(asked.points)), rays))
    )
    direction, density = bsdfs.sample(ray_points, asked.slices.pairs().reshape(-1, 2), asked.rng)
    cosine = direct_lighting.dot(ray_points.normal, direction)
    gives = (cosine > 0.0) & (density > 0.0)
    factor = np.divide(cosine, density * rays, out=np.zeros_like(cosine), where=gives).astype(
        np.float32
    )
    start = direct_lighting.ray_starts(ray_points, np.arange(len(ray_points)), tracer)
    end = trace_segments(tracer, bsdfs.panes, start, direction, asked.rng)
    # BRDF times cosine over density and number of rays.
    weight = bsdfs.value(ray_points, direction) * factor[:, None]
    if not stage.lighting.environment_map.dark:
        _add_sky(stage, asked, direction, density, weight, end)
        _add_bright_sky(stage, asked)
    met = np.flatnonzero((end.hit.face != NOTHING) & gives)
    if not len(met) or not (asked.reflections or stage.lighting.panels):
        return
    met_points = stage.points(
        end.hit, end.start_m, end.direction, met, ray_points.sky_control_fraction[met]
    )
    weight = weight[met] * end.weight[met]
    glows, glow = stage.emission(met_points)
    if stage.lighting.panels is not None and len(glows):
        ray = met[glows]
        leaving, way = (
            -direct_lighting.dot(met_points.normal[glows], end.direction[ray]),
            end.hit.range_m + end.earlier_m,
        )
        mis_weight = direct_lighting.gather_mis_weight(
            stage.lighting.panels, met_points.face[glows], way[ray], leaving, density[ray], rays
        )
        # Only gather rays sample light reflected by panes.
        mis_weight = np.where(end.mirrored[ray], 1.0, mis_weight).astype(np.float32)
        asked.add_rays("glow", ray, glow * mis_weight[:, None] * weight[glows])
    if not asked.reflections:
        return
    roulette_depth = asked.effort.roulette_depth
    if roulette_depth is not None and asked.depth >= roulette_depth:
        chance = np.clip(weight.mean(axis=1) * rays, LEAST_CHANCE, MOST_CHANCE)
        stays = np.flatnonzero(asked.rng.random(len(met)) < chance)
        met_points, met, weight = (
            met_points.some(stays),
            met[stays],
            weight[stays] / chance[stays, None],
        )
    if len(met):
        for name, light in _beyond(stage, asked, met_points, asked.depth + 1).found.items():
            order, source = bounce_order(name)
            asked.add_rays(f"bounce {order + 1} of {source}", met, light * weight)


def _add_sky(
    stage: SpectralScene,
    asked: ShadingRequest,
    direction: Array,
    density: Array,
    weight: Light,
    end: Segments,
) -> None:
    """Add the sky that gather rays meet, and subtract the occluded part of the control variate."""
    sky, bright, shadowing = (
        stage.lighting.environment_map,
        stage.bright_sky,
        asked.effort.sky_shadowing,
    )
    control, missed = np.repeat(asked.control, asked.rays), end.hit.face == NOTHING
    # Balance heuristic against `_add_bright_sky`.
    gather_density = asked.rays * density
    mis_weight = (
        np.ones(len(gather_density))
        if bright is None
        else gather_density / (gather_density + bright.density(direction))
    )
    # Behind panes the control variate does not apply to the transmitted light.
    unknown = (1.0 - control * ~(end.crossed & shadowing)) * mis_weight
    in_sky = np.flatnonzero(missed & (unknown > 0.0))
    light = weight[in_sky] * end.weight[in_sky] * sky.radiance(end.direction[in_sky])
    asked.add_rays("sky", in_sky, light * unknown[in_sky, None].astype(np.float32))
    behind = np.flatnonzero((~missed | end.crossed) & (control > 0.0)) if shadowing else in_sky[:0]
    light = weight[behind] * sky.radiance(direction[behind])
    asked.add_rays(
        "hidden sky", behind, light * (-control * mis_weight)[behind, None].astype(np.float32)
    )


def _add_bright_sky(stage: SpectralScene, asked: ShadingRequest) -> None:
    """Add the importance-sampled part of the sky, one ray from each point (balance heuristic, Veach
    1995).

    Visible and occluded directions count as for gather rays: 1 minus, or minus, the control-variate
    fraction.
    """
    bright, points, shadowing, control = (
        stage.bright_sky,
        asked.points,
        asked.effort.sky_shadowing,
        asked.control,
    )
    if bright is None:
        return
    towards = bright.draw(len(points), asked.rng)
    cosine = direct_lighting.dot(points.normal, towards)
    which = np.flatnonzero(((control < 1.0) | shadowing) & (cosine > 0.0))
    some, towards, tracer = points.some(which), towards[which], stage.surfaces.tracer
    hidden = tracer.is_occluded(direct_lighting.ray_starts(points, which, tracer), towards)
    counts = (
        1.0 - control[which] - hidden if shadowing else np.where(hidden, 0.0, 1.0 - control[which])
    )
    density = asked.rays * stage.bsdfs.density(some, towards) + bright.density(towards)
    light = stage.bsdfs.value(some, towards) * stage.lighting.environment_map.radiance(towards)
    light *= (counts * cosine[which] / density).astype(np.float32)[:, None]
    for name, these in (("sky", ~hidden), ("hidden sky", hidden)):
        asked.add(name, which[these], light[these])


def radiance_along(
    stage: SpectralScene,
    origin: Array,
    towards: Array,
    effort: IntegratorSettings,
    rng: np.random.Generator,
    *,
    gather_rays: int,
    sky_control_fraction: Light | None = None,
    split: bool = False,
    cached_irradiance: Sharing | None = None,
    splits: int = LIMITS.max_pane_splits,
) -> RadianceComponents:
    """Return the radiance along rays of unit direction (ray, 3), in components as of
    `outgoing_radiance`.

    Apart from the sources, components are "in view" (sky and emission that the ray meets) and "air"
    (path radiance less the light that air removes from all other components). `cached_irradiance`
    gives the cached irradiance of points by ray number. Rays that meet a pane continue both
    transmitted and reflected; after a few panes (`splits`) one of both at random.
    """
    parts, airy = RadianceComponents((len(towards), stage.bands), split=split), stage.air.absorbs
    airy &= "air" not in effort.neglected
    panes = stage.bsdfs.panes
    if panes is not None and splits:
        glass = panes.met(origin, towards, stage.surfaces.tracer.hits(origin, towards).range_m)
        open_ = np.setdiff1d(np.arange(len(towards)), glass.which)
        ahead = towards[glass.which]
        for which, start, ways, pane_fraction, is_transmitted in (
            (open_, origin[open_], towards[open_], np.float32(1.0), True),
            (glass.which, panes.start(glass), ahead, glass.through, True),
            (
                glass.which,
                panes.start(glass, True),
                reflect_direction(ahead, glass.normal),
                glass.mirrored,
                False,
            ),
        ):
            if not len(which):
                continue
            onwards = radiance_along(
                stage,
                start,
                ways,
                effort,
                rng,
                gather_rays=gather_rays,
                sky_control_fraction=None
                if sky_control_fraction is None
                else sky_control_fraction[which],
                split=split,
                cached_irradiance=_of_some(cached_irradiance, which) if is_transmitted else None,
                splits=0 if which is open_ else splits - 1,
            )
            for name, light in onwards.found.items():
                parts.add(name, which, light * pane_fraction)
        if airy:
            _through_air(stage, parts, glass.range_m, ahead, glass.which)
        return parts
    end = trace_segments(stage.surfaces.tracer, stage.bsdfs.panes, origin, towards, rng)
    met, in_sky = end.hit.met, np.flatnonzero(end.hit.face == NOTHING)
    parts.add("in view", in_sky, stage.lighting.environment_map.radiance(end.direction[in_sky]))
    control = None if sky_control_fraction is None else sky_control_fraction[met]
    points = stage.points(end.hit, end.start_m, end.direction, met, control)
    glows, glow = stage.emission(points)
    parts.add("in view", met[glows], glow)
    shared = None
    if cached_irradiance is not None:
        which, irradiance = cached_irradiance(points, met)
        is_transmitted = ~end.mirrored[met[which]]
        shared = which[is_transmitted], irradiance[is_transmitted]
    outgoing_radiance(
        stage, points, effort, rng, rays=gather_rays, into=(parts, met), shared=shared
    )
    if airy:
        _through_air(stage, parts, end.hit.range_m[met], end.direction[met], met)
    crossed = np.flatnonzero(end.crossed)
    for light in parts.found.values():
        light[crossed] *= end.weight[crossed]
    if airy:
        _through_air(stage, parts, end.earlier_m[crossed], towards[crossed], crossed)
    return parts


def _of_some(cached_irradiance: Sharing | None, which: Rows) -> Sharing | None:
    """Restrict a cache look-up to some of the rays."""
    return (
        None
        if cached_irradiance is None
        else lambda points, numbers: cached_irradiance(points, which[numbers])
    )


def _through_air(
    stage: SpectralScene, parts: RadianceComponents, range_m: Array, towards: Array, met: Rows
) -> None:
    """Add the path radiance of air, and subtract the light that it removes from all other
    components.
    """
    parts.add("air", met, stage.air.change_of(parts.total()[met], range_m, towards))
