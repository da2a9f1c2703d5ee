"""Thin panes of glass: transmission straight through, and specular reflection.

Panes have a ray tracer of their own, so that scenes without panes lose no time. A pane has no thickness: transmitted
rays are not displaced. Two panes closer to each other than the clearance of rays (`CLEARANCE_M`) count as one.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.geometry.ray_tracer import NOTHING, RayTracer
from simulate.radiance.integrator.integrator_settings import LIMITS
from simulate.radiance.materials import pane_shares

Array = NDArray[np.floating]
Rows = NDArray[np.int64]


@dataclass(frozen=True)
class Met:
    """Rays that meet a pane.

    Parameters
    ----------
    which
        Indices of the rays, shape (meeting ray,).
    range_m
        Distance, shape (meeting ray,), m.
    place_m, normal
        Position, and the pane's unit normal on the side of the ray's origin, shape (meeting ray, 3).
    face
        Triangles of the panes.
    mirrored, through
        Reflected and transmitted fractions, shape (meeting ray, band).
    """

    which: Rows
    range_m: Array
    place_m: Array
    normal: Array
    face: Rows
    mirrored: NDArray[np.float32]
    through: NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class Panes:
    """All panes of a scene, on bands.

    Parameters
    ----------
    tracer
        Ray tracer of their triangles.
    kind_of_face
        Kind of glass of each, shape (face,).
    transmittance
        Of each kind at normal incidence, shape (kind, band).
    refractive_index
        Of each kind.
    """

    tracer: RayTracer
    kind_of_face: NDArray[np.int64]
    transmittance: NDArray[np.float64]
    refractive_index: tuple[float, ...]

    def met(self, origin_m: Array, direction: Array, reach_m: Array) -> Met:
        """Return the rays of unit direction (ray, 3) that meet a pane within a distance (ray,), m."""
        hit = self.tracer.hits(origin_m, direction)
        which = np.flatnonzero((hit.face != NOTHING) & (hit.range_m < reach_m))
        face, range_m, along = hit.face[which], hit.range_m[which], direction[which]
        normal = self.tracer.normals(face)
        cosine = np.einsum("ij,ij->i", normal, along)
        mirrored, through = self._shares(self.kind_of_face[face], cosine)
        facing = np.where(cosine[:, None] < 0.0, normal, -normal)
        place = origin_m[which] + range_m[:, None] * along
        return Met(which, range_m, place, facing, face, mirrored, through)

    def beyond(self, met: Met) -> NDArray[np.float64]:
        """Return starts of transmitted rays, shape (meeting ray, 3), m."""
        return self.tracer.above(met.face, met.place_m, -met.normal)

    def before(self, met: Met) -> NDArray[np.float64]:
        """Return starts of reflected rays, shape (meeting ray, 3), m."""
        return self.tracer.above(met.face, met.place_m, met.normal)

    def transmittance_along(self, start_m: Array, way: Array, reach: float | None) -> tuple[Rows, NDArray[np.float32]]:
        """Return indices of rays that meet panes, and their transmittances (ray, band).

        Parameters
        ----------
        start_m, way
            Rays, each of shape (ray, 3).
        reach
            Length of the rays, in lengths of the vectors; None: infinite.
        """
        length = np.linalg.norm(way, axis=1)
        ahead = way / np.maximum(length, 1e-300)[:, None]
        rest = np.full(len(way), np.inf) if reach is None else reach * length
        share = np.ones((len(way), self.transmittance.shape[1]), np.float32)
        rows, start, touched = np.arange(len(way)), np.asarray(start_m, float), np.zeros(len(way), bool)
        for _ in range(LIMITS.max_panes):
            met = self.met(start, ahead[rows], rest[rows])
            rows = rows[met.which]
            if not len(rows):
                return np.flatnonzero(touched), share[touched]
            share[rows] *= met.through
            touched[rows], start = True, self.beyond(met)
            rest[rows] -= met.range_m
        share[rows] = 0.0
        return np.flatnonzero(touched), share[touched]

    def _shares(self, kind: Rows, cosine: Array) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        mirrored = np.zeros((len(kind), self.transmittance.shape[1]), np.float32)
        through = np.zeros_like(mirrored)
        for number, index in enumerate(self.refractive_index):
            of = np.flatnonzero(kind == number)
            mirrored[of], through[of] = pane_shares(cosine[of], self.transmittance[number], index)
        return mirrored, through


@dataclass(frozen=True)
class Passed:
    """Rays that met panes, and their last segments.

    Parameters
    ----------
    which
        Indices of the rays, shape (meeting ray,).
    start_m, direction
        Last segments, shape (meeting ray, 3).
    face, range_m
        Opaque surface that these hit, and distance, m.
    earlier_length_m
        Path length before the last segments, m.
    is_reflected
        Whether a pane reflected them.
    weight
        Fractions of the light over the probability of the path, shape (meeting ray, band).
    """

    which: Rows
    start_m: Array
    direction: Array
    face: Rows
    range_m: Array
    earlier_length_m: Array
    is_reflected: NDArray[np.bool_]
    weight: NDArray[np.float32]


def trace_through_panes(
    panes: Panes, tracer: RayTracer, start_m: Array, direction: Array, range_m: Array, rng: np.random.Generator
) -> Passed:
    """Follow rays that meet panes before the opaque surface at a range (ray,): transmitted or reflected at random."""
    met = panes.met(start_m, direction, range_m)
    which = met.which
    ends = Passed(
        which,
        np.array(start_m[which]),
        np.array(direction[which]),
        np.full(len(which), NOTHING, np.int64),
        np.full(len(which), np.inf),
        np.zeros(len(which)),
        np.zeros(len(which), bool),
        np.ones((len(which), panes.transmittance.shape[1]), np.float32),
    )
    rows = np.arange(len(which))
    for _ in range(LIMITS.max_panes):
        if not len(rows):
            return ends
        turns, share = choose_mirror_rays(met, rng)
        ends.weight[rows] *= share
        ends.start_m[rows] = np.where(turns[:, None], panes.before(met), panes.beyond(met))
        ends.direction[rows] = np.where(
            turns[:, None], reflect_direction(ends.direction[rows], met.normal), ends.direction[rows]
        )
        ends.earlier_length_m[rows] += met.range_m
        ends.is_reflected[rows] |= turns
        hit = tracer.hits(ends.start_m[rows], ends.direction[rows])
        ends.face[rows], ends.range_m[rows] = hit.face, hit.range_m
        met = panes.met(ends.start_m[rows], ends.direction[rows], hit.range_m)
        rows = rows[met.which]
    ends.weight[rows] = 0.0
    return ends


def choose_mirror_rays(met: Met, rng: np.random.Generator) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Draw which rays are reflected; return that, and fractions of the light over the probability (ray, band)."""
    back, on = met.mirrored.mean(axis=1), met.through.mean(axis=1)
    chance = back / np.maximum(back + on, 1e-30)
    turns = rng.random(len(chance)) < chance
    share = np.where(turns[:, None], met.mirrored, met.through)
    return turns, share / np.where(turns, chance, 1.0 - chance)[:, None].astype(np.float32)


def reflect_direction(direction: Array, normal: Array) -> NDArray[np.float64]:
    """Return directions (ray, 3) reflected by planes of unit normals (ray, 3)."""
    return direction - 2.0 * np.einsum("ij,ij->i", direction, normal)[:, None] * normal
