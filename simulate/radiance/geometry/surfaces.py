"""Surfaces of a scene: meshes of shapes, triangles with their object and material, and their ray
tracer.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from labdata.errors import BadInput
from simulate.arrays import Array, Index
from simulate.radiance.geometry.embree import Copied
from simulate.radiance.geometry.ray_tracer import RayTracer, tracer

# Corners of a round shape, and subdivisions of a sphere.
AROUND, SPHERE_CUTS = 48, 4
# Half the side of the innermost square of the ground, m; each square around it is twice as wide.
GROUND_CORE_M = 16.0


@dataclass(frozen=True)
class Mesh:
    """Triangles."""

    vertices_m: Array  # shape (vertex, 3), m
    faces: Index  # vertices of each triangle, counterclockwise seen from outside, shape (face, 3)

    @property
    def corners_m(self) -> Array:
        """Corners of each triangle, shape (face, corner, 3), m."""
        return self.vertices_m[self.faces]

    @property
    def area_m2(self) -> Array:
        """Area of each triangle, shape (face,), m2."""
        corners = self.corners_m
        return 0.5 * np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        )

    @property
    def is_closed(self) -> bool:
        """Whether each edge has one triangle on either side, with the same orientation, so that
        there is an inside.
        """
        edges = np.concatenate(
            [self.faces[:, [0, 1]], self.faces[:, [1, 2]], self.faces[:, [2, 0]]]
        )
        # Vertices at one position count as the first of them.
        _, first, index = np.unique(
            self.vertices_m.round(9), axis=0, return_index=True, return_inverse=True
        )
        vertex = first[index.reshape(-1)][edges]
        key, reverse_key = (
            vertex[:, 0] * len(self.vertices_m) + vertex[:, 1],
            vertex[:, 1] * len(self.vertices_m) + vertex[:, 0],
        )
        return len(np.unique(key)) == len(key) and np.array_equal(
            np.sort(key), np.sort(reverse_key)
        )


def join_meshes(meshes: list[Mesh]) -> Mesh:
    """Return the union of meshes."""
    if not meshes:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    starts = np.cumsum([0, *(len(mesh.vertices_m) for mesh in meshes[:-1])])
    return Mesh(
        np.concatenate([mesh.vertices_m for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]),
    )


def shape(name: str, size_m: tuple[float, ...]) -> Mesh:
    """Return a shape by name; `SIZES` names its sizes.

    Raises BadInput if there is no such shape, or a size is missing or not positive.
    """
    if name not in SIZES:
        raise BadInput(f"a shape must be one of {', '.join(SIZES)}, got {name!r}")
    build, meaning = SIZES[name]
    if len(size_m) != len(meaning):
        raise BadInput(f"the size_m of a {name} must be [{', '.join(meaning)}], got {list(size_m)}")
    if not all(size > 0.0 for size in size_m):
        raise BadInput(f"the size_m of a {name} must be positive, got {list(size_m)}")
    return build(*size_m)


def box(x: float, y: float, z: float) -> Mesh:
    """Box standing on z = 0, centred on the z axis."""
    corner = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)], float)
    vertices = (corner - [0.5, 0.5, 0.0]) * [x, y, z]
    quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    return Mesh(vertices, _cut(quads))


def plane(x: float, y: float) -> Mesh:
    """Rectangle at z = 0 that faces up."""
    vertices = np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]], float) / 2.0
    return Mesh(vertices, _cut([[0, 1, 2, 3]]))


def disc(radius: float) -> Mesh:
    """Disc at z = 0 that faces up; a polygon of the circle's area."""
    swell = np.sqrt(2.0 * np.pi / AROUND / np.sin(2.0 * np.pi / AROUND))
    vertices = np.vstack([_circle(radius * swell, 0.0), [[0.0, 0.0, 0.0]]])
    return Mesh(vertices, np.array([[i, (i + 1) % AROUND, AROUND] for i in range(AROUND)]))


def cylinder(radius: float, height: float) -> Mesh:
    """Closed upright cylinder on z = 0."""
    vertices = np.vstack(
        [_circle(radius, 0.0), _circle(radius, height), [[0, 0, 0], [0, 0, height]]]
    )
    faces = []
    for i in range(AROUND):
        j = (i + 1) % AROUND
        faces += [[i, j, AROUND + j], [i, AROUND + j, AROUND + i]]
        faces += [[j, i, 2 * AROUND], [AROUND + i, AROUND + j, 2 * AROUND + 1]]
    return Mesh(vertices, np.array(faces))


