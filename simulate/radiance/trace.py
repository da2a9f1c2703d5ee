"""Rays against surfaces, through embreex called directly: several times faster than through trimesh."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

CHUNK = 65536


@dataclass(frozen=True)
class Tracer:
    """Surfaces ready to be hit.

    Parameters
    ----------
    scene
        The embree scene.
    faces
        Number of triangles; a ray that hits none reports -1.
    """

    scene: Any
    faces: int

    def first_hit(self, origin_m: NDArray[np.floating], direction: NDArray[np.floating]) -> NDArray[np.int64]:
        """Return the triangle that each ray hits first, -1 for none, shape (ray,). Rays have shape (ray, 3)."""
        return self._run(origin_m, direction, "INTERSECT")

    def blocked(self, origin_m: NDArray[np.floating], direction: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Return whether anything stands in each ray's way, shape (ray,). Rays have shape (ray, 3)."""
        return self._run(origin_m, direction, "OCCLUDED") == 0

    def _run(self, origin_m: NDArray[np.floating], direction: NDArray[np.floating], query: str) -> NDArray[np.int64]:
        origin = np.ascontiguousarray(origin_m, np.float32)
        towards = np.ascontiguousarray(direction, np.float32)
        found = [
            self.scene.run(origin[i : i + CHUNK], towards[i : i + CHUNK], query=query)
            for i in range(0, len(origin), CHUNK)
        ]
        return np.concatenate(found).astype(np.int64) if found else np.empty(0, np.int64)


def tracer(vertices_m: NDArray[np.floating], faces: NDArray[np.integer]) -> Tracer:
    """Return a tracer of a mesh: vertices (vertex, 3) in m, faces (face, 3)."""
    import trimesh
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    mesh = trimesh.Trimesh(vertices_m, faces, process=False)
    scene = EmbreeScene()
    TriangleMesh(scene, np.asarray(mesh.triangles, np.float32))
    return Tracer(scene, len(mesh.faces))
