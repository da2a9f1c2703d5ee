"""Direct lighting by lamps, sun, moon and emitting surfaces: next-event estimation.

Each shadow ray ends at a random point of its source, so that penumbrae follow from the source's size.
"""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.geometry.ray_tracer import RayTracer
from simulate.radiance.integrator.compiled_light_sources import SHORT
from simulate.radiance.integrator.light_sources import DiscLight, LampLight, Panels
from simulate.radiance.integrator.shading_points import BsdfSet, ShadingPoints, shading_frames

Array = NDArray[np.floating]
# Transmittance of air over lengths (ray,), m: shape (ray, band).
Through = Callable[[Array], NDArray[np.float32]]
# Indices of illuminated points, and their outgoing radiance, shape (point, band).
Lit = tuple[NDArray[np.int64], NDArray[np.float32]]


def from_disc(
    points: ShadingPoints, disc: DiscLight, bsdfs: BsdfSet, tracer: RayTracer, rng: np.random.Generator
) -> Lit:
    """Return the outgoing radiance by light of sun or moon."""
    towards = towards_disc(disc, len(points), rng)
    cosine = np.maximum(_dot(points.normal, towards), 0.0)
    lit = np.flatnonzero(cosine > 0.0)
    lit = lit[~is_occluded(points, lit, towards[lit], tracer, None)]
    found = _reflect(points, bsdfs, lit, towards[lit], cosine[lit], disc.irradiance)
    return _behind_panes(found, points, bsdfs, towards[lit], tracer, None)


