"""Surfaces of a scene from its description: shapes, mesh files and material maps, in their poses."""

import os
import zlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.radiance.geometry.embree import Copied
from simulate.radiance.geometry.surfaces import Mesh, Surfaces, collect_surfaces, shape
from simulate.radiance.outdoor.scene import METRE, Object, OutdoorScene, Pose

Array = NDArray[np.floating]

# Each run of one material along a row becomes a rectangle; an image with more runs is not a map.
MOST_RUNS = 500_000


def split_by_material(path: Path, size_m: tuple[float, ...], materials: Sequence[str]) -> list[tuple[str, Mesh]]:
    """Return the parts of a plane of a size (x, y), m, one for each material of an image that covers it.

    The image has one channel of indices of the materials; its first row lies at +y, its first column at -x.

    Raises BadInput if the image cannot be read, contains other numbers, or changes too often for a map.
    """
    from labdata.importers import read_frames

    values = np.asarray(read_frames(path).data[0])
    wrong = values[(values < 0) | (values >= len(materials)) | (values != np.round(values))]
    if wrong.size:
        raise BadInput(
            f"a material map must hold whole numbers from 0 to {len(materials) - 1}, got {wrong.flat[0]:g} "
            f"in {path.name}"
        )
    row, first, last, number = _runs(values.astype(np.int64))
    if len(row) > MOST_RUNS:
        raise BadInput(
            f"a material map must change at most {MOST_RUNS} times along its rows, got {len(row)} in {path.name}"
        )
    rows, columns = values.shape
    x = np.stack([first, last], axis=1) / columns * size_m[0] - 0.5 * size_m[0]
    y = 0.5 * size_m[1] - np.stack([row, row + 1], axis=1) / rows * size_m[1]
    return [
        (name, _rectangles(x[number == which], y[number == which]))
        for which, name in enumerate(materials)
        if (number == which).any()
    ]


def _runs(values: NDArray[np.int64]) -> tuple[NDArray[np.int64], ...]:
    """Return row, first and last column and value of each run of one value along a row."""
    columns = values.shape[1]
    begins = np.ones(values.shape, bool)
    begins[:, 1:] = values[:, 1:] != values[:, :-1]
    place = np.flatnonzero(begins)
    row, first = place // columns, place % columns
    last = np.append(first[1:], 0)
    last[last == 0] = columns
    return row, first, last, values.ravel()[place]


def _rectangles(x: Array, y: Array) -> Mesh:
    """Return rectangles at z = 0 that face up, x from left to right and y from top to bottom, (rectangle, 2) each."""
    corners = np.stack([x[:, [0, 1, 1, 0]], y[:, [1, 1, 0, 0]], np.zeros((len(x), 4))], axis=-1)
    first = 4 * np.arange(len(x))[:, None]
    halves = [first + np.array(half) for half in ([0, 1, 2], [0, 2, 3])]
    return Mesh(corners.reshape(-1, 3), np.concatenate(halves))


# Fewest triangles of a mesh with gaps, so that gaps are small.
FINE = 400
# Copies with more triangles than this in total share one mesh: a triangle takes some 700 bytes.
SHARED_FROM = 500_000
KINDS = (".obj", ".ply", ".stl", ".glb")


def build_surfaces(scene: OutdoorScene) -> Surfaces:
    """Return the surfaces of a scene.

    Raises BadInput if a mesh file cannot be read, contains no triangle, or is open although its surface emits
    light; if an object with gaps has too few triangles.
    """
    glass = frozenset(surface.label for surface in scene.material if surface.pane_transmittance is not None)
    glowing = {surface.label for surface in scene.material if surface.glow_lm_per_m2 > 0.0}
    parts, copied, notes = [], [], []
    for thing in scene.object:
        poses = thing.instances or (thing,)
        mesh, own = _mesh(scene, thing)
        if own:
            notes.append(f"{thing.file} has {own}, which are not used: all of {thing.label!r} is {thing.material!r}")
        if thing.map is not None:
            pieces = split_by_material(scene.file(thing.map), thing.size_m, thing.map_materials)
            parts += [(thing.label, name, place_mesh(piece, pose)) for name, piece in pieces for pose in poses]
            continue
        if thing.file is not None and thing.material in glowing and not mesh.is_closed:
            raise BadInput(
                f"the mesh of an object that glows must be closed, so that it has an outer side, got an open one "
                f"in {thing.file} of {thing.label!r}"
            )
        if thing.gaps > 0.0:
            mesh = remove_triangles(mesh, thing.gaps, thing.label)
        # Emitters and glass are sampled by triangle, so that their copies are not shared.
        shared = thing.material not in glowing | glass and len(poses) * len(mesh.faces) > SHARED_FROM and len(poses) > 1
        if shared:
            copied.append((thing.label, thing.material, _copies(mesh, poses[1:])))
        parts += [(thing.label, thing.material, place_mesh(mesh, pose)) for pose in (poses[:1] if shared else poses)]
    return replace(collect_surfaces(parts, glass, tuple(copied)), notes=tuple(notes))


