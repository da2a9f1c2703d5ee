"""View factors of facets: sun, sky and each other, sampled by rays.

A facet is the part of an object's surface with one material and one of 26 directions. Sample points
represent it in the heat balance; pixels of an image differ from it by their exposure to sun and
sky.
"""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from simulate.arrays import Array, Index
from simulate.radiance.geometry.embree import ROW
from simulate.radiance.geometry.ray_tracer import NOTHING, RayTracer
from simulate.radiance.geometry.surfaces import Surfaces
from simulate.radiance.integrator.sampling import SequenceSlice, cosine_lobe, shading_frames
from simulate.thermal.thresholds import LIMITS

# Rings of the sky, equal in what level ground receives of a uniform sky, and the sine of the
# elevation of each.
RINGS = 12
RING_SINE = np.sqrt((np.arange(RINGS) + 0.5) / RINGS)
# Steps by which the rings that a plane sees are integrated, of each ring, around, and of the
# plane's normal.
OPEN_HEIGHTS, OPEN_TURNS, OPEN_TILTS = 16, 180, 181
# Components of a normal count as zero within 22.5 degrees: there are 26 directions, in a table of
# 27.
SLANT, DIRECTIONS = 0.3827, 27


def direction_of(normal: Array) -> Index:
    """Return the number of the direction of normals (point, 3), shape (point,)."""
    sign = np.sign(normal) * (np.abs(normal) > SLANT)
    return ((sign + 1.0) @ [9.0, 3.0, 1.0]).astype(np.int64)


