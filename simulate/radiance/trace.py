"""Rays against surfaces, by Embree.

Embree computes in single precision. Surfaces are therefore moved to the middle of the scene, places where rays hit are
found again in double precision on the plane of the triangle, and a ray that starts on a surface starts a little above
it, by more than what single precision gets wrong there.
"""

from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulate.radiance.embree import EmbreeScene

# A ray starts at least so far above the surface it leaves, m, or so large a share of the coordinates there. Measured on
# a scene of 60 m, shifted by up to 10 km: no ray then hits its own triangle.
CLEARANCE_M, CLEARANCE_SHARE = 1e-4, 3e-6
NOTHING = -1


@dataclass(frozen=True)
class Hits:
    """Where rays hit.

    Parameters
    ----------
    face
        Triangle that each ray hits first, `NOTHING` for none, shape (ray,).
    range_m
        Distance to it along a direction of unit length, infinite for none, shape (ray,), m.
    """

    face: NDArray[np.int64]
    range_m: NDArray[np.float64]

    @property
    def met(self) -> NDArray[np.int64]:
        """Numbers of the rays that hit something."""
        return np.flatnonzero(self.face != NOTHING)


@dataclass(frozen=True)
class Tracer:
    """Surfaces ready to be hit.

    Parameters
    ----------
    scene
        The embree scene; None without a triangle.
    centre_m
        Place that the embree scene has in its middle, shape (3,), m.
    corner_m, normal
        First corner and unit normal of each triangle, shape (face, 3).
    clearance_m
        How far above each triangle a ray starts, shape (face,), m.
    """

    scene: EmbreeScene | None
    centre_m: NDArray[np.float64]
    corner_m: NDArray[np.float64]
    normal: NDArray[np.float64]
    clearance_m: NDArray[np.float64]

    def first_hit(self, origin_m: NDArray[np.floating], direction: NDArray[np.floating]) -> NDArray[np.int64]:
        """Return the triangle that each ray hits first, `NOTHING` for none, shape (ray,). Rays have shape (ray, 3)."""
        return self.hits(origin_m, direction).face

    def hits(self, origin_m: NDArray[np.floating], direction: NDArray[np.floating]) -> Hits:
        """Return where rays of unit direction hit first, on the plane of the triangle in double precision."""
        count = len(origin_m)
        if self.scene is None:
            return Hits(np.full(count, NOTHING, np.int64), np.full(count, np.inf))
        planes = (self.corner_m, self.normal)
        return Hits(*self.scene.hits(planes, _plain(origin_m), _plain(direction)))

    def blocked(
        self, origin_m: NDArray[np.floating], direction: NDArray[np.floating], reach: ArrayLike | None = None
    ) -> NDArray[np.bool_]:
        """Return whether anything stands in each ray's way, shape (ray,).

        Parameters
        ----------
        origin_m, direction
            Rays, each of shape (ray, 3).
        reach
            How far to look, in lengths of the direction, one number or shape (ray,); without end if None.
        """
        if self.scene is None:
            return np.zeros(len(origin_m), np.bool_)
        limits = np.full(len(origin_m), np.inf if reach is None else reach, np.float64)
        return self.scene.blocked(_plain(origin_m), _plain(direction), limits)

    def facing(
        self, face: NDArray[np.integer], direction: NDArray[np.floating]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return normals of triangles towards where rays (ray, 3) come from, and the cosines to them, shape (ray,)."""
        normal = self.normal[face]
        cosine = -np.einsum("ij,ij->i", normal, direction)
        return np.where(cosine < 0.0, -1.0, 1.0)[:, None] * normal, np.abs(cosine)

    def above(
        self, face: NDArray[np.integer], place_m: NDArray[np.floating], side: NDArray[np.floating]
    ) -> NDArray[np.float64]:
        """Return places on triangles moved off them towards a side, for rays that start there.

        Parameters
        ----------
        face, place_m
            Triangle, shape (place,), and place on it, shape (place, 3), m.
        side
            Normal of the triangle, pointing to the side where the ray goes, shape (place, 3).
        """
        # Column by column: NumPy takes ten times as long over rows of three.
        away = reduce(np.maximum, np.abs(place_m - self.centre_m).T)
        shift = np.maximum(self.clearance_m[face], CLEARANCE_SHARE * away)
        return place_m + shift[:, None] * side


def tracer(vertices_m: NDArray[np.floating], faces: NDArray[np.integer]) -> Tracer:
    """Return a tracer of a mesh: vertices (vertex, 3) in m, faces (face, 3)."""
    vertices, faces = np.asarray(vertices_m, float).reshape(-1, 3), np.asarray(faces, np.int64).reshape(-1, 3)
    corners = vertices[faces]
    if not len(faces):
        return Tracer(None, np.zeros(3), corners[:, 0], np.zeros((0, 3)), np.zeros(0))
    centre = 0.5 * (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1)))
    scene = EmbreeScene(vertices, faces, centre)
    extent = np.abs(corners - centre).max(axis=(1, 2))
    return Tracer(
        scene,
        centre,
        np.ascontiguousarray(corners[:, 0]),
        normals(corners),
        np.maximum(CLEARANCE_M, CLEARANCE_SHARE * extent),
    )


def normals(corners_m: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return unit normals of triangles (face, corner, 3), zero for those without area, shape (face, 3)."""
    across = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    length = np.linalg.norm(across, axis=1, keepdims=True)
    return np.divide(across, length, out=np.zeros_like(across), where=length > 0.0)


def _plain(rays: NDArray[np.floating]) -> NDArray[np.float64]:
    return np.ascontiguousarray(rays, np.float64)
