"""Surfaces of a scene: triangles with their object and material, and their ray tracer."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.geometry.embree import Copied
from simulate.radiance.geometry.ray_tracer import RayTracer, tracer
from simulate.radiance.geometry.shapes import Mesh, join_meshes


@dataclass(frozen=True)
class Surfaces:
    """Triangles of a scene.

    Parameters
    ----------
    mesh
        Triangles without copies, in scene coordinates.
    tracer
        Ray tracer of all surfaces.
    object_of, material_of
        Number of the object and of the material of each triangle, of `mesh` and then of `copied`, shape (row,).
    objects, materials
        Their names.
    copied
        Meshes with copies, stored once.
    panes
        Panes of glass among the objects, with a ray tracer of their own; None without any.
    notes
        Unused content of files, in sentences.
    """

    mesh: Mesh
    tracer: RayTracer
    object_of: NDArray[np.int64]
    material_of: NDArray[np.int64]
    objects: tuple[str, ...]
    materials: tuple[str, ...]
    copied: tuple[Copied, ...] = ()
    panes: "Surfaces | None" = None
    notes: tuple[str, ...] = ()

    @property
    def area_m2(self) -> NDArray[np.float64]:
        """Area of each triangle of `mesh`, shape (face,), m2."""
        return self.mesh.area_m2

    def __reduce__(self) -> tuple:
        # Embree's scene cannot be pickled: it is rebuilt.
        mesh = self.mesh
        parts = (
            mesh.vertices_m,
            mesh.faces,
            self.object_of,
            self.material_of,
            self.objects,
            self.materials,
            self.copied,
            self.panes,
        )
        return _rebuilt, parts

    def near(self, place_m: NDArray[np.floating], radius_m: float) -> Iterator[tuple[NDArray[np.float64], str]]:
        """Yield triangles that a sphere may touch, in parts (face, corner, 3), m, and names of their objects."""
        corners = self.mesh.corners_m
        close = _boxes_touch(corners, place_m, radius_m)
        for number in np.unique(self.object_of[close]):
            yield corners[close[self.object_of[close] == number]], self.objects[number]
        row = len(self.mesh.faces)
        for mesh in self.copied:
            size = np.cbrt(np.linalg.det(mesh.turn))
            # Centre of the sphere in the frame of each copy.
            there = np.einsum("cji,cj->ci", mesh.turn, place_m - mesh.shift_m) / size[:, None] ** 2
            low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
            reach = (radius_m / size)[:, None]
            for copy in np.flatnonzero(((there > low - reach) & (there < high + reach)).all(axis=1)):
                placed = mesh.vertices_m @ mesh.turn[copy].T + mesh.shift_m[copy]
                close = _boxes_touch(placed[mesh.faces], place_m, radius_m)
                if len(close):
                    yield placed[mesh.faces[close]], self.objects[self.object_of[row]]
            row += len(mesh.faces)


def _boxes_touch(corners_m: NDArray[np.float64], place_m: NDArray[np.floating], radius_m: float) -> NDArray[np.int64]:
    """Return which triangles (face, corner, 3) have bounding boxes that overlap a sphere's."""
    near = (corners_m.min(axis=1) <= place_m + radius_m) & (corners_m.max(axis=1) >= place_m - radius_m)
    return np.flatnonzero(near.all(axis=1))


def collect_surfaces(
    parts: list[tuple[str, str, Mesh]],
    glass: frozenset[str] = frozenset(),
    copied: tuple[tuple[str, str, Copied], ...] = (),
) -> Surfaces:
    """Return the surfaces of objects: name, name of the material, and triangles of each; some materials are glass.

    Meshes with copies (`copied`) are not of glass, and the first of each is one of the parts.
    """
    if any(material in glass for _, material, _ in parts):
        panes = collect_surfaces([part for part in parts if part[1] in glass])
        return replace(collect_surfaces([part for part in parts if part[1] not in glass], copied=copied), panes=panes)
    objects = tuple(dict.fromkeys(name for name, _, _ in parts))
    materials = tuple(dict.fromkeys(material for _, material, _ in parts))
    every = [*parts, *copied]
    counts = [len(mesh.faces) for _, _, mesh in every]
    mesh = join_meshes([mesh for _, _, mesh in parts])
    of_part = np.repeat(np.arange(len(every)), counts)
    object_of = np.array([objects.index(name) for name, _, _ in every], np.int64)[of_part] if every else of_part
    material_of = np.array([materials.index(name) for _, name, _ in every], np.int64)[of_part] if every else of_part
    together = tuple(mesh for _, _, mesh in copied)
    return _rebuilt(mesh.vertices_m, mesh.faces, object_of, material_of, objects, materials, together)


def _rebuilt(
    vertices_m: NDArray[np.float64],
    faces: NDArray[np.int64],
    object_of: NDArray[np.int64],
    material_of: NDArray[np.int64],
    objects: tuple[str, ...],
    materials: tuple[str, ...],
    copied: tuple[Copied, ...] = (),
    panes: Surfaces | None = None,
) -> Surfaces:
    mesh, trace = Mesh(vertices_m, faces), tracer(vertices_m, faces, copied)
    return Surfaces(mesh, trace, object_of, material_of, objects, materials, copied, panes)
