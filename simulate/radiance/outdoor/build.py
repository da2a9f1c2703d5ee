"""Surfaces of a scene from its description: shapes, mesh files and material maps, in their
poses.
"""

import zlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from labdata.errors import BadInput
from labdata.file_io import require_regular
from simulate.arrays import Array, Index
from simulate.radiance.geometry.embree import Copied
from simulate.radiance.geometry.surfaces import Mesh, Surfaces, collect_surfaces, join_meshes, shape
from simulate.radiance.outdoor.objects import METRE, Object
from simulate.radiance.outdoor.poses import Pose, rotation_of
from simulate.radiance.outdoor.scene import OutdoorScene

# Each run of one material along a row becomes a rectangle; an image with more runs is not a map.
MOST_RUNS = 500_000


def _read_map(path: Path, count: int) -> Index:
    """Return the numbers of materials of an image, shape (row, col); refuse others than 0 to count
    - 1.
    """
    from labdata.importers import read_frames

    values = np.asarray(read_frames(path).data[0])
    invalid_values = values[(values < 0) | (values >= count) | (values != np.round(values))]
    if invalid_values.size:
        raise BadInput(
            f"a material map must hold whole numbers from 0 to {count - 1}, got "
            f"{invalid_values.flat[0]:g} in {path.name}"
        )
    return values.astype(np.int64)


def split_by_material(
    path: Path, size_m: tuple[float, ...], materials: Sequence[str]
) -> list[tuple[str, Mesh]]:
    """Return the parts of a plane of a size (x, y), m, one for each material of an image that
    covers it.

    The image has one channel of indices of the materials; its first row lies at +y, its first
    column at -x.

    Raises BadInput if the image cannot be read, contains other numbers, or changes too often for a
    map.
    """
    values = _read_map(path, len(materials))
    row, start_col, stop_col, number = _runs(values)
    if len(row) > MOST_RUNS:
        raise BadInput(
            f"a material map must change at most {MOST_RUNS} times along its rows, got {len(row)} "
            f"in {path.name}"
        )
    rows, columns = values.shape
    x = np.stack([start_col, stop_col], axis=1) / columns * size_m[0] - 0.5 * size_m[0]
    y = 0.5 * size_m[1] - np.stack([row, row + 1], axis=1) / rows * size_m[1]
    return [
        (name, _rectangles(x[number == index], y[number == index]))
        for index, name in enumerate(materials)
        if (number == index).any()
    ]


def _runs(values: Index) -> tuple[Index, ...]:
    """Return row, first and last column and value of each run of one value along a row."""
    columns = values.shape[1]
    is_start = np.ones(values.shape, bool)
    is_start[:, 1:] = values[:, 1:] != values[:, :-1]
    start_cells = np.flatnonzero(is_start)
    row, start_col = start_cells // columns, start_cells % columns
    stop_col = np.append(start_col[1:], 0)
    stop_col[stop_col == 0] = columns
    return row, start_col, stop_col, values.ravel()[start_cells]


def _rectangles(x: Array, y: Array) -> Mesh:
    """Return rectangles at z = 0 that face up, x from left to right and y from top to bottom,
    (rectangle, 2) each.
    """
    corners = np.stack([x[:, [0, 1, 1, 0]], y[:, [1, 1, 0, 0]], np.zeros((len(x), 4))], axis=-1)
    first_corner = 4 * np.arange(len(x))[:, None]
    halves = [first_corner + np.array(half) for half in ([0, 1, 2], [0, 2, 3])]
    return Mesh(corners.reshape(-1, 3), np.concatenate(halves))


# Fewest triangles of a mesh with gaps, so that gaps are small.
FINE = 400
# Copies with more triangles than this in total share one mesh: a triangle takes some 700 bytes.
SHARED_FROM = 500_000
KINDS = (".obj", ".ply", ".stl", ".glb")


