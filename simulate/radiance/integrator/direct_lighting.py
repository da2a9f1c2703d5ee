"""Direct lighting of points on any surface: next-event estimation of lamps, sun, moon and emitting
surfaces.

Each shadow ray ends at a random point of its source, so that penumbrae follow from the source's
size.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from simulate.arrays import Array, Array32, Index
from simulate.radiance.geometry.ray_tracer import RayTracer
from simulate.radiance.integrator.light_sources import SHORT, DiscLight, LampLight, Panels
from simulate.radiance.integrator.sampling import shading_frames
from simulate.radiance.integrator.spectral_scene import BsdfSet, ShadingPoints, SpectralScene

# Transmittance of air over lengths (ray,), m: shape (ray, band).
AirTransmittance = Callable[[Array], Array32]
# Indices of illuminated points, and their outgoing radiance, shape (point, band).
Lit = tuple[Index, Array32]


class LightSamples(NamedTuple):
    """Samples of sources, at most one for each point, without occlusion, shape (sample, ...)."""

    points: Index  # indices of the points
    direction: Array  # unit direction by which the BSDF is evaluated
    target: Array  # vector from the point to the sampled position; a direction for sun and moon
    factor: Array  # irradiance over the spectrum
    spectrum: Array32  # shape (band,) or (sample, band)
    distance_m: Array | None = None  # None for sun and moon


def reflect(
    scene: SpectralScene,
    points: ShadingPoints,
    samples: LightSamples,
    air_transmittance: AirTransmittance | None = None,
) -> Lit:
    """Return the reflected light of sources, as far as surfaces do not occlude it, through panes
    and air.
    """
    length_limit, panes = None if samples.distance_m is None else SHORT, scene.bsdfs.panes
    start = ray_starts(points, samples.points, scene.surfaces.tracer)
    unoccluded = np.flatnonzero(
        ~scene.surfaces.tracer.is_occluded(start, samples.target, length_limit)
    )
    lit = samples.points[unoccluded]
    light = scene.bsdfs.value(points.select(lit), samples.direction[unoccluded])
    light *= samples.factor[unoccluded, None].astype(np.float32)
    light *= samples.spectrum if samples.spectrum.ndim == 1 else samples.spectrum[unoccluded]
    if air_transmittance is not None and samples.distance_m is not None:
        light *= air_transmittance(samples.distance_m[unoccluded])
    if panes is not None:
        pane_rays, pane_transmittance = panes.transmittance_along(
            start[unoccluded], samples.target[unoccluded], length_limit
        )
        light[pane_rays] *= pane_transmittance
    return lit, light


def sample_disc(points: ShadingPoints, disc: DiscLight, rng: np.random.Generator) -> LightSamples:
    """Draw a point of sun or moon, uniform over its solid angle, for each point."""
    count, limb_cosine = len(points), np.cos(disc.angular_radius_rad)
    z, azimuth = 1.0 - rng.random(count) * (1.0 - limb_cosine), 2.0 * np.pi * rng.random(count)
    sine = np.sqrt(np.maximum(1.0 - z**2, 0.0))
    local = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), z], axis=1)
    direction = local @ shading_frames(disc.direction[None])[0]
    cosine = dot(points.normal, direction)
    lit = np.flatnonzero(cosine > 0.0)
    return LightSamples(lit, direction[lit], direction[lit], cosine[lit], disc.irradiance)


def lamp_factor(points: ShadingPoints, lamp: LampLight) -> tuple[Array, Array, Array]:
    """Return unit directions to a lamp, distances, m, and its unoccluded irradiance over its
    spectrum.
    """
    vector = lamp.position_m - points.position_m
    distance = np.linalg.norm(vector, axis=1)
    direction = vector / distance[:, None]
    cosine = np.maximum(dot(points.normal, direction), 0.0)
    return direction, distance, cosine * lamp.per_sr(-direction) / distance**2


def sample_lamp(points: ShadingPoints, lamp: LampLight, rng: np.random.Generator) -> LightSamples:
    """Draw a point of a lamp's disc for each point; its irradiance is that of its centre."""
    direction, distance, factor = lamp_factor(points, lamp)
    lit = np.flatnonzero(factor > 0.0)
    radius, azimuth = (
        lamp.radius_m * np.sqrt(rng.random(len(lit))),
        2.0 * np.pi * rng.random(len(lit)),
    )
    frame = shading_frames(direction[lit])
    target = (distance[lit, None] * direction[lit]) + radius[:, None] * (
        np.cos(azimuth)[:, None] * frame[:, 0] + np.sin(azimuth)[:, None] * frame[:, 1]
    )
    return LightSamples(lit, direction[lit], target, factor[lit], lamp.spectrum, distance[lit])