def cone(radius: float, height: float) -> Mesh:
    """Closed upright cone on z = 0."""
    vertices = np.vstack([_circle(radius, 0.0), [[0.0, 0.0, 0.0], [0.0, 0.0, height]]])
    side = [[i, (i + 1) % AROUND, AROUND + 1] for i in range(AROUND)]
    floor = [[(i + 1) % AROUND, i, AROUND] for i in range(AROUND)]
    return Mesh(vertices, np.array(side + floor))


def sphere(radius: float) -> Mesh:
    """Sphere about the origin, of 5120 triangles."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=SPHERE_CUTS, radius=radius)
    return Mesh(np.array(ball.vertices, float), np.array(ball.faces, np.int64))


def ground(side: float) -> Mesh:
    """Square at z = 0 that faces up, with small triangles at the centre and large ones far away.

    The clearance of a ray start grows with the size of its triangle (`CLEARANCE_SHARE`), and must
    be small at the centre, where objects are.
    """
    halves = [side / 2.0]
    while halves[-1] > 2.0 * GROUND_CORE_M:
        halves.append(halves[-1] / 2.0)
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    quads = [[4 * (len(halves) - 1) + i for i in range(4)]]
    for ring in range(len(halves) - 1):
        outer, inner = 4 * ring, 4 * (ring + 1)
        quads += [
            [outer + i, outer + (i + 1) % 4, inner + (i + 1) % 4, inner + i] for i in range(4)
        ]
    return Mesh(np.concatenate([half * square for half in halves]), _cut(quads))


def shed(width: float, depth: float, eaves: float, ridge: float) -> Mesh:
    """Shed with a pitched roof, open towards -y: three walls, two roof slopes and a gable behind,
    0.3 m thick.

    Its inside is hollow; the ridge runs along y, and the front edge of the roof lies in the open
    face.
    """
    thick = 0.3
    outer = np.array(
        [
            [-0.5 * width, 0],
            [-0.5 * width, eaves],
            [0, ridge],
            [0.5 * width, eaves],
            [0.5 * width, 0],
        ]
    )
    drop = np.array(
        [[thick, 0], [thick, -0.5 * thick], [0, -thick], [-thick, -0.5 * thick], [-thick, 0]]
    )
    inner = outer + drop
    front, rear, inner_rear = -0.5 * depth, 0.5 * depth, 0.5 * depth - thick
    sides = ((outer, front), (outer, rear), (inner, front), (inner, inner_rear))
    rings = [np.insert(outline, 1, y, axis=1) for outline, y in sides]
    of_front, of_back, in_front, in_back = (5 * i for i in range(4))
    quads = []
    for i in range(4):
        quads += [
            [of_front + i + 1, of_back + i + 1, of_back + i, of_front + i],
            [in_front + i, in_back + i, in_back + i + 1, in_front + i + 1],
            [of_front + i, in_front + i, in_front + i + 1, of_front + i + 1],
        ]
    fans = [[of_back + i for i in (0, 1, 2, 3, 4)], [in_back + i for i in (4, 3, 2, 1, 0)]]
    fans += [
        [of_front, of_back, in_back, in_front],
        [of_back + 4, of_front + 4, in_front + 4, in_back + 4],
    ]
    fans += [[of_back, of_back + 4, in_back + 4, in_back]]
    return Mesh(np.concatenate(rings), _cut(quads + fans))


def _circle(radius: float, z: float) -> Array:
    azimuth = 2.0 * np.pi * np.arange(AROUND) / AROUND
    return np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.full(AROUND, z)])


def _cut(polygons: list[list[int]]) -> Index:
    """Triangulate convex polygons."""
    return np.array(
        [[p[0], p[i], p[i + 1]] for p in polygons for i in range(1, len(p) - 1)], np.int64
    )


SIZES: dict[str, tuple[Callable[..., Mesh], tuple[str, ...]]] = {
    "box": (box, ("x", "y", "z")),
    "plane": (plane, ("x", "y")),
    "disc": (disc, ("radius",)),
    "cylinder": (cylinder, ("radius", "height")),
    "cone": (cone, ("radius", "height")),
    "sphere": (sphere, ("radius",)),
    "ground": (ground, ("side",)),
    "shed": (shed, ("width", "depth", "eaves", "ridge")),
}


@dataclass(frozen=True)
class Surfaces:
    """Triangles of a scene."""

    mesh: Mesh  # triangles without copies, in scene coordinates
    # Number of the object and of the material of each triangle, of `mesh` and then of `copied`,
    # shape (row,).
    object_of: Index
    material_of: Index
    # Their names.
    objects: tuple[str, ...]
    materials: tuple[str, ...]
    copied: tuple[Copied, ...] = ()  # meshes with copies, stored once
    # Panes of glass among the objects, with a ray tracer of their own; None without any.
    panes: "Surfaces | None" = None
    notes: tuple[str, ...] = ()  # unused content of files, in sentences

    @property
    def area_m2(self) -> Array:
        """Area of each triangle of `mesh`, shape (face,), m2."""
        return self.mesh.area_m2

    @cached_property
    def tracer(self) -> RayTracer:
        """Ray tracer of all surfaces."""
        return tracer(self.mesh.vertices_m, self.mesh.faces, self.copied)

    def __getstate__(self) -> dict:
        # Embree's scene cannot be pickled: it is built again.
        return {name: value for name, value in vars(self).items() if name != "tracer"}

    def triangles_near(self, position_m: Array, radius_m: float) -> Iterator[tuple[Array, str]]:
        """Yield triangles that a sphere may touch, in parts (face, corner, 3), m, and names of
        their objects.
        """
        corners = self.mesh.corners_m
        close = _boxes_touch(corners, position_m, radius_m)
        for number in np.unique(self.object_of[close]):
            yield corners[close[self.object_of[close] == number]], self.objects[number]
        row = len(self.mesh.faces)
        for mesh in self.copied:
            size = np.cbrt(np.linalg.det(mesh.turn))
            # Centre of the sphere in the frame of each copy.
            centre_in_copy = (
                np.einsum("cji,cj->ci", mesh.turn, position_m - mesh.shift_m) / size[:, None] ** 2
            )
            low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
            copy_radius = (radius_m / size)[:, None]
            for copy in np.flatnonzero(
                ((centre_in_copy > low - copy_radius) & (centre_in_copy < high + copy_radius)).all(
                    axis=1
                )
            ):
                vertices = mesh.vertices_m @ mesh.turn[copy].T + mesh.shift_m[copy]
                close = _boxes_touch(vertices[mesh.faces], position_m, radius_m)
                if len(close):
                    yield vertices[mesh.faces[close]], self.objects[self.object_of[row]]
            row += len(mesh.faces)


def _boxes_touch(corners_m: Array, position_m: Array, radius_m: float) -> Index:
    """Return which triangles (face, corner, 3) have bounding boxes that overlap a sphere's."""
    overlaps = (corners_m.min(axis=1) <= position_m + radius_m) & (
        corners_m.max(axis=1) >= position_m - radius_m
    )
    return np.flatnonzero(overlaps.all(axis=1))


