"""Direct lighting of points on any surface: next-event estimation of lamps, sun, moon and emitting
surfaces.

Each shadow ray ends at a random point of its source, so that penumbrae follow from the source's
size.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.geometry.ray_tracer import RayTracer
from simulate.radiance.integrator.light_sources import SHORT, DiscLight, LampLight, Panels
from simulate.radiance.integrator.sampling import shading_frames
from simulate.radiance.integrator.spectral_scene import BsdfSet, ShadingPoints, SpectralScene

Array = NDArray[np.floating]
# Transmittance of air over lengths (ray,), m: shape (ray, band).
Through = Callable[[Array], NDArray[np.float32]]
# Indices of illuminated points, and their outgoing radiance, shape (point, band).
Lit = tuple[NDArray[np.int64], NDArray[np.float32]]


class LightSamples(NamedTuple):
    """Samples of sources, at most one for each point, without occlusion, shape (sample, ...)."""

    which: NDArray[np.int64]  # points
    direction: Array  # unit direction by which the BSDF is evaluated
    target: Array  # vector from the point to the sampled position; a direction for sun and moon
    factor: Array  # irradiance over the spectrum
    spectrum: NDArray[np.float32]  # shape (band,) or (sample, band)
    distance_m: Array | None = None  # None for sun and moon


def reflect(
    stage: SpectralScene,
    points: ShadingPoints,
    samples: LightSamples,
    through: Through | None = None,
) -> Lit:
    """Return the reflected light of sources, as far as surfaces do not occlude it, through panes
    and air.
    """
    length_limit, panes = None if samples.distance_m is None else SHORT, stage.bsdfs.panes
    start = ray_starts(points, samples.which, stage.surfaces.tracer)
    clear = np.flatnonzero(~stage.surfaces.tracer.is_occluded(start, samples.target, length_limit))
    lit = samples.which[clear]
    light = stage.bsdfs.value(points.some(lit), samples.direction[clear])
    light *= samples.factor[clear, None].astype(np.float32)
    light *= samples.spectrum if samples.spectrum.ndim == 1 else samples.spectrum[clear]
    if through is not None and samples.distance_m is not None:
        light *= through(samples.distance_m[clear])
    if panes is not None:
        behind, pane_transmittance = panes.transmittance_along(
            start[clear], samples.target[clear], length_limit
        )
        light[behind] *= pane_transmittance
    return lit, light


def sample_disc(points: ShadingPoints, disc: DiscLight, rng: np.random.Generator) -> LightSamples:
    """Draw a point of sun or moon, uniform over its solid angle, for each point."""
    count, limb_cosine = len(points), np.cos(disc.angular_radius_rad)
    up, turn = 1.0 - rng.random(count) * (1.0 - limb_cosine), 2.0 * np.pi * rng.random(count)
    sine = np.sqrt(np.maximum(1.0 - up**2, 0.0))
    local = np.stack([sine * np.cos(turn), sine * np.sin(turn), up], axis=1)
    towards = local @ shading_frames(disc.direction[None])[0]
    cosine = dot(points.normal, towards)
    lit = np.flatnonzero(cosine > 0.0)
    return LightSamples(lit, towards[lit], towards[lit], cosine[lit], disc.irradiance)


def lamp_factor(points: ShadingPoints, lamp: LampLight) -> tuple[Array, Array, Array]:
    """Return unit directions to a lamp, distances, m, and its unoccluded irradiance over its
    spectrum.
    """
    way = lamp.position_m - points.place_m
    distance = np.linalg.norm(way, axis=1)
    towards = way / distance[:, None]
    cosine = np.maximum(dot(points.normal, towards), 0.0)
    return towards, distance, cosine * lamp.per_sr(-towards) / distance**2


def sample_lamp(points: ShadingPoints, lamp: LampLight, rng: np.random.Generator) -> LightSamples:
    """Draw a point of a lamp's disc for each point; its irradiance is that of its centre."""
    towards, distance, factor = lamp_factor(points, lamp)
    lit = np.flatnonzero(factor > 0.0)
    radius, turn = lamp.radius_m * np.sqrt(rng.random(len(lit))), 2.0 * np.pi * rng.random(len(lit))
    across = shading_frames(towards[lit])
    target = (distance[lit, None] * towards[lit]) + radius[:, None] * (
        np.cos(turn)[:, None] * across[:, 0] + np.sin(turn)[:, None] * across[:, 1]
    )
    return LightSamples(lit, towards[lit], target, factor[lit], lamp.spectrum, distance[lit])


def sample_one_lamp(
    points: ShadingPoints, lamps: tuple[LampLight, ...], rng: np.random.Generator
) -> Iterator[tuple[str, LightSamples]]:
    """Yield names and samples of lamps; one lamp a point is drawn, by its unoccluded irradiance."""
    might = np.stack([lamp_factor(points, lamp)[2] * lamp.spectrum.sum() for lamp in lamps])
    total = might.sum(axis=0)
    chance = np.divide(might, total, out=np.zeros_like(might), where=total > 0.0)
    chosen = (np.cumsum(chance, axis=0) < rng.random(len(points))).sum(axis=0)
    for number, lamp in enumerate(lamps):
        which = np.flatnonzero((chosen == number) & (total > 0.0))
        if len(which):
            samples = sample_lamp(points.some(which), lamp, rng)
            lit = which[samples.which]
            yield (
                lamp.name,
                samples._replace(which=lit, factor=samples.factor / chance[number, lit]),
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
    way = panel_point - points.place_m
    distance = np.linalg.norm(way, axis=1)
    towards = np.divide(
        way, distance[:, None], out=np.zeros_like(way), where=distance[:, None] > 0.0
    )
    cosine, leaving = dot(points.normal, towards), -dot(panels.normal[panel], towards)
    lit = np.flatnonzero((cosine > 0.0) & (leaving > 0.0))
    panel, towards, distance, face = (
        panel[lit],
        towards[lit],
        distance[lit],
        panels.face[panel[lit]],
    )
    target = tracer.above(face, panel_point[lit], panels.normal[panel]) - ray_starts(
        points, lit, tracer
    )
    by_area = panels.per_m2_of_face[face] * distance**2 / leaving[lit]
    by_gathering = gather_rays * bsdfs.density(points.some(lit), towards) if gather_rays else 0.0
    factor, glow = cosine[lit] / (by_area + by_gathering), panels.spectra[panels.kind_of_face[face]]
    return LightSamples(lit, towards, target, factor, glow, distance)


def gather_mis_weight(
    panels: Panels,
    face: NDArray[np.int64],
    range_m: Array,
    leaving: Array,
    density: Array,
    rays: int,
) -> Array:
    """Return the balance-heuristic weight of gather rays that hit panels: the counterpart of
    `sample_panels`.

    Parameters
    ----------
    panels, face, range_m, leaving
        Panels, triangles hit, distances, m, and cosines at them, shape (ray,).
    density, rays
        Sampling density of the gather rays in those directions, sr-1, shape (ray,), and gather rays
        of each point.
    """
    by_area = panels.per_m2_of_face[face] * range_m**2 / np.maximum(leaving, 1e-12)
    return np.where(leaving > 0.0, rays * density / (rays * density + by_area), 0.0)


def ray_starts(points: ShadingPoints, which: NDArray[np.int64], tracer: RayTracer) -> Array:
    """Return where rays from some of the points start, shape (ray, 3), m."""
    return tracer.above(points.face[which], points.place_m[which], points.normal[which])


def dot(a: Array, b: Array) -> Array:
    """Return the products of vectors (ray, 3), shape (ray,)."""
    return np.einsum("ij,ij->i", a, b)