def sample_one_lamp(
    points: ShadingPoints, lamps: tuple[LampLight, ...], rng: np.random.Generator
) -> Iterator[tuple[str, LightSamples]]:
    """Yield names and samples of lamps; one lamp a point is drawn, by its unoccluded irradiance."""
    lamp_irradiance = np.stack(
        [lamp_factor(points, lamp)[2] * lamp.spectrum.sum() for lamp in lamps]
    )
    total = lamp_irradiance.sum(axis=0)
    probability = np.divide(
        lamp_irradiance, total, out=np.zeros_like(lamp_irradiance), where=total > 0.0
    )
    drawn_lamp = (np.cumsum(probability, axis=0) < rng.random(len(points))).sum(axis=0)
    for number, lamp in enumerate(lamps):
        rows = np.flatnonzero((drawn_lamp == number) & (total > 0.0))
        if len(rows):
            samples = sample_lamp(points.select(rows), lamp, rng)
            lit = rows[samples.points]
            yield (
                lamp.name,
                samples._replace(points=lit, factor=samples.factor / probability[number, lit]),
            )


def sample_panels(
    points: ShadingPoints,
    panels: Panels,
    bsdfs: BsdfSet,
    tracer: RayTracer,
    rng: np.random.Generator,
    gather_rays: int,
) -> LightSamples:
    """Draw a point of the emitting surfaces for each point.

    `gather_rays` of each point sample the same light: both are combined by the balance heuristic
    (Veach and Guibas, 1995; `gather_mis_weight`), so that a close panel does not cause bright
    outliers.
    """
    panel, panel_point = panels.draw(len(points), rng)
    vector = panel_point - points.position_m
    distance = np.linalg.norm(vector, axis=1)
    direction = np.divide(
        vector, distance[:, None], out=np.zeros_like(vector), where=distance[:, None] > 0.0
    )
    cosine, source_cosine = dot(points.normal, direction), -dot(panels.normal[panel], direction)
    lit = np.flatnonzero((cosine > 0.0) & (source_cosine > 0.0))
    panel, direction, distance, face = (
        panel[lit],
        direction[lit],
        distance[lit],
        panels.face[panel[lit]],
    )
    target = tracer.ray_starts(face, panel_point[lit], panels.normal[panel]) - ray_starts(
        points, lit, tracer
    )
    panel_density = panels.per_m2_of_face[face] * distance**2 / source_cosine[lit]
    gather_density = (
        gather_rays * bsdfs.density(points.select(lit), direction) if gather_rays else 0.0
    )
    factor, glow = (
        cosine[lit] / (panel_density + gather_density),
        panels.spectra[panels.kind_of_face[face]],
    )
    return LightSamples(lit, direction, target, factor, glow, distance)


def gather_mis_weight(
    panels: Panels,
    face: Index,
    range_m: Array,
    source_cosine: Array,
    density: Array,
    rays: int,
) -> Array:
    """Return the balance-heuristic weight of gather rays that hit panels: the counterpart of
    `sample_panels`.

    Parameters
    ----------
    panels, face, range_m, source_cosine
        Panels, triangles hit, distances, m, and cosines at them, shape (ray,).
    density, rays
        Sampling density of the gather rays in those directions, sr-1, shape (ray,), and gather rays
        of each point.
    """
    panel_density = panels.per_m2_of_face[face] * range_m**2 / np.maximum(source_cosine, 1e-12)
    return np.where(source_cosine > 0.0, rays * density / (rays * density + panel_density), 0.0)


def ray_starts(points: ShadingPoints, rows: Index, tracer: RayTracer) -> Array:
    """Return where rays from some of the points start, shape (ray, 3), m."""
    return tracer.ray_starts(points.face[rows], points.position_m[rows], points.normal[rows])


def dot(a: Array, b: Array) -> Array:
    """Return the products of vectors (ray, 3), shape (ray,)."""
    return np.einsum("ij,ij->i", a, b)