def collect_surfaces(
    parts: list[tuple[str, str, Mesh]],
    glass: frozenset[str] = frozenset(),
    copied: tuple[tuple[str, str, Copied], ...] = (),
) -> Surfaces:
    """Return the surfaces of objects: name, name of the material, and triangles of each; some
    materials are glass.

    Meshes with copies (`copied`) are not of glass, and the first of each is one of the parts.
    """
    if any(material in glass for _, material, _ in parts):
        panes = collect_surfaces([part for part in parts if part[1] in glass])
        return replace(
            collect_surfaces([part for part in parts if part[1] not in glass], copied=copied),
            panes=panes,
        )
    objects = tuple(dict.fromkeys(name for name, _, _ in parts))
    materials = tuple(dict.fromkeys(material for _, material, _ in parts))
    bodies = [*parts, *copied]
    counts = [len(mesh.faces) for _, _, mesh in bodies]
    mesh = join_meshes([mesh for _, _, mesh in parts])
    of_part = np.repeat(np.arange(len(bodies)), counts)
    object_of = (
        np.array([objects.index(name) for name, _, _ in bodies], np.int64)[of_part]
        if bodies
        else of_part
    )
    material_of = (
        np.array([materials.index(name) for _, name, _ in bodies], np.int64)[of_part]
        if bodies
        else of_part
    )
    copies = tuple(mesh for _, _, mesh in copied)
    return Surfaces(mesh, object_of, material_of, objects, materials, copies)
