"""Light that comes straight from a lamp, from sun or moon or from a glowing surface, each looked for by name.

A ray goes from the place to a place on the source that is drawn anew for each, so that shadows are as soft as the
source is large.
"""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.geometry.ray_tracer import RayTracer
from simulate.radiance.integrator.light_sources import DiscLight, LampLight, Panels
from simulate.radiance.integrator.shading_points import BsdfSet, ShadingPoints, shading_frames

Array = NDArray[np.floating]
# What air leaves of light over lengths (ray,), m: shape (ray, band).
Through = Callable[[Array], NDArray[np.float32]]
# Numbers of points that get light, and the radiance that they send to the eye, shape (point, band).
Lit = tuple[NDArray[np.int64], NDArray[np.float32]]
# A ray to a source ends so far before it.
SHORT = 1.0 - 1e-4


def from_disc(
    points: ShadingPoints, disc: DiscLight, coats: BsdfSet, tracer: RayTracer, rng: np.random.Generator
) -> Lit:
    """Return radiance towards the eye by light of sun or moon."""
    towards = towards_disc(disc, len(points), rng)
    cosine = np.maximum(_dot(points.normal, towards), 0.0)
    lit = np.flatnonzero(cosine > 0.0)
    lit = lit[~is_occluded(points, lit, towards[lit], tracer, None)]
    found = _reflect(points, coats, lit, towards[lit], cosine[lit], disc.irradiance)
    return _behind_panes(found, points, coats, towards[lit], tracer, None)


def towards_disc(disc: DiscLight, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw unit directions to places on a disc, evenly over its solid angle, shape (count, 3)."""
    least = np.cos(disc.angular_radius_rad)
    cosine, turn = 1.0 - rng.random(count) * (1.0 - least), 2.0 * np.pi * rng.random(count)
    sine = np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
    return (
        np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=1) @ shading_frames(disc.direction[None])[0]
    )


def lamp_factor(points: ShadingPoints, lamp: LampLight) -> tuple[Array, Array, Array]:
    """Return unit directions to a lamp, distances, m, and its irradiance over its spectrum were nothing in the way."""
    way = lamp.position_m - points.place_m
    distance = np.linalg.norm(way, axis=1)
    towards = way / distance[:, None]
    cosine = np.maximum(_dot(points.normal, towards), 0.0)
    return towards, distance, cosine * lamp.pattern(-towards) / distance**2


def from_lamp(
    points: ShadingPoints,
    lamp: LampLight,
    coats: BsdfSet,
    tracer: RayTracer,
    rng: np.random.Generator,
    through: Through | None,
) -> Lit:
    """Return radiance towards the eye by light of a lamp."""
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
    found = _reflect(points, coats, lit, towards[lit], factor[lit], lamp.spectrum, air)
    return _behind_panes(found, points, coats, seen, tracer, SHORT)


def from_one_lamp(
    points: ShadingPoints,
    lamps: tuple[LampLight, ...],
    coats: BsdfSet,
    tracer: RayTracer,
    rng: np.random.Generator,
    through: Through | None,
) -> Iterator[tuple[str, Lit]]:
    """Yield names and radiance towards the eye of lamps, of which one is drawn for each point by what it might give."""
    might = np.stack([lamp_factor(points, lamp)[2] * lamp.spectrum.sum() for lamp in lamps])
    total = might.sum(axis=0)
    chance = np.divide(might, total, out=np.zeros_like(might), where=total > 0.0)
    chosen = (np.cumsum(chance, axis=0) < rng.random(len(points))).sum(axis=0)
    for number, lamp in enumerate(lamps):
        which = np.flatnonzero((chosen == number) & (total > 0.0))
        if len(which):
            lit, light = from_lamp(points.some(which), lamp, coats, tracer, rng, through)
            light /= chance[number, which[lit], None].astype(np.float32)
            yield lamp.name, (which[lit], light)


def from_panels(
    points: ShadingPoints,
    panels: Panels,
    coats: BsdfSet,
    tracer: RayTracer,
    rng: np.random.Generator,
    through: Through | None,
    gathered: int,
) -> Lit:
    """Return radiance towards the eye by light of glowing surfaces.

    Parameters
    ----------
    gathered
        Rays by which the hemisphere is gathered as well: they find the same light, and share it (balance heuristic of
        Veach and Guibas, 1995), so that a panel close by makes no bright specks.
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
    by_gathering = gathered * coats.density(points.some(lit), towards[lit]) if gathered else 0.0
    factor = cosine[lit] / (by_area + by_gathering)
    air = None if through is None else through(distance[lit])
    glow = panels.spectra[panels.kind_of_face[panels.face[panel[lit]]]]
    found = _reflect(points, coats, lit, towards[lit], factor, glow, air)
    return _behind_panes(found, points, coats, way[lit], tracer, SHORT)


def gather_mis_weight(
    panels: Panels, face: NDArray[np.int64], range_m: Array, leaving: Array, density: Array, rays: int
) -> Array:
    """Return the share that gathering has in the light of a panel that it hits: the counterpart of `from_panels`.

    Parameters
    ----------
    face, range_m, leaving
        Triangles hit, distances, m, and cosines at them, shape (ray,).
    density
        Density of gathering in those directions, sr-1, shape (ray,).
    rays
        Rays by which the hemisphere is gathered.
    """
    by_area = panels.per_m2_of_face[face] * range_m**2 / np.maximum(leaving, 1e-12)
    return np.where(leaving > 0.0, rays * density / (rays * density + by_area), 0.0)


def is_occluded(
    points: ShadingPoints, which: NDArray[np.int64], towards: Array, tracer: RayTracer, reach: float | None
) -> NDArray[np.bool_]:
    """Return whether anything stands between some points and places so far (ray, 3) away, shape (ray,)."""
    start = tracer.above(points.face[which], points.place_m[which], points.normal[which])
    return tracer.is_occluded(start, towards, reach)


def _behind_panes(
    found: Lit, points: ShadingPoints, coats: BsdfSet, way: Array, tracer: RayTracer, reach: float | None
) -> Lit:
    """Weaken light of lit points that comes along ways (lit point, 3) by the panes there."""
    if coats.panes is None:
        return found
    lit, light = found
    start = tracer.above(points.face[lit], points.place_m[lit], points.normal[lit])
    which, left = coats.panes.left(start, way, reach)
    light[which] *= left
    return lit, light


def _reflect(
    points: ShadingPoints,
    coats: BsdfSet,
    lit: NDArray[np.int64],
    towards: Array,
    factor: Array,
    spectrum: NDArray[np.float32],
    air: NDArray[np.float32] | None = None,
) -> Lit:
    """Light of lit points, of directions, factors and air (lit point, ...) of those alone."""
    light = coats.value(points.some(lit), towards)
    light *= factor.astype(np.float32)[:, None]
    light *= spectrum
    if air is not None:
        light *= air
    return lit, light


def _dot(a: Array, b: Array) -> NDArray[np.float64]:
    return np.einsum("ij,ij->i", a, b)
