"""Targets as surfaces: four bars, an edge, a pinhole in its ring, or nothing but the open port.

Lengths are in column pitches of the picture; x runs right, y down, z towards the camera's far side. The surfaces of a
plate meet without gap or overlap, and the outlines of their materials are kept, so that whoever samples the picture
knows where it must look closely.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.session import Kind
from labdata.target import Target
from simulate.radiance.scene import Holder

OPEN, MASK, RING = 0, 1, 2
BAR_LENGTH = 7.0
EDGE_TILT_DEG, BAR_TILT_DEG = 5.0, 4.0
CIRCLE = 256
# Half the width of a plate: beyond any picture.
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
        Polylines (x, y) where materials meet in the picture, each of shape (point, 2), column pitches.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    material: NDArray[np.int64]
    outlines: tuple[NDArray[np.float64], ...]


def target_mesh(kind: Kind, target: Target, holder: Holder, ring_scale: float = 1.0) -> TargetMesh:
    """Return the surfaces of a target centred on the origin.

    Parameters
    ----------
    kind
        "dark" is the plate without an opening, "flat" the open port.
    target
        Its fields of that kind; an angle not given is a small tilt, so that all phases to the pixels occur.
    holder
        Ring of a pinhole.
    ring_scale
        Column pitches per unit of height towards the camera, for the ring's height.

    Raises
    ------
    BadInput
        If the target lacks what its kind needs.
    """
    if kind == "bars":
        return _bars(target)
    if kind == "edge":
        return _edge(EDGE_TILT_DEG if target.angle_deg is None else target.angle_deg)
    if kind == "point":
        return _pinhole(target, holder, ring_scale)
    if kind in ("flat", "dark"):
        plate = _quad(-FAR_PX, FAR_PX, -FAR_PX, FAR_PX)
        return _joined([(plate, OPEN if kind == "flat" else MASK)], 0.0, ())
    raise BadInput(f"a lab target must be dark, flat, edge, bars or point, got {kind!r}")


def _bars(target: Target) -> TargetMesh:
    count = 4 if target.bars is None else target.bars
    if target.frequency_cy_per_px is None:
        raise BadInput("bars must have a frequency_cy_per_px, got none")
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
    return _joined(parts, BAR_TILT_DEG if target.angle_deg is None else target.angle_deg, outlines)


def _pairs(values: NDArray[np.floating]) -> list[tuple[float, float]]:
    return [(float(a), float(b)) for a, b in pairwise(values)]


def _edge(angle_deg: float) -> TargetMesh:
    parts = [(_quad(-FAR_PX, 0.0, -FAR_PX, FAR_PX), MASK), (_quad(0.0, FAR_PX, -FAR_PX, FAR_PX), OPEN)]
    return _joined(parts, angle_deg, (np.array([[0.0, -FAR_PX], [0.0, FAR_PX]]),))


def _pinhole(target: Target, holder: Holder, ring_scale: float) -> TargetMesh:
    if target.pinhole_px is None or not target.pinhole_px > 0.0:
        raise BadInput(f"a point source must have a positive pinhole_px, got {target.pinhole_px}")
    turns = 2.0 * np.pi * np.arange(CIRCLE + 1) / CIRCLE
    # A polygon of this radius has the circle's area.
    swell = np.sqrt(2.0 * np.pi / CIRCLE / np.sin(2.0 * np.pi / CIRCLE))
    circle = swell * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    hole = 0.5 * target.pinhole_px * circle
    inner, outer = holder.inner_radius_px * circle, holder.outer_radius_px * circle
    height = -holder.height_m * ring_scale
    parts = [
        *((np.vstack([[[0.0, 0.0]], hole[i : i + 2]]), OPEN) for i in range(CIRCLE)),
        *((np.vstack([hole[i : i + 2], FAR_PX * circle[[i + 1, i]]]), MASK) for i in range(CIRCLE)),
    ]
    ring = [(np.vstack([inner[i : i + 2], outer[[i + 1, i]]]), RING) for i in range(CIRCLE)]
    flat = _joined(parts, 0.0, (hole,))
    raised = _joined(ring, 0.0, (inner, outer))
    lifted = raised.vertices + np.array([0.0, 0.0, height])
    return TargetMesh(
        np.vstack([flat.vertices, lifted]),
        np.vstack([flat.faces, raised.faces + len(flat.vertices)]),
        np.concatenate([flat.material, raised.material]),
        (*flat.outlines, *raised.outlines),
    )


def _quad(left: float, right: float, top: float, bottom: float) -> NDArray[np.float64]:
    return np.array([[left, top], [right, top], [right, bottom], [left, bottom]])


def _joined(
    parts: list[tuple[NDArray[np.float64], int]], angle_deg: float, outlines: tuple[NDArray[np.float64], ...]
) -> TargetMesh:
    """Fan each convex polygon into triangles and turn everything by an angle."""
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