def build_surfaces(scene: OutdoorScene, *, opaque: bool = False) -> Surfaces:
    """Return the surfaces of a scene; with `opaque`, as in the infrared, panes of glass are
    surfaces like others.

    Raises BadInput if a mesh file cannot be read, contains no triangle, or is open although its
    surface emits light; if an object with gaps has too few triangles.
    """
    panes = (
        []
        if opaque
        else [surface for surface in scene.material if surface.pane_transmittance is not None]
    )
    glass = frozenset(surface.label for surface in panes)
    emitter_labels = {surface.label for surface in scene.material if surface.glow_lm_per_m2 > 0.0}
    parts, copied, notes = [], [], []
    for scene_object in scene.object:
        poses = scene_object.instances or (scene_object,)
        pieces, unused_content = _pieces(scene, scene_object)
        notes += unused_content
        for material, mesh in pieces:
            if scene_object.file is not None and material in emitter_labels and not mesh.is_closed:
                raise BadInput(
                    "the mesh of an object that glows must be closed, so that it has an outer "
                    f"side, got an open one in {scene_object.file} of {scene_object.label!r}"
                )
            if scene_object.gaps > 0.0:
                mesh = remove_triangles(mesh, scene_object.gaps, scene_object.label)
            # Emitters and glass are sampled by triangle, so that their copies are not shared.
            is_shared = (
                material not in emitter_labels | glass
                and len(poses) * len(mesh.faces) > SHARED_FROM
                and len(poses) > 1
            )
            if is_shared:
                copied.append((scene_object.label, material, _copies(mesh, poses[1:])))
            parts += [
                (scene_object.label, material, place_mesh(mesh, pose))
                for pose in (poses[:1] if is_shared else poses)
            ]
    return replace(collect_surfaces(parts, glass, tuple(copied)), notes=tuple(notes))


def _copies(mesh: Mesh, poses: tuple[Pose, ...]) -> Copied:
    """Return a mesh relative to its centre, for single precision, and the poses of its copies."""
    centre = 0.5 * (mesh.vertices_m.min(axis=0) + mesh.vertices_m.max(axis=0))
    rotation = np.array([pose.scale * rotation_of(pose) for pose in poses])
    shift = np.array([pose.position_m for pose in poses]) + rotation @ centre
    return Copied(
        vertices_m=mesh.vertices_m - centre, faces=mesh.faces, turn=rotation, shift_m=shift
    )


def remove_triangles(mesh: Mesh, gaps: float, label: str) -> Mesh:
    """Remove random triangles up to a fraction of the area, the same ones for the same label.

    Raises BadInput if the mesh has too few triangles for gaps among them.
    """
    if len(mesh.faces) < FINE:
        raise BadInput(
            f"an object with gaps must have at least {FINE} triangles, as a sphere has, got "
            f"{len(mesh.faces)} in {label!r}"
        )
    order = np.random.default_rng(zlib.crc32(label.encode())).permutation(len(mesh.faces))
    area = mesh.area_m2[order]
    is_kept = np.cumsum(area) > gaps * area.sum()
    return Mesh(mesh.vertices_m, mesh.faces[np.sort(order[is_kept])])


def place_mesh(mesh: Mesh, pose: Pose) -> Mesh:
    """Transform a mesh into a pose."""
    vertices_m = pose.scale * mesh.vertices_m @ rotation_of(pose).T
    return Mesh(vertices_m + np.asarray(pose.position_m), mesh.faces)


