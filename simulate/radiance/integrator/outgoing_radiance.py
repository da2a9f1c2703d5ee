"""Outgoing radiance of surfaces: direct light, sky, final gather, panes and air.

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

from simulate.arrays import Array, Array32, Index
from simulate.radiance.geometry.ray_tracer import NOTHING
from simulate.radiance.integrator import direct_lighting
from simulate.radiance.integrator.direct_lighting import LightSamples
from simulate.radiance.integrator.integrator_settings import LIMITS, IntegratorSettings
from simulate.radiance.integrator.path_tracer import MAX_SURVIVAL, MIN_SURVIVAL, follow_paths
from simulate.radiance.integrator.sampling import SequenceSlice
from simulate.radiance.integrator.spectral_scene import (
    Segments,
    ShadingPoints,
    SpectralScene,
    trace_segments,
)

# Points with a cached irradiance (without lamps and discs), and that irradiance, shape (cached
# point, band).
CachedIrradiance = tuple[Index, Array32]
# Cached irradiance of points, by the numbers of the rays that met them.
CacheLookup = Callable[[ShadingPoints, Index], CachedIrradiance]


class RadianceComponents:
    """Radiance (point, band) in components by name, or their sum if not split."""

    def __init__(self, shape: tuple[int, int], *, split: bool = False) -> None:
        self.shape, self.split = shape, split
        self.by_name: dict[str, Array32] = {}

    def add(self, name: str, rows: Index, light: Array) -> None:
        """Add light to a component at some points, each named once."""
        if len(rows):
            component = self.by_name.setdefault(
                name if self.split else "", np.zeros(self.shape, np.float32)
            )
            component[slice(None) if len(rows) == self.shape[0] else rows] += light

    def total(self) -> Array32:
        """Return the sum of all components."""
        return sum(self.by_name.values(), start=np.zeros(self.shape, np.float32))


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
    components: RadianceComponents  # that the light is added to
    rows: Index  # row of each point in them
    effort: IntegratorSettings
    rng: np.random.Generator
    rays: int  # gather rays of each point
    depth: int = 0  # bounces between the points and the surface that the camera sees
    # pairs from which directions of gather rays follow; None: drawn
    sequence: SequenceSlice | None = None

    @property
    def has_reflections(self) -> bool:
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
    def control(self) -> Array32:
        """Control-variate fraction of the sky: 0 where not diffuse, 1 where sky shadowing is
        off.
        """
        diffuse = self.points.is_diffuse.astype(np.float32)
        return self.points.sky_control_fraction * diffuse if self.effort.sky_shadowing else diffuse

    def select(self, indices: Index) -> "ShadingRequest":
        """Return the request for some of the points."""
        sequence = None if self.sequence is None else self.sequence.select(indices)
        return replace(
            self, points=self.points.select(indices), rows=self.rows[indices], sequence=sequence
        )

    def add(self, name: str, indices: Index, light: Array) -> None:
        """Add light to a component at some of the points, each named once."""
        self.components.add(name, self.rows[indices], light)

    def add_rays(self, name: str, gather_rays: Index, light: Array) -> None:
        """Add light of some gather rays to a component; the rays of a point are consecutive."""
        if len(gather_rays):
            point = gather_rays // self.rays
            starts = np.flatnonzero(np.diff(point, prepend=-1))
            self.add(name, point[starts], np.add.reduceat(light, starts, axis=0))


def outgoing_radiance(
    scene: SpectralScene,
    points: ShadingPoints,
    effort: IntegratorSettings,
    rng: np.random.Generator,
    *,
    rays: int,
    destination: tuple[RadianceComponents, Index] | None = None,
    split: bool = False,
    depth: int = 0,
    cached: CachedIrradiance | None = None,
    sequence: SequenceSlice | None = None,
    light: Literal["all", "lamps and discs", "surroundings"] = "all",
) -> RadianceComponents:
    """Return the reflected outgoing radiance of points, in components of shape (point, band).

    Parameters
    ----------
    scene, points, effort, rng
        The scene, where, how far light is followed, and the random generator.
    rays
        Gather rays of each point.
    destination
        Components to add to, and the row of each point in them; new ones if None.
    split
        Whether sources and bounces are separate components: sources by name, "glow" of panels,
        "sky", "hidden sky" (the occluded part of the control variate, never positive) and "bounce 1
        of sun", "bounce 2 of sky" ... by number of reflections elsewhere and by source.
    depth
        Bounces between the points and the surface that the camera sees.
    cached
        Points with a cached irradiance, which do not gather: their component is "shared".
    sequence
        Pairs of numbers from which the directions of gather rays follow; None: drawn.
    light
        All light, that of lamps and discs alone, or all other.
    """
    components, rows = destination or (
        RadianceComponents((len(points), scene.bands), split=split),
        np.arange(len(points)),
    )
    request = ShadingRequest(
        points=points,
        components=components,
        rows=rows,
        effort=effort,
        rng=rng,
        rays=rays,
        depth=depth,
        sequence=sequence,
    )
    if light != "surroundings":
        _add_direct(scene, request)
    if light == "lamps and discs":
        return components
    if cached is not None:
        cached_rows, irradiance = cached
        light_of_cache = scene.bsdfs.diffuse_brdf(points)[cached_rows] * irradiance
        request.add("shared", cached_rows, light_of_cache)
        request = request.select(
            np.setdiff1d(np.arange(len(points)), cached_rows, assume_unique=True)
        )
    if len(request.points):
        _add_surroundings(scene, request)
    return components


def _add_direct(scene: SpectralScene, request: ShadingRequest) -> None:
    """Add light of lamps and discs."""
    points, rng, air = request.points, request.rng, _lamp_air(scene, request)

    def add(name: str, samples: LightSamples) -> None:
        request.add(name, *direct_lighting.reflect(scene, points, samples, air))

    for disc in request.effort.active_lights(scene.lighting.discs):
        add(disc.name, direct_lighting.sample_disc(points, disc, rng))
    lamps = request.effort.active_lights(scene.lighting.lamps)
    if request.depth > 0 and len(lamps) > LIMITS.max_sampled_lamps:
        for name, samples in direct_lighting.sample_one_lamp(points, lamps, rng):
            add(name, samples)
    else:
        for lamp in lamps:
            add(lamp.name, direct_lighting.sample_lamp(points, lamp, rng))


def _lamp_air(
    scene: SpectralScene, request: ShadingRequest
) -> direct_lighting.AirTransmittance | None:
    """Return the transmittance of air between lamps and surfaces that the camera sees, if it is
    included.
    """
    return (
        scene.air.transmittance
        if request.effort.path_air and scene.air.is_present and request.depth == 0
        else None
    )


def _add_surroundings(scene: SpectralScene, request: ShadingRequest) -> None:
    """Add light of panels, of the sky and of other surfaces."""
    points, effort, light, bsdfs = request.points, request.effort, scene.lighting, scene.bsdfs
    # Glossy points need rays even for an unoccluded sky.
    has_gather = effort.gathers or bool(points.glossy)
    if light.panels is not None:
        tracer, rays = scene.surfaces.tracer, request.rays if has_gather else 0
        samples = direct_lighting.sample_panels(
            points, light.panels, bsdfs, tracer, request.rng, rays
        )
        request.add(
            "glow", *direct_lighting.reflect(scene, points, samples, _lamp_air(scene, request))
        )
    if not light.environment_map.is_dark:
        open_sky = bsdfs.diffuse_brdf(points) * light.environment_map.irradiance(points.normal)
        request.components.add("sky", request.rows, open_sky * request.control[:, None])
    if not has_gather or scene.surfaces.tracer.scene is None:
        return
    if request.components.split or bsdfs.panes is not None:
        _gather(scene, request)
        return
    if points.glossy:
        _gather(scene, request.select(np.flatnonzero(~points.is_diffuse)))
        request = request.select(np.flatnonzero(points.is_diffuse))
    if len(request.points):
        _add_paths(scene, request)


def _radiance_of_hits(
    scene: SpectralScene, request: ShadingRequest, hit_points: ShadingPoints, depth: int
) -> RadianceComponents:
    """Return the outgoing radiance of points that rays of a request meet."""
    return outgoing_radiance(
        scene,
        hit_points,
        request.effort,
        request.rng,
        rays=1,
        split=request.components.split,
        depth=depth,
    )


def _add_paths(scene: SpectralScene, request: ShadingRequest) -> None:
    """Add indirect light on diffuse points by the compiled path tracer, which defers what is not
    diffuse.
    """
    points, light = request.points, scene.lighting
    only_sky = not request.has_reflections and light.panels is None
    if only_sky and (not request.effort.sky_shadowing or light.environment_map.is_dark):
        return
    # Low-discrepancy rays of neighbouring points sample the sky well enough where only its
    # shadowing is computed.
    sky_importance = None if request.sequence is not None and only_sky else scene.bright_sky
    sequence = request.slices
    if sky_importance is not None:
        _add_bright_sky(scene, request)
    irradiance, deferred = follow_paths(
        scene,
        points,
        sequence,
        request.effort,
        sky_importance,
        control=request.control,
        depth=request.depth,
        seed=int(request.rng.integers(1 << 63)),
    )
    for depth in np.unique(deferred.depth).tolist():
        paths = np.flatnonzero(deferred.depth == depth)
        owner = deferred.owner[paths]
        hit_points = scene.bsdfs.points(
            scene.surfaces,
            deferred.face[paths],
            deferred.position_m[paths],
            deferred.direction[paths],
            points.sky_control_fraction[owner],
        )
        radiance = _radiance_of_hits(scene, request, hit_points, depth).total()
        np.add.at(irradiance, owner, radiance * deferred.weight[paths])
    request.components.add("around", request.rows, irradiance * scene.bsdfs.diffuse_brdf(points))


def _gather(scene: SpectralScene, request: ShadingRequest) -> None:
    """Add indirect light on any surface, in batches of rays."""
    rays, bsdfs, tracer = request.rays, scene.bsdfs, scene.surfaces.tracer
    ray_points = (
        request.points
        if rays == 1
        else request.points.select(np.repeat(np.arange(len(request.points)), rays))
    )
    direction, density = bsdfs.sample(
        ray_points, request.slices.pairs().reshape(-1, 2), request.rng
    )
    cosine = direct_lighting.dot(ray_points.normal, direction)
    is_valid = (cosine > 0.0) & (density > 0.0)
    factor = np.divide(cosine, density * rays, out=np.zeros_like(cosine), where=is_valid).astype(
        np.float32
    )
    start = direct_lighting.ray_starts(ray_points, np.arange(len(ray_points)), tracer)
    segments = trace_segments(tracer, bsdfs.panes, start, direction, request.rng)
    # BRDF times cosine over density and number of rays.
    weight = bsdfs.value(ray_points, direction) * factor[:, None]
    if not scene.lighting.environment_map.is_dark:
        _add_sky(scene, request, direction, density, weight, segments)
        _add_bright_sky(scene, request)
    hit_rays = np.flatnonzero((segments.hit.face != NOTHING) & is_valid)
    if not len(hit_rays) or not (request.has_reflections or scene.lighting.panels):
        return
    hit_points = scene.points(
        segments.hit,
        segments.start_m,
        segments.direction,
        hit_rays,
        ray_points.sky_control_fraction[hit_rays],
    )
    weight = weight[hit_rays] * segments.weight[hit_rays]
    emitters, emission = scene.emission(hit_points)
    if scene.lighting.panels is not None and len(emitters):
        ray = hit_rays[emitters]
        mis_weight = direct_lighting.gather_mis_weight(
            scene.lighting.panels,
            hit_points.face[emitters],
            segments.hit.range_m[ray] + segments.preceding_m[ray],
            -direct_lighting.dot(hit_points.normal[emitters], segments.direction[ray]),
            density[ray],
            rays,
        )
        # Only gather rays sample light reflected by panes.
        mis_weight = np.where(segments.is_reflected[ray], 1.0, mis_weight).astype(np.float32)
        request.add_rays("glow", ray, emission * mis_weight[:, None] * weight[emitters])
    if not request.has_reflections:
        return
    roulette_depth = request.effort.roulette_depth
    if roulette_depth is not None and request.depth >= roulette_depth:
        survival = np.clip(weight.mean(axis=1) * rays, MIN_SURVIVAL, MAX_SURVIVAL)
        survivors = np.flatnonzero(request.rng.random(len(hit_rays)) < survival)
        hit_points, hit_rays = hit_points.select(survivors), hit_rays[survivors]
        weight = weight[survivors] / survival[survivors, None]
    if len(hit_rays):
        components = _radiance_of_hits(scene, request, hit_points, request.depth + 1)
        for name, light in components.by_name.items():
            order, source = bounce_order(name)
            request.add_rays(f"bounce {order + 1} of {source}", hit_rays, light * weight)


def _add_sky(
    scene: SpectralScene,
    request: ShadingRequest,
    direction: Array,
    density: Array,
    weight: Array32,
    segments: Segments,
) -> None:
    """Add the sky that gather rays meet, and subtract the occluded part of the control variate."""
    sky, sky_importance, shadowing = (
        scene.lighting.environment_map,
        scene.bright_sky,
        request.effort.sky_shadowing,
    )
    control = np.repeat(request.control, request.rays)
    is_sky = segments.hit.face == NOTHING
    # Balance heuristic against `_add_bright_sky`.
    gather_density = request.rays * density
    mis_weight = (
        np.ones(len(gather_density))
        if sky_importance is None
        else gather_density / (gather_density + sky_importance.density(direction))
    )
    # Behind panes the control variate does not apply to the transmitted light.
    sky_fraction = (1.0 - control * ~(segments.meets_pane & shadowing)) * mis_weight
    rays = np.flatnonzero(is_sky & (sky_fraction > 0.0))
    light = weight[rays] * segments.weight[rays] * sky.radiance(segments.direction[rays])
    request.add_rays("sky", rays, light * sky_fraction[rays, None].astype(np.float32))
    if shadowing:
        rays = np.flatnonzero((~is_sky | segments.meets_pane) & (control > 0.0))
        light = weight[rays] * sky.radiance(direction[rays])
        sky_fraction = -control * mis_weight
        request.add_rays("hidden sky", rays, light * sky_fraction[rays, None].astype(np.float32))


def _add_bright_sky(scene: SpectralScene, request: ShadingRequest) -> None:
    """Add the importance-sampled part of the sky, one ray from each point (balance heuristic, Veach
    1995).

    Visible and occluded directions count as for gather rays: 1 minus, or minus, the control-variate
    fraction.
    """
    sky_importance, points, shadowing, control = (
        scene.bright_sky,
        request.points,
        request.effort.sky_shadowing,
        request.control,
    )
    if sky_importance is None:
        return
    direction = sky_importance.draw(len(points), request.rng)
    cosine = direct_lighting.dot(points.normal, direction)
    rows = np.flatnonzero(((control < 1.0) | shadowing) & (cosine > 0.0))
    lit_points, direction, tracer = points.select(rows), direction[rows], scene.surfaces.tracer
    is_hidden = tracer.is_occluded(direct_lighting.ray_starts(points, rows, tracer), direction)
    sky_fraction = 1.0 - control[rows]
    sky_fraction = sky_fraction - is_hidden if shadowing else np.where(is_hidden, 0.0, sky_fraction)
    density = request.rays * scene.bsdfs.density(lit_points, direction) + sky_importance.density(
        direction
    )
    sky_radiance = scene.lighting.environment_map.radiance(direction)
    light = scene.bsdfs.value(lit_points, direction) * sky_radiance
    light *= (sky_fraction * cosine[rows] / density).astype(np.float32)[:, None]
    for name, mask in (("sky", ~is_hidden), ("hidden sky", is_hidden)):
        request.add(name, rows[mask], light[mask])
