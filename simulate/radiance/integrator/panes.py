"""Thin panes of glass: transmission straight through, and specular reflection.

Panes have a ray tracer of their own, so that scenes without panes lose no time. A pane has no thickness: transmitted
rays are not displaced. Two panes closer to each other than the clearance of rays (`CLEARANCE_M`) count as one.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.geometry.ray_tracer import NOTHING, Hits, RayTracer
from simulate.radiance.integrator.integrator_settings import LIMITS
from simulate.radiance.materials import pane_shares

Array = NDArray[np.floating]
Rows = NDArray[np.int64]


class Met(NamedTuple):
    """Rays that meet a pane, shape (meeting ray, ...)."""

    which: Rows  # numbers of the rays
    range_m: Array
    place_m: Array
    normal: Array  # on the side of the ray's origin
    face: Rows
    mirrored: NDArray[np.float32]  # reflected fraction, shape (meeting ray, band)
    through: NDArray[np.float32]  # transmitted fraction


@dataclass(frozen=True, kw_only=True)
class Panes:
    """All panes of a scene, on bands."""

    tracer: RayTracer
    kind_of_face: NDArray[np.int64]  # kind of glass of each triangle
    transmittance: Array  # of each kind at normal incidence, shape (kind, band)
    refractive_index: tuple[float, ...]  # of each kind

    def met(self, origin_m: Array, direction: Array, reach_m: Array) -> Met:
        """Return the rays of unit direction (ray, 3) that meet a pane within a distance (ray,), m."""
        hit = self.tracer.hits(origin_m, direction)
        which = np.flatnonzero((hit.face != NOTHING) & (hit.range_m < reach_m))
        face, range_m, along = hit.face[which], hit.range_m[which], direction[which]
        facing, cosine = self.tracer.facing(face, along)
        mirrored = np.zeros((len(face), self.transmittance.shape[1]), np.float32)
        through = np.zeros_like(mirrored)
        for number, index in enumerate(self.refractive_index):
            of = np.flatnonzero(self.kind_of_face[face] == number)
            mirrored[of], through[of] = pane_shares(cosine[of], self.transmittance[number], index)
        return Met(which, range_m, origin_m[which] + range_m[:, None] * along, facing, face, mirrored, through)

    def start(self, met: Met, mirrored: NDArray[np.bool_] | bool = False) -> Array:
        """Return starts of transmitted or reflected rays, shape (meeting ray, 3), m."""
        side = np.where(np.broadcast_to(mirrored, met.which.shape)[:, None], met.normal, -met.normal)
        return self.tracer.above(met.face, met.place_m, side)

    def transmittance_along(self, start_m: Array, way: Array, reach: float | None) -> tuple[Rows, NDArray[np.float32]]:
        """Return indices of rays that meet panes, and their transmittances (ray, band).

        Rays have a length of `reach` times that of their vectors `way` (ray, 3), or none.
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
                break
            share[rows] *= met.through
            touched[rows], start = True, self.start(met)
            rest[rows] -= met.range_m
        share[rows] = 0.0
        return np.flatnonzero(touched), share[touched]


class Segments(NamedTuple):
    """Last segments of rays that panes reflect or transmit at random, shape (ray, ...)."""

    start_m: Array
    direction: Array
    hit: Hits  # opaque surface that the segment hits
    earlier_m: Array  # path length before the segment
    crossed: NDArray[np.bool_]  # whether the ray met a pane
    mirrored: NDArray[np.bool_]  # whether a pane reflected it
    weight: NDArray[np.float32]  # fraction of the light over the probability of the path, shape (ray, band or 1)


def trace_segments(
    tracer: RayTracer, panes: Panes | None, start_m: Array, direction: Array, rng: np.random.Generator
) -> Segments:
    """Follow rays of unit direction (ray, 3) to the opaque surface."""
    hit, many = tracer.hits(start_m, direction), len(start_m)
    no, plain = np.zeros(many, bool), np.ones((many, 1), np.float32)
    if panes is None:
        return Segments(start_m, direction, hit, np.zeros(many), no, no, plain)
    start, ahead, face, range_m = np.array(start_m), np.array(direction), hit.face, hit.range_m
    earlier, crossed, mirrored = np.zeros(many), no.copy(), no.copy()
    weight, rows = plain.repeat(panes.transmittance.shape[1], axis=1), np.arange(many)
    for _ in range(LIMITS.max_panes):
        met = panes.met(start[rows], ahead[rows], range_m[rows])
        rows = rows[met.which]
        if not len(rows):
            break
        back, on = met.mirrored.mean(axis=1), met.through.mean(axis=1)
        chance = back / np.maximum(back + on, 1e-30)
        turns = rng.random(len(rows)) < chance
        weight[rows] *= np.where(turns[:, None], met.mirrored, met.through)
        weight[rows] /= np.where(turns, chance, 1.0 - chance)[:, None].astype(np.float32)
        start[rows] = panes.start(met, turns)
        ahead[rows] = np.where(turns[:, None], reflect_direction(ahead[rows], met.normal), ahead[rows])
        earlier[rows] += met.range_m
        crossed[rows], mirrored[rows] = True, mirrored[rows] | turns
        onwards = tracer.hits(start[rows], ahead[rows])
        face[rows], range_m[rows] = onwards.face, onwards.range_m
    weight[rows] = 0.0
    return Segments(start, ahead, Hits(face, range_m), earlier, crossed, mirrored, weight)


def reflect_direction(direction: Array, normal: Array) -> Array:
    """Return directions (ray, 3) reflected by planes of unit normals (ray, 3)."""
    return direction - 2.0 * np.einsum("ij,ij->i", direction, normal)[:, None] * normal