def _pieces(scene: OutdoorScene, scene_object: Object) -> tuple[list[tuple[str, Mesh]], list[str]]:
    """Return the triangles of an object by materials of the scene, and what of its file is not
    used, in sentences.
    """
    if scene_object.map is not None and scene_object.file is None:
        return split_by_material(
            scene.file(scene_object.map), scene_object.size_m, scene_object.map_materials
        ), []
    if scene_object.map is not None and scene_object.file is not None:
        numbers = _read_map(scene.file(scene_object.map), len(scene_object.map_materials))
        return split_by_texture(
            scene.file(scene_object.file),
            METRE[scene_object.unit or "m"],
            numbers,
            scene_object.map_materials,
        ), []
    if scene_object.shape is not None:
        return [(scene_object.material, shape(scene_object.shape, scene_object.size_m))], []
    assert scene_object.file is not None and scene_object.unit is not None
    meshes, colours = read_mesh(scene.file(scene_object.file), METRE[scene_object.unit])
    if not scene_object.file_materials:
        named = [name for name in meshes if name]
        file_contents = [
            *([f"materials ({', '.join(sorted(named))})"] if named else []),
            *(["colours"] if colours else []),
        ]
        words = " and ".join(file_contents)
        note = (
            f"{scene_object.file} has {words}, which are not used: all of "
            f"{scene_object.label!r} is {scene_object.material!r}"
        )
        return [(scene_object.material, join_meshes(list(meshes.values())))], [
            note
        ] if file_contents else []
    file_names = ", ".join(sorted(repr(name) for name in meshes))
    for name in scene_object.file_materials:
        if name not in meshes:
            raise BadInput(
                f"file_materials must name materials of {scene_object.file}, {file_names}, got "
                f"{name!r}"
            )
    for name in meshes:
        if name not in scene_object.file_materials and not scene_object.material:
            raise BadInput(
                f"file_materials must name all materials of {scene_object.file} or leave the "
                f"others to a material, got none for {name!r} of {scene_object.label!r}"
            )
    return [
        (scene_object.file_materials.get(name, scene_object.material), mesh)
        for name, mesh in meshes.items()
    ], []


def split_by_texture(
    path: Path, metre: float, numbers: Index, materials: Sequence[str]
) -> list[tuple[str, Mesh]]:
    """Return the parts of a mesh file, one for each material of an image that its texture
    coordinates lay on it.

    The image's first row lies at v = 1, its first column at u = 0, and it repeats beyond. Triangles
    with several materials are cut into parts whose sides are as long as a pixel of the image at
    most.

    Raises BadInput if the mesh has no texture coordinates, or would have too many parts.
    """
    corners, uv = [], []
    for part in _load(path):
        texture_uv = getattr(part.visual, "uv", None)
        if texture_uv is None or len(texture_uv) != len(part.vertices):
            raise BadInput(
                f"a mesh with a map must have texture coordinates, got none in {path.name}"
            )
        _check_mesh(path.name, part.vertices, part.faces)
        corners.append(metre * np.asarray(part.vertices, float)[part.faces])
        uv.append(np.asarray(texture_uv, float)[part.faces])
    positions, texel = np.concatenate(corners), np.concatenate(uv) * numbers.shape[::-1]
    if not np.isfinite(texel).all():
        raise BadInput(f"texture coordinates must be finite, got others in {path.name}")
    sides = np.linalg.norm(texel - np.roll(texel, 1, axis=1), axis=2).max(axis=1)
    cuts = np.maximum(np.ceil(sides), 1.0)
    if (cuts**2).sum() > MOST_RUNS:
        raise BadInput(
            f"a map on a mesh must make at most {MOST_RUNS} parts, got {(cuts**2).sum():.0f} of "
            f"{path.name}; give an image of fewer pixels"
        )
    parts: list[tuple[Array, Index]] = []
    for count in np.unique(cuts.astype(np.int64)):
        triangles = np.flatnonzero(cuts == count)
        weights = _subdivision(int(count))
        col, row = np.floor(
            np.einsum("pk,fkx->xfp", weights.mean(axis=1), texel[triangles])
        ).astype(np.int64)
        material = numbers[(-1 - row) % numbers.shape[0], col % numbers.shape[1]]
        is_uniform = (material == material[:, :1]).all(axis=1)
        parts.append((positions[triangles[is_uniform]], material[is_uniform, 0]))
        small = np.einsum("pck,fkx->fpcx", weights, positions[triangles[~is_uniform]])
        parts.append((small.reshape(-1, 3, 3), material[~is_uniform].ravel()))
    all_corners, material = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    meshes = (
        (name, all_corners[material == number].reshape(-1, 3))
        for number, name in enumerate(materials)
    )
    return [
        (name, Mesh(xyz, np.arange(len(xyz)).reshape(-1, 3))) for name, xyz in meshes if len(xyz)
    ]


