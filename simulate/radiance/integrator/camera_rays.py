"""Radiance along camera rays: what they meet, panes that split them, and the air between."""

import numpy as np

from simulate.arrays import Array, Array32, Index
from simulate.radiance.geometry.ray_tracer import NOTHING
from simulate.radiance.integrator.integrator_settings import LIMITS, IntegratorSettings
from simulate.radiance.integrator.outgoing_radiance import (
    CacheLookup,
    RadianceComponents,
    outgoing_radiance,
)
from simulate.radiance.integrator.spectral_scene import (
    SpectralScene,
    reflect_direction,
    trace_segments,
)


def radiance_along(
    scene: SpectralScene,
    origin: Array,
    direction: Array,
    effort: IntegratorSettings,
    rng: np.random.Generator,
    *,
    gather_rays: int,
    sky_control_fraction: Array32 | None = None,
    split: bool = False,
    cached_irradiance: CacheLookup | None = None,
    splits: int = LIMITS.max_pane_splits,
) -> RadianceComponents:
    """Return the radiance along rays of unit direction (ray, 3), in components as of
    `outgoing_radiance`.

    Apart from the sources, components are "in view" (sky and emission that the ray meets) and "air"
    (path radiance less the light that air removes from all other components). `cached_irradiance`
    gives the cached irradiance of points by ray number. Rays that meet a pane continue both
    transmitted and reflected; after a few panes (`splits`) one of both at random.
    """
    components = RadianceComponents((len(direction), scene.bands), split=split)
    has_air = scene.air.is_present and "air" not in effort.neglected
    panes = scene.bsdfs.panes

    def add_air(range_m: Array, direction: Array, rays: Index) -> None:
        """Add the path radiance of air, less the light that it removes from all components."""
        if has_air:
            change = scene.air.change_of(components.total()[rays], range_m, direction)
            components.add("air", rays, change)

    if panes is not None and splits:
        hits = panes.hits(origin, direction, scene.surfaces.tracer.hits(origin, direction).range_m)
        no_pane = np.setdiff1d(np.arange(len(direction)), hits.rays)
        incoming = direction[hits.rays]
        for rays, start, next_direction, pane_fraction, is_transmitted in (
            (no_pane, origin[no_pane], direction[no_pane], np.float32(1.0), True),
            (hits.rays, panes.start(hits), incoming, hits.transmittance, True),
            (
                hits.rays,
                panes.start(hits, True),
                reflect_direction(incoming, hits.normal),
                hits.reflectance,
                False,
            ),
        ):
            if not len(rays):
                continue
            continuation = radiance_along(
                scene,
                start,
                next_direction,
                effort,
                rng,
                gather_rays=gather_rays,
                sky_control_fraction=None
                if sky_control_fraction is None
                else sky_control_fraction[rays],
                split=split,
                cached_irradiance=None
                if cached_irradiance is None or not is_transmitted
                else lambda points, numbers, rays=rays: cached_irradiance(points, rays[numbers]),
                splits=0 if rays is no_pane else splits - 1,
            )
            for name, light in continuation.by_name.items():
                components.add(name, rays, light * pane_fraction)
        add_air(hits.range_m, incoming, hits.rays)
        return components
    segments = trace_segments(scene.surfaces.tracer, panes, origin, direction, rng)
    hit, rays, in_sky = (
        segments.hit,
        segments.hit.rays,
        np.flatnonzero(segments.hit.face == NOTHING),
    )
    sky = scene.lighting.environment_map.radiance(segments.direction[in_sky])
    components.add("in view", in_sky, sky)
    control = None if sky_control_fraction is None else sky_control_fraction[rays]
    points = scene.points(hit, segments.start_m, segments.direction, rays, control)
    emitters, emission = scene.emission(points)
    components.add("in view", rays[emitters], emission)
    cached = None
    if cached_irradiance is not None:
        rows, irradiance = cached_irradiance(points, rays)
        is_transmitted = ~segments.is_reflected[rays[rows]]
        cached = rows[is_transmitted], irradiance[is_transmitted]
    destination = components, rays
    outgoing_radiance(
        scene, points, effort, rng, rays=gather_rays, destination=destination, cached=cached
    )
    add_air(hit.range_m[rays], segments.direction[rays], rays)
    pane_rays = np.flatnonzero(segments.meets_pane)
    for light in components.by_name.values():
        light[pane_rays] *= segments.weight[pane_rays]
    add_air(segments.preceding_m[pane_rays], direction[pane_rays], pane_rays)
    return components