def towards_disc(disc: DiscLight, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw unit directions to points of a disc, uniform over its solid angle, shape (count, 3)."""
    least = np.cos(disc.angular_radius_rad)
    cosine, turn = 1.0 - rng.random(count) * (1.0 - least), 2.0 * np.pi * rng.random(count)
    sine = np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
    return (
        np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=1) @ shading_frames(disc.direction[None])[0]
    )


def lamp_factor(points: ShadingPoints, lamp: LampLight) -> tuple[Array, Array, Array]:
    """Return unit directions to a lamp, distances, m, and its unoccluded irradiance over its spectrum."""
    way = lamp.position_m - points.place_m
    distance = np.linalg.norm(way, axis=1)
    towards = way / distance[:, None]
    cosine = np.maximum(_dot(points.normal, towards), 0.0)
    return towards, distance, cosine * lamp.pattern(-towards) / distance**2


def from_lamp(
    points: ShadingPoints,
    lamp: LampLight,
    bsdfs: BsdfSet,
    tracer: RayTracer,
    rng: np.random.Generator,
    through: Through | None,
) -> Lit:
    """Return the outgoing radiance by light of a lamp."""
    towards, distance, factor = lamp_factor(points, lamp)
    lit = np.flatnonzero(factor > 0.0)
    radius, turn = lamp.radius_m * np.sqrt(rng.random(len(lit))), 2.0 * np.pi * rng.random(len(lit))
    across = shading_frames(towards[lit])
    seen = (distance[lit, None] * towards[lit]) + radius[:, None] * (
        np.cos(turn)[:, None] * across[:, 0] + np.sin(turn)[:, None] * across[:, 1]
    )
    clear = ~is_occluded(points, lit, seen, tracer, SHORT)
    lit, seen = lit[clear], seen[clear]
    air = None if through is None else through(distance[lit])
    found = _reflect(points, bsdfs, lit, towards[lit], factor[lit], lamp.spectrum, air)
    return _behind_panes(found, points, bsdfs, seen, tracer, SHORT)


def from_one_lamp(
    points: ShadingPoints,
    lamps: tuple[LampLight, ...],
    bsdfs: BsdfSet,
    tracer: RayTracer,
    rng: np.random.Generator,
    through: Through | None,
) -> Iterator[tuple[str, Lit]]:
    """Yield names and outgoing radiance of lamps; one lamp a point is drawn, by its unoccluded irradiance."""
    might = np.stack([lamp_factor(points, lamp)[2] * lamp.spectrum.sum() for lamp in lamps])
    total = might.sum(axis=0)
    chance = np.divide(might, total, out=np.zeros_like(might), where=total > 0.0)
    chosen = (np.cumsum(chance, axis=0) < rng.random(len(points))).sum(axis=0)
    for number, lamp in enumerate(lamps):
        which = np.flatnonzero((chosen == number) & (total > 0.0))
        if len(which):
            lit, light = from_lamp(points.some(which), lamp, bsdfs, tracer, rng, through)
            light /= chance[number, which[lit], None].astype(np.float32)
            yield lamp.name, (which[lit], light)


def from_panels(
    points: ShadingPoints,
    panels: Panels,
    bsdfs: BsdfSet,
    tracer: RayTracer,
    rng: np.random.Generator,
    through: Through | None,
    gather_rays: int,
) -> Lit:
    """Return the outgoing radiance by light of emitting surfaces.

    Parameters
    ----------
    gather_rays
        Gather rays of each point, which sample the same light: both are combined by the balance heuristic (Veach and
        Guibas, 1995), so that a close panel does not cause bright outliers.
    """
    panel, place = panels.draw(len(points), rng)
    way = place - points.place_m
    distance = np.linalg.norm(way, axis=1)
    towards = np.divide(way, distance[:, None], out=np.zeros_like(way), where=distance[:, None] > 0.0)
    cosine = np.maximum(_dot(points.normal, towards), 0.0)
    leaving = np.maximum(-_dot(panels.normal[panel], towards), 0.0)
    lit = np.flatnonzero((cosine > 0.0) & (leaving > 0.0))
    target = tracer.above(panels.face[panel[lit]], place[lit], panels.normal[panel[lit]])
    start = tracer.above(points.face[lit], points.place_m[lit], points.normal[lit])
    lit = lit[~tracer.is_occluded(start, target - start, SHORT)]
    by_area = panels.per_m2_of_face[panels.face[panel[lit]]] * distance[lit] ** 2 / leaving[lit]
    by_gathering = gather_rays * bsdfs.density(points.some(lit), towards[lit]) if gather_rays else 0.0
    factor = cosine[lit] / (by_area + by_gathering)
    air = None if through is None else through(distance[lit])
    glow = panels.spectra[panels.kind_of_face[panels.face[panel[lit]]]]
    found = _reflect(points, bsdfs, lit, towards[lit], factor, glow, air)
    return _behind_panes(found, points, bsdfs, way[lit], tracer, SHORT)


def gather_mis_weight(
    panels: Panels, face: NDArray[np.int64], range_m: Array, leaving: Array, density: Array, rays: int
) -> Array:
    """Return the balance-heuristic weight of a gather ray that hits a panel: the counterpart of `from_panels`.

    Parameters
    ----------
    face, range_m, leaving
        Triangles hit, distances, m, and cosines at them, shape (ray,).
    density
        Sampling density of the gather rays in those directions, sr-1, shape (ray,).
    rays
        Gather rays of each point.
    """
    by_area = panels.per_m2_of_face[face] * range_m**2 / np.maximum(leaving, 1e-12)
    return np.where(leaving > 0.0, rays * density / (rays * density + by_area), 0.0)


def is_occluded(
    points: ShadingPoints, which: NDArray[np.int64], towards: Array, tracer: RayTracer, reach: float | None
) -> NDArray[np.bool_]:
    """Return whether a surface lies between some points and positions relative to them (ray, 3), shape (ray,)."""
    start = tracer.above(points.face[which], points.place_m[which], points.normal[which])
    return tracer.is_occluded(start, towards, reach)


def _behind_panes(
    found: Lit, points: ShadingPoints, bsdfs: BsdfSet, way: Array, tracer: RayTracer, reach: float | None
) -> Lit:
    """Attenuate light that arrives along vectors (illuminated point, 3) by the panes there."""
    if bsdfs.panes is None:
        return found
    lit, light = found
    start = tracer.above(points.face[lit], points.place_m[lit], points.normal[lit])
    which, left = bsdfs.panes.transmittance_along(start, way, reach)
    light[which] *= left
    return lit, light


def _reflect(
    points: ShadingPoints,
    bsdfs: BsdfSet,
    lit: NDArray[np.int64],
    towards: Array,
    factor: Array,
    spectrum: NDArray[np.float32],
    air: NDArray[np.float32] | None = None,
) -> Lit:
    """Return the reflected light of illuminated points; directions, factors and air are given for these only."""
    light = bsdfs.value(points.some(lit), towards)
    light *= factor.astype(np.float32)[:, None]
    light *= spectrum
    if air is not None:
        light *= air
    return lit, light


def _dot(a: Array, b: Array) -> NDArray[np.float64]:
    return np.einsum("ij,ij->i", a, b)
