"""Lab targets as triangle meshes: bars, an edge, a pinhole with its holder, or the open port.

Lengths are in column pitches of the image; x runs right, y down, z away from the camera. The surfaces of a plate meet
without gap or overlap, or occlude each other. The outlines of the materials are stored, so that the renderer can use
more rays there.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.session import Kind
from labdata.target import Target
from simulate.radiance.scene import Holder

OPEN, MASK, RING = 0, 1, 2
BAR_LENGTH = 7.0
BARS = 4
EDGE_TILT_DEG, BAR_TILT_DEG = 5.0, 4.0
CIRCLE = 256
BEHIND_M = 1e-5
# Half the width of a plate, beyond any image.
FAR_PX = 4e3


@dataclass(frozen=True)
class TargetMesh:
    """Triangles of a target.

    Parameters
    ----------
    vertices
        Shape (vertex, 3), column pitches.
    faces
        Vertices of each triangle, shape (face, 3).
    material
        OPEN, MASK or RING for each triangle, shape (face,).
    outlines
        Polylines (x, y) where materials meet in the image, each of shape (point, 2), column pitches.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    material: NDArray[np.int64]
    outlines: tuple[NDArray[np.float64], ...]


def as_stood(kind: Kind, target: Target) -> Target:
    """Return a target with the bench's defaults for the number of bars and the tilt."""
    if kind == "bars":
        tilt = BAR_TILT_DEG if target.angle_deg is None else target.angle_deg
        return replace(target, bars=BARS if target.bars is None else target.bars, angle_deg=tilt)
    if kind == "edge":
        return replace(target, angle_deg=EDGE_TILT_DEG if target.angle_deg is None else target.angle_deg)
    return target


def target_mesh(kind: Kind, target: Target, holder: Holder, px_per_metre: float = 1500.0) -> TargetMesh:
    """Return the surfaces of a target centred on the origin.

    Parameters
    ----------
    kind
        "dark" is the plate without an opening, "flat" the open port.
    target
        Its fields of that kind; missing ones are as of `as_stood`, with a tilt that gives all phases to the pixels.
    holder
        Ring of a pinhole.
    px_per_metre
        Column pitches in a metre of the target's plane, for heights above it.

    Raises
    ------
    BadInput
        If the target lacks what its kind needs.
    """
    target = as_stood(kind, target)
    if kind == "bars":
        return _bars(target)
    if kind == "edge":
        assert target.angle_deg is not None, "a target as it stood has a tilt"
        return _edge(target.angle_deg)
    if kind == "point":
        return _pinhole(target, holder, px_per_metre)
    if kind in ("flat", "dark"):
        plate = _quad(-FAR_PX, FAR_PX, -FAR_PX, FAR_PX)
        return _triangulate([(plate, OPEN if kind == "flat" else MASK)], 0.0, ())
    raise BadInput(f"a lab target must be dark, flat, edge, bars or point, got {kind!r}")


def _bars(target: Target) -> TargetMesh:
    assert target.bars is not None and target.angle_deg is not None, "a target as it stood has both"
    if target.frequency_cy_per_px is None:
        raise BadInput("bars must have a frequency_cy_per_px, got none")
    count = target.bars
    width = 0.5 / target.frequency_cy_per_px
    top, bottom = -BAR_LENGTH * width / 2.0, BAR_LENGTH * width / 2.0
    edges = width * (np.arange(2 * count) - (2 * count - 1) / 2.0)
    left, right = edges[0], edges[-1]
    parts = [(_quad(a, b, top, bottom), OPEN if i % 2 == 0 else MASK) for i, (a, b) in enumerate(_pairs(edges))]
    parts += [
        (_quad(-FAR_PX, FAR_PX, -FAR_PX, top), MASK),
        (_quad(-FAR_PX, FAR_PX, bottom, FAR_PX), MASK),
        (_quad(-FAR_PX, left, top, bottom), MASK),
        (_quad(right, FAR_PX, top, bottom), MASK),
    ]
    outlines = tuple(np.vstack([_quad(a, b, top, bottom), [[a, top]]]) for a, b in _pairs(edges)[::2])
    return _triangulate(parts, target.angle_deg, outlines)


def _pairs(values: NDArray[np.floating]) -> list[tuple[float, float]]:
    return [(float(a), float(b)) for a, b in pairwise(values)]


def _edge(angle_deg: float) -> TargetMesh:
    parts = [(_quad(-FAR_PX, 0.0, -FAR_PX, FAR_PX), MASK), (_quad(0.0, FAR_PX, -FAR_PX, FAR_PX), OPEN)]
    return _triangulate(parts, angle_deg, (np.array([[0.0, -FAR_PX], [0.0, FAR_PX]]),))


def _pinhole(target: Target, holder: Holder, px_per_metre: float) -> TargetMesh:
    if target.pinhole_px is None or not target.pinhole_px > 0.0:
        raise BadInput(f"a point source must have a positive pinhole_px, got {target.pinhole_px}")
    turns = 2.0 * np.pi * np.arange(CIRCLE + 1) / CIRCLE
    # A polygon of this radius has the circle's area.
    swell = np.sqrt(2.0 * np.pi / CIRCLE / np.sin(2.0 * np.pi / CIRCLE))
    circle = swell * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    hole = 0.5 * target.pinhole_px * circle
    inner, outer = holder.inner_radius_px * circle, holder.outer_radius_px * circle
    disc = _triangulate([(np.vstack([[[0.0, 0.0]], hole[i : i + 2]]), OPEN) for i in range(CIRCLE)], 0.0, (hole,))
    plate = _triangulate([(_quad(-FAR_PX, FAR_PX, -FAR_PX, FAR_PX), MASK)], 0.0, ())
    ring = _triangulate(
        [(np.vstack([inner[i : i + 2], outer[[i + 1, i]]]), RING) for i in range(CIRCLE)], 0.0, (inner, outer)
    )
    # A plate cut into slivers around the hole would slow every ray: the open disc occludes the plate behind it instead.
    behind = BEHIND_M * px_per_metre
    return _stack_layers((disc, 0.0), (plate, behind), (ring, -holder.height_m * px_per_metre))


def _stack_layers(*layers: tuple[TargetMesh, float]) -> TargetMesh:
    """Stack surfaces at given depths, column pitches."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh, _ in layers)])
    return TargetMesh(
        np.vstack([mesh.vertices + np.array([0.0, 0.0, depth]) for mesh, depth in layers]),
        np.vstack([mesh.faces + start for (mesh, _), start in zip(layers, starts[:-1], strict=True)]),
        np.concatenate([mesh.material for mesh, _ in layers]),
        tuple(line for mesh, _ in layers for line in mesh.outlines),
    )


def _quad(left: float, right: float, top: float, bottom: float) -> NDArray[np.float64]:
    return np.array([[left, top], [right, top], [right, bottom], [left, bottom]])


def _triangulate(
    parts: list[tuple[NDArray[np.float64], int]], angle_deg: float, outlines: tuple[NDArray[np.float64], ...]
) -> TargetMesh:
    """Triangulate convex polygons and rotate them by an angle."""
    turn = np.deg2rad(angle_deg)
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    vertices, faces, material, start = [], [], [], 0
    for polygon, kind in parts:
        corners = polygon @ rotation
        vertices.append(np.column_stack([corners, np.zeros(len(corners))]))
        fan = [[start, start + i, start + i + 1] for i in range(1, len(corners) - 1)]
        faces += fan
        material += [kind] * len(fan)
        start += len(corners)
    turned = tuple(line @ rotation for line in outlines)
    return TargetMesh(np.vstack(vertices), np.array(faces), np.array(material), turned)
