"""All surfaces of a scene as triangles ready for rays, each knowing its object and its material."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.trace import Tracer, tracer
from simulate.radiance.world.shapes import Mesh, joined


@dataclass(frozen=True)
class Surfaces:
    """Triangles of a scene.

    Parameters
    ----------
    mesh
        All triangles, in the scene's coordinates.
    tracer
        The same ready for rays.
    object_of, material_of
        Number of the object and of the material of each triangle, shape (face,).
    objects, materials
        Their names.
    panes
        Panes of glass among the objects, which are traced by themselves; None without any.
    """

    mesh: Mesh
    tracer: Tracer
    object_of: NDArray[np.int64]
    material_of: NDArray[np.int64]
    objects: tuple[str, ...]
    materials: tuple[str, ...]
    panes: "Surfaces | None" = None

    @property
    def area_m2(self) -> NDArray[np.float64]:
        """Area of each triangle, shape (face,), m2."""
        return self.mesh.area_m2

    def __reduce__(self) -> tuple:
        # Embree's own tree cannot be sent to another process: it is built again there.
        mesh = self.mesh
        parts = (
            mesh.vertices_m,
            mesh.faces,
            self.object_of,
            self.material_of,
            self.objects,
            self.materials,
            self.panes,
        )
        return _rebuilt, parts


def surfaces(parts: list[tuple[str, str, Mesh]], glass: frozenset[str] = frozenset()) -> Surfaces:
    """Return the surfaces of objects: name, name of the material, and triangles of each; some materials are glass."""
    if any(material in glass for _, material, _ in parts):
        panes = surfaces([part for part in parts if part[1] in glass])
        return replace(surfaces([part for part in parts if part[1] not in glass]), panes=panes)
    objects = tuple(dict.fromkeys(name for name, _, _ in parts))
    materials = tuple(dict.fromkeys(material for _, material, _ in parts))
    counts = [len(mesh.faces) for _, _, mesh in parts]
    mesh = joined([mesh for _, _, mesh in parts])
    of_part = np.repeat(np.arange(len(parts)), counts)
    object_of = np.array([objects.index(name) for name, _, _ in parts], np.int64)[of_part] if parts else of_part
    material_of = np.array([materials.index(name) for _, name, _ in parts], np.int64)[of_part] if parts else of_part
    return _rebuilt(mesh.vertices_m, mesh.faces, object_of, material_of, objects, materials)


def _rebuilt(
    vertices_m: NDArray[np.float64],
    faces: NDArray[np.int64],
    object_of: NDArray[np.int64],
    material_of: NDArray[np.int64],
    objects: tuple[str, ...],
    materials: tuple[str, ...],
    panes: Surfaces | None = None,
) -> Surfaces:
    mesh = Mesh(vertices_m, faces)
    return Surfaces(mesh, tracer(vertices_m, faces), object_of, material_of, objects, materials, panes)