def _subdivision(count: int) -> Array:
    """Return barycentric coordinates of the corners of count**2 equal parts of a triangle, (part,
    corner, 3).
    """
    i, j = (axis.ravel() for axis in np.indices((count, count)))
    is_upright = (i + j) < count
    is_turned = (i + j) < count - 1
    upright = [
        np.stack([i[is_upright] + a, j[is_upright] + b], axis=1)
        for a, b in ((0, 0), (1, 0), (0, 1))
    ]
    turned = [
        np.stack([i[is_turned] + a, j[is_turned] + b], axis=1) for a, b in ((1, 0), (1, 1), (0, 1))
    ]
    two = np.concatenate([np.stack(upright, axis=1), np.stack(turned, axis=1)]) / count
    return np.concatenate([1.0 - two.sum(axis=2, keepdims=True), two], axis=2)


def read_mesh(path: Path, metre: float) -> tuple[dict[str, Mesh], bool]:
    """Return the triangles of a file by the names of its materials, "" without one, and whether it
    has colours.
    """
    parts = _load(path)
    parts_by_material = [
        (_material_of(part), np.array(part.vertices, float), np.array(part.faces, np.int64))
        for part in parts
    ]
    colours = any(part.visual.defined and part.visual.kind in ("vertex", "face") for part in parts)
    for _, vertices, faces in parts_by_material:
        _check_mesh(path.name, vertices, faces)
    names = dict.fromkeys(name for name, _, _ in parts_by_material)
    meshes = {
        name: [
            Mesh(metre * xyz, faces)
            for part_name, xyz, faces in parts_by_material
            if part_name == name
        ]
        for name in names
    }
    return {name: join_meshes(part_meshes) for name, part_meshes in meshes.items()}, colours


def _load(path: Path) -> list[Any]:
    """Return the parts of a mesh file, each with its own material, in the frame of the file."""
    if path.suffix.lower() not in KINDS:
        raise BadInput(f"a mesh file must be one of {', '.join(KINDS)}, got {path.name}")
    require_regular(path, "a mesh file")
    import trimesh

    try:
        parts: list[Any] = trimesh.load_scene(path, process=False).dump()
        triangles = sum(len(part.faces) for part in parts)
    except Exception as error:
        # The readers of the four formats raise many kinds of errors.
        line = (str(error).splitlines() or [type(error).__name__])[0]
        raise BadInput(f"{path.name} must be a whole {path.suffix} mesh: {line}") from None
    if not triangles:
        raise BadInput(f"a mesh must have triangles, got none in {path.name}")
    return parts


def _check_mesh(name: str, vertices: Array, faces: Index) -> None:
    if vertices.shape[1:] != (3,):
        raise BadInput(
            f"the vertices of a mesh must have three coordinates, got {vertices.shape[1:]} in "
            f"{name}"
        )
    if not np.isfinite(vertices).all():
        raise BadInput(f"the vertices of a mesh must be finite, got others in {name}")
    if len(faces) and not (faces.min() >= 0 and faces.max() < len(vertices)):
        raise BadInput(
            f"the corners of a mesh must be among its {len(vertices)} vertices, got others in "
            f"{name}"
        )


def _material_of(part: Any) -> str:
    """Return the name of the material of a part of a file; "" without one."""
    visual = part.visual
    return (
        str(visual.material.name or "unnamed")
        if visual.defined and hasattr(visual, "material")
        else ""
    )