def _copies(mesh: Mesh, poses: tuple[Pose, ...]) -> Copied:
    """Return a mesh relative to its centre, for single precision, and the poses of its copies."""
    middle = 0.5 * (mesh.vertices_m.min(axis=0) + mesh.vertices_m.max(axis=0))
    turn = np.array([pose.scale * _rotation(pose) for pose in poses])
    shift = np.array([pose.position_m for pose in poses]) + turn @ middle
    return Copied(vertices_m=mesh.vertices_m - middle, faces=mesh.faces, turn=turn, shift_m=shift)


def remove_triangles(mesh: Mesh, gaps: float, label: str) -> Mesh:
    """Remove random triangles up to a fraction of the area, the same ones for the same label.

    Raises BadInput if the mesh has too few triangles for gaps among them.
    """
    if len(mesh.faces) < FINE:
        raise BadInput(
            f"an object with gaps must have at least {FINE} triangles, as a sphere has, got {len(mesh.faces)} "
            f"in {label!r}"
        )
    drawn = np.random.default_rng(zlib.crc32(label.encode())).permutation(len(mesh.faces))
    area = mesh.area_m2[drawn]
    stays = np.cumsum(area) > gaps * area.sum()
    return Mesh(mesh.vertices_m, mesh.faces[np.sort(drawn[stays])])


def place_mesh(mesh: Mesh, pose: Pose) -> Mesh:
    """Transform a mesh into a pose."""
    turned = pose.scale * mesh.vertices_m @ _rotation(pose).T
    return Mesh(turned + np.asarray(pose.position_m), mesh.faces)


def _rotation(pose: Pose) -> Array:
    """Return the rotation: roll about y, then pitch about x, then heading about z, clockwise from above."""
    roll, pitch, heading = np.deg2rad([pose.roll_deg, pose.pitch_deg, -pose.heading_deg])
    about_y = np.array([[np.cos(roll), 0, np.sin(roll)], [0, 1, 0], [-np.sin(roll), 0, np.cos(roll)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    about_z = np.array([[np.cos(heading), -np.sin(heading), 0], [np.sin(heading), np.cos(heading), 0], [0, 0, 1]])
    return about_z @ about_x @ about_y


def _mesh(scene: OutdoorScene, thing: Object) -> tuple[Mesh, str]:
    """Return the triangles of an object, and the materials in its file, in words."""
    if thing.shape is not None:
        return shape(thing.shape, thing.size_m), ""
    assert thing.file is not None and thing.unit is not None
    return _read(scene.file(thing.file), METRE[thing.unit])


def _read(path: Path, metre: float) -> tuple[Mesh, str]:
    if path.suffix.lower() not in KINDS:
        raise BadInput(f"a mesh file must be one of {', '.join(KINDS)}, got {path.name}")
    if not os.path.isfile(path):  # Path.is_file raises on names that no disk takes
        raise BadInput(f"a mesh file must exist to be read, got {path}")
    import trimesh

    try:
        loaded = trimesh.load_scene(path, process=False)
        mesh, own = loaded.to_mesh(), _own_materials([thing.visual for thing in loaded.geometry.values()])
        vertices, faces = np.array(mesh.vertices, float), np.array(mesh.faces, np.int64)
    except Exception as error:
        # The readers of the four formats raise many kinds of errors.
        raise BadInput(f"{path.name} must be a whole {path.suffix} mesh: {_first_line(error)}") from None
    if not len(faces):
        raise BadInput(f"a mesh must have triangles, got none in {path.name}")
    if vertices.shape[1:] != (3,):
        raise BadInput(f"the vertices of a mesh must have three coordinates, got {vertices.shape[1:]} in {path.name}")
    if not np.isfinite(vertices).all():
        raise BadInput(f"the vertices of a mesh must be finite, got others in {path.name}")
    if not (faces.min() >= 0 and faces.max() < len(vertices)):
        raise BadInput(f"the corners of a mesh must be among its {len(vertices)} vertices, got others in {path.name}")
    return Mesh(metre * vertices, faces), own


def _own_materials(visuals: list[Any]) -> str:
    """Return in words the colours in a file, which are not used because they have no near infrared."""
    made = [visual.material for visual in visuals if visual.defined and hasattr(visual, "material")]
    names = sorted({str(material.name) for material in made if material.name})
    words = [f"materials ({', '.join(names)})" if names else "materials"] if made else []
    if any(visual.defined and visual.kind in ("vertex", "face") for visual in visuals):
        words.append("colours")
    return " and ".join(words)


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