@dataclass(frozen=True, kw_only=True)
class Facets:
    """Facets of a scene.

    Parameters
    ----------
    surfaces
        The surfaces, panes of glass among them.
    shades
        Ray tracer of those that hide the sun: all but panes.
    key
        Ascending numbers of object, material and direction, shape (facet,).
    area_m2
        Shape (facet,), m2; of a mesh with copies that of the first copy.
    normal
        Mean unit normal, shape (facet, 3).
    faces
        Rows of the triangles of each facet.
    """

    surfaces: Surfaces
    shades: RayTracer
    key: Index
    area_m2: Array
    normal: Array
    faces: tuple[Index, ...]

    def __len__(self) -> int:
        return len(self.key)

    @property
    def object(self) -> Index:
        """Number of each one's object, shape (facet,)."""
        return self.key // DIRECTIONS // len(self.surfaces.materials)

    @property
    def material(self) -> Index:
        """Number of each one's material, shape (facet,)."""
        return self.key // DIRECTIONS % len(self.surfaces.materials)

    @property
    def names(self) -> list[str]:
        """OBJECT:MATERIAL of each."""
        objects, materials = self.surfaces.objects, self.surfaces.materials
        return [
            f"{objects[o]}:{materials[m]}" for o, m in zip(self.object, self.material, strict=True)
        ]

    @cached_property
    def _of_row(self) -> Index:
        """Facet of each triangle that is there once."""
        facet_of_row = np.zeros(len(self.surfaces.mesh.faces), np.int64)
        for facet, faces in enumerate(self.faces):
            facet_of_row[faces] = facet
        return facet_of_row

    def of_faces(self, face: Index) -> Index:
        """Return the facet of each face, shape (face,): for a direction that a copy alone has, the
        nearest.
        """
        if len(face) and face.max() < len(self._of_row):
            return self._of_row[face]
        normal = self.surfaces.tracer.normals(face)
        key = _keys(self.surfaces, face & ROW, normal)
        facet = np.minimum(np.searchsorted(self.key, key), len(self.key) - 1)
        for missing_key in np.unique(key[self.key[facet] != key]):
            candidates = np.flatnonzero(self.key // DIRECTIONS == missing_key // DIRECTIONS)
            has_key = key == missing_key
            facet[has_key] = candidates[np.argmax(self.normal[candidates] @ normal[has_key][0])]
        return facet


def _keys(surfaces: Surfaces, row: Index, normal: Array) -> Index:
    body = surfaces.object_of[row] * len(surfaces.materials) + surfaces.material_of[row]
    return body * DIRECTIONS + direction_of(normal)


def facets_of(surfaces: Surfaces, shades: RayTracer | None = None) -> Facets:
    """Return the facets of surfaces; all of them hide the sun unless others are given."""
    area = surfaces.area_m2
    row = np.flatnonzero(area > 0.0)
    normal = surfaces.tracer.normals(row)
    key, facet_of_row = np.unique(_keys(surfaces, row, normal), return_inverse=True)
    order = np.argsort(facet_of_row, kind="stable")
    faces = np.split(row[order], np.cumsum(np.bincount(facet_of_row))[:-1])
    mean = np.stack(
        [np.bincount(facet_of_row, area[row] * normal[:, axis]) for axis in range(3)], axis=1
    )
    return Facets(
        surfaces=surfaces,
        shades=shades or surfaces.tracer,
        key=key,
        area_m2=np.bincount(facet_of_row, area[row]).astype(float),
        normal=mean / np.linalg.norm(mean, axis=1, keepdims=True),
        faces=tuple(faces),
    )


@dataclass(frozen=True, kw_only=True)
class Spots:
    """Points on outer sides of surfaces.

    Parameters
    ----------
    start_m, normal
        Where rays start, a little above the surface, and the outer unit normal, each of shape
        (spot, 3).
    """

    start_m: Array
    normal: Array

    @classmethod
    def on(cls, surfaces: Surfaces, face: Index, position_m: Array) -> "Spots":
        """Return spots at positions on faces."""
        normal = surfaces.tracer.normals(face)
        return cls(start_m=surfaces.tracer.ray_starts(face, position_m, normal), normal=normal)


def spots_of(facets: Facets, rng: np.random.Generator) -> Spots:
    """Return `LIMITS.points` spots of each facet, one facet after the other, even over its area."""
    corners, area = facets.surfaces.mesh.corners_m, facets.surfaces.area_m2
    chosen_faces = []
    for faces in facets.faces:
        total = np.cumsum(area[faces])
        area_position = (np.arange(LIMITS.points) + rng.random()) / LIMITS.points * total[-1]
        chosen_faces.append(
            faces[np.minimum(np.searchsorted(total, area_position), len(faces) - 1)]
        )
    face = np.concatenate(chosen_faces)
    first, second = SequenceSlice.random(len(facets), LIMITS.points, rng).pairs().reshape(-1, 2).T
    root = np.sqrt(first)
    weight = np.stack([1.0 - root, root * (1.0 - second), root * second], axis=1)
    return Spots.on(facets.surfaces, face, np.einsum("sc,sck->sk", weight, corners[face]))


def sun_cosines(shades: RayTracer, spots: Spots, sun: Array) -> Array:
    """Return the cosine of the sun's angle where it shines on spots, else 0, shape (time, spot).

    Parameters
    ----------
    shades, spots
        What hides the sun, and where.
    sun
        Directions of the sun, shape (time, 3).
    """
    cosines = np.maximum(sun @ spots.normal.T, 0.0) * (sun[:, 2] > 0.0)[:, None]
    for time, direction in enumerate(sun):
        lit = np.flatnonzero(cosines[time])
        if len(lit):
            hidden = shades.is_occluded(
                spots.start_m[lit], np.broadcast_to(direction, (len(lit), 3))
            )
            cosines[time, lit[hidden]] = 0.0
    return cosines


def view(surfaces: Surfaces, spots: Spots, sequence: SequenceSlice) -> tuple[Array, Index]:
    """Return the view of spots, sampled by rays of the cosine law.

    Returns
    -------
    rings
        Fraction of each ring of `RING_SINE` that is open sky, together the sky view factor, shape
        (spot, ring).
    face
        What each ray hits, `NOTHING` for sky or the ground's end, shape (spot, ray).
    """
    pairs = sequence.pairs()
    local = cosine_lobe(pairs.reshape(-1, 2)).reshape(*pairs.shape[:2], 3)
    directions = (local @ shading_frames(spots.normal)).reshape(-1, 3)
    face = surfaces.tracer.hits(np.repeat(spots.start_m, sequence.rays, axis=0), directions).face
    sky = np.flatnonzero((face == NOTHING) & (directions[:, 2] > 0.0))
    ring = np.minimum((directions[sky, 2] ** 2 * RINGS).astype(np.int64), RINGS - 1)
    count = np.bincount(sky // sequence.rays * RINGS + ring, minlength=len(pairs) * RINGS)
    return count.reshape(-1, RINGS) / sequence.rays, face.reshape(-1, sequence.rays)


@cache
def _open_rings() -> Array:
    """Return what planes see of each ring without obstacles, by the angle of their normal from the
    zenith.

    Shape (angle, ring), from 0 to 180 degrees.
    """
    edge = np.sqrt(np.arange(RINGS + 1) / RINGS)
    step = np.diff(edge)[:, None] / OPEN_HEIGHTS
    sine = edge[:-1, None] + step * (np.arange(OPEN_HEIGHTS) + 0.5)
    azimuth = 2.0 * np.pi * (np.arange(OPEN_TURNS) + 0.5) / OPEN_TURNS
    tilt = np.linspace(0.0, np.pi, OPEN_TILTS)[:, None, None, None]
    cosine = np.cos(tilt) * sine[..., None] + np.sin(tilt) * np.sqrt(
        1.0 - sine[..., None] ** 2
    ) * np.cos(azimuth)
    return (2.0 * step * np.maximum(cosine, 0.0).mean(axis=3)).sum(axis=2)


def open_rings(normal: Array) -> Array:
    """Return what planes of unit normals (point, 3) see of each ring without obstacles, shape
    (point, ring).
    """
    tilt_position = np.arccos(np.clip(normal[:, 2], -1.0, 1.0)) / np.pi * (OPEN_TILTS - 1)
    tilt_node = np.minimum(tilt_position.astype(np.int64), OPEN_TILTS - 2)
    fraction, table = (tilt_position - tilt_node)[:, None], _open_rings()
    return table[tilt_node] * (1.0 - fraction) + table[tilt_node + 1] * fraction


@dataclass(frozen=True, kw_only=True)
class Views:
    """View of spots, as weights that sum to 1.

    Parameters
    ----------
    rings
        Of each ring of the sky, shape (spot, ring).
    face, weight, range_m
        What each ray hits, `NOTHING` for sky or the ground's end, its weight where it hits, and how
        far away, m, shape (spot, ray).
    off_scene
        Below the horizon where the scene ends, shape (spot,).
    """

    rings: Array
    face: Index
    weight: Array
    range_m: Array
    off_scene: Array

    def surfaces(self) -> tuple[Index, Index, Array, Array]:
        """Return the spot, the face, the weight and the length of each ray that hits a surface."""
        spot, ray = np.nonzero(self.face != NOTHING)
        return spot, self.face[spot, ray], self.weight[spot, ray], self.range_m[spot, ray]


def precise_view(surfaces: Surfaces, spots: Spots, sequence: SequenceSlice) -> Views:
    """Return the view of spots, as `view`, with less noise where little of the sky is hidden.

    Notes
    -----
    The sky that a plane sees without obstacles, and what it sees below the horizon, are known. Rays
    find what hides the sky, and which surfaces lie below; where more than half of the sky is
    hidden, they find the open rest instead.
    """
    pairs, spot = sequence.pairs(), np.arange(len(spots.normal))[:, None]
    local = cosine_lobe(pairs.reshape(-1, 2)).reshape(*pairs.shape[:2], 3)
    directions = (local @ shading_frames(spots.normal)).reshape(-1, 3)
    hit = surfaces.tracer.hits(np.repeat(spots.start_m, sequence.rays, axis=0), directions)
    face = hit.face.reshape(-1, sequence.rays)
    height = directions[:, 2].reshape(face.shape)
    is_up, hits = height > 0.0, face != NOTHING
    unobstructed = open_rings(spots.normal)
    open_fraction = unobstructed.sum(axis=1)
    count = is_up.sum(axis=1)
    weight = np.where(
        is_up,
        (open_fraction / np.maximum(count, 1))[:, None],
        ((1.0 - open_fraction) / np.maximum(sequence.rays - count, 1))[:, None],
    )
    ring = np.minimum((height**2 * RINGS).astype(np.int64), RINGS - 1)
    hidden = (is_up & hits).sum(axis=1)
    by_rest = 2 * hidden > count
    is_counted = is_up & (hits ^ by_rest[:, None])
    ring_sums = np.bincount(
        (spot * RINGS + ring)[is_counted], weight[is_counted], len(face) * RINGS
    ).reshape(-1, RINGS)
    rings = np.where(by_rest[:, None], ring_sums, unobstructed - ring_sums)
    # Without a ray above or below the horizon, that part counts as open.
    return Views(
        rings=rings,
        face=face,
        weight=weight,
        range_m=hit.range_m.reshape(face.shape),
        off_scene=1.0 - rings.sum(axis=1) - np.where(hits, weight, 0.0).sum(axis=1),
    )


@dataclass(frozen=True, kw_only=True)
class Exposure:
    """View of facets, each the mean of its points.

    Parameters
    ----------
    rings
        Of each ring of the sky, shape (facet, ring).
    sees
        Fraction of the hemisphere in which one facet sees the other, cosine-weighted, shape (facet,
        facet).
    off_scene
        Fraction that is neither sky nor surface: below the horizon where the scene ends, shape
        (facet,).
    lit
        Mean cosine of the sun where it shines, shape (time, facet).
    """

    rings: Array
    sees: Array
    off_scene: Array
    lit: Array

    @property
    def sky(self) -> Array:
        """Sky view factor, shape (facet,)."""
        return self.rings.sum(axis=1)


def exposure_of(facets: Facets, sun: Array, rng: np.random.Generator) -> Exposure:
    """Return what facets see of sun (directions of shape (time, 3)), sky and each other."""
    spots, count = spots_of(facets, rng), len(facets)
    rings, face = view(
        facets.surfaces, spots, SequenceSlice.random(len(spots.normal), LIMITS.rays, rng)
    )
    rings = rings.reshape(count, LIMITS.points, RINGS).mean(axis=1)
    face = face.reshape(count, -1)
    viewer, ray = np.nonzero(face != NOTHING)
    seen_facet = facets.of_faces(face[viewer, ray])
    sees = np.bincount(viewer * count + seen_facet, minlength=count**2).reshape(count, count) / (
        LIMITS.points * LIMITS.rays
    )
    return Exposure(
        rings=rings,
        sees=sees,
        off_scene=np.maximum(1.0 - rings.sum(axis=1) - sees.sum(axis=1), 0.0),
        lit=sun_cosines(facets.shades, spots, sun)
        .reshape(len(sun), count, LIMITS.points)
        .mean(axis=2),
    )
