"""Lab targets as triangle meshes (bars, an edge, a pinhole with its holder, or the open port), and their renderer.

Lengths are in column pitches of the image; x runs right, y down, z away from the camera. The surfaces of a plate meet
without gap or overlap, or occlude each other. The renderer uses many rays in cells where materials meet.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.session import Kind
from labdata.target import Target
from simulate.radiance.cube import RadianceCube
from simulate.radiance.geometry.ray_tracer import RayTracer, tracer
from simulate.radiance.integrator.sampling import R2
from simulate.radiance.scene import Holder, LabScene
from simulate.radiance.spectrum import luminous_efficiency, planck

Array = NDArray[np.floating]
OPEN, MASK, RING = 0, 1, 2
CIRCLE = 256
# Half the width of a plate, beyond any image.
FAR_PX = 4e3


@dataclass(frozen=True)
class TargetMesh:
    """Triangles of a target."""

    vertices: Array  # shape (vertex, 3), column pitches
    faces: NDArray[np.int64]  # vertices of each triangle, shape (face, 3)
    material: NDArray[np.int64]  # OPEN, MASK or RING for each triangle, shape (face,)
    # Polylines (x, y) where materials meet in the image, each of shape (point, 2), column pitches.
    outlines: tuple[Array, ...]


def as_stood(kind: Kind, target: Target) -> Target:
    """Return a target with the bench's defaults for the number of bars and the tilt."""
    if kind == "bars":
        tilt = 4.0 if target.angle_deg is None else target.angle_deg
        return replace(target, bars=4 if target.bars is None else target.bars, angle_deg=tilt)
    if kind == "edge":
        return replace(target, angle_deg=5.0 if target.angle_deg is None else target.angle_deg)
    return target


def target_mesh(kind: Kind, target: Target, holder: Holder, px_per_metre: float = 1500.0) -> TargetMesh:
    """Return the surfaces of a target centred on the origin: "dark" is the plate without an opening, "flat" the port.

    Missing fields of the target are as of `as_stood`, with a tilt that gives all phases to the pixels; `px_per_metre`
    are column pitches in a metre of its plane, for heights above it. Raises BadInput if the target lacks what its kind
    needs.
    """
    target = as_stood(kind, target)
    if kind == "bars":
        return _bars(target)
    if kind == "edge":
        assert target.angle_deg is not None, "a target as it stood has a tilt"
        parts = [(_quad(-FAR_PX, 0.0, -FAR_PX, FAR_PX), MASK), (_quad(0.0, FAR_PX, -FAR_PX, FAR_PX), OPEN)]
        return _triangulate(parts, target.angle_deg, (np.array([[0.0, -FAR_PX], [0.0, FAR_PX]]),))
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
    top, bottom = -7.0 * width / 2.0, 7.0 * width / 2.0
    edges = width * (np.arange(2 * count) - (2 * count - 1) / 2.0)
    left, right = edges[0], edges[-1]
    parts = [
        (_quad(a, b, top, bottom), OPEN if i % 2 == 0 else MASK) for i, (a, b) in enumerate(pairwise(edges.tolist()))
    ]
    parts += [
        (_quad(-FAR_PX, FAR_PX, -FAR_PX, top), MASK),
        (_quad(-FAR_PX, FAR_PX, bottom, FAR_PX), MASK),
        (_quad(-FAR_PX, left, top, bottom), MASK),
        (_quad(right, FAR_PX, top, bottom), MASK),
    ]
    outlines = tuple(np.vstack([_quad(a, b, top, bottom), [[a, top]]]) for a, b in list(pairwise(edges.tolist()))[::2])
    return _triangulate(parts, target.angle_deg, outlines)


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
    behind = 1e-5 * px_per_metre
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


def _quad(left: float, right: float, top: float, bottom: float) -> Array:
    return np.array([[left, top], [right, top], [right, bottom], [left, bottom]])


def _triangulate(parts: list[tuple[Array, int]], angle_deg: float, outlines: tuple[Array, ...]) -> TargetMesh:
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


@dataclass(frozen=True, kw_only=True)
class TargetView:
    """A rectangle of cells on the plane of the target, viewed from a point in front of its centre."""

    shape: tuple[int, int]  # cells, (row, col)
    cell_px: tuple[float, float]  # size of a cell (x, y), column pitches
    corner_px: tuple[float, float]  # corner of the first cell (x, y) relative to the target's centre, column pitches
    metre_per_px: float  # size of a column pitch on the target's plane, m
    distance_m: float  # distance of the lens, m
    # Intersection of the optical axis with the plane (x, y), relative to the target's centre, column pitches.
    eye_px: tuple[float, float] = (0.0, 0.0)

    def tiles(self, rows: int) -> Iterator[tuple[slice, "TargetView"]]:
        """Yield strips of at most `rows` rows of cells, each with its slice of the rows."""
        for start in range(0, self.shape[0], rows):
            stop = min(start + rows, self.shape[0])
            corner = (self.corner_px[0], self.corner_px[1] + start * self.cell_px[1])
            yield slice(start, stop), replace(self, shape=(stop - start, self.shape[1]), corner_px=corner)

    def places_px(self, row: Array, col: Array) -> Array:
        """Return positions (x, y) of cell coordinates, integers at the corners of cells, shape (point, 2)."""
        x = self.corner_px[0] + col * self.cell_px[0]
        y = self.corner_px[1] + row * self.cell_px[1]
        return np.stack([x, y], axis=-1)

    def cells_px(self, place_px: Array) -> Array:
        """Return cell coordinates (row, col) of positions (x, y), shape (point, 2)."""
        return (place_px[:, ::-1] - np.array(self.corner_px[::-1])) / np.array(self.cell_px[::-1])

    def rays(self, place_px: Array) -> tuple[Array, Array]:
        """Return origins and directions, m, of rays from the lens to positions (x, y), each of shape (ray, 3)."""
        eye = np.array([*np.multiply(self.eye_px, self.metre_per_px), -self.distance_m])
        towards = np.column_stack([place_px * self.metre_per_px, np.zeros(len(place_px))]) - eye
        return np.broadcast_to(eye, towards.shape), towards


# Cells along one side of the block that one ray represents in uniform parts.
BLOCK = 4
# Rays in a cell where materials meet: a straight border is then located to better than 1/256 of the cell.
RAYS = 256
# Distance from a plate at which transmitted rays (behind it) and shadow rays (before it) start.
CLEARANCE_M = 1e-4
MATERIALS = 3


@dataclass(frozen=True)
class LabSetup:
    """A target on the lab bench."""

    scene: LabScene  # the bench
    mesh: TargetMesh  # the target
    metre_per_px: float  # column pitch on the target's plane, m
    # Ray tracers of the target and of the sphere's port.
    target: RayTracer
    port: RayTracer


def set_up(scene: LabScene, mesh: TargetMesh, metre_per_px: float) -> LabSetup:
    """Place a target on the bench, with the sphere's port behind all of it."""
    reach = np.abs(mesh.vertices).max() * metre_per_px * 1.5
    corners = np.array([[-reach, -reach], [reach, -reach], [reach, reach], [-reach, reach]])
    port = np.column_stack([corners, np.full(4, scene.sphere.distance_m)])
    return LabSetup(
        scene,
        mesh,
        metre_per_px,
        tracer(mesh.vertices * metre_per_px, mesh.faces),
        tracer(port, np.array([[0, 1, 2], [0, 2, 3]])),
    )


def render_bench(bench: LabSetup, view: TargetView, wavelength_nm: Array) -> RadianceCube:
    """Return the spectral radiance at the lens, averaged over each cell, for a port of radiance Planck(T).

    Numbers of cells are multiples of `BLOCK`.

    L = tau L_port where the transmitted ray meets the port, plus rho E_room/pi where the room light is not occluded.
    """
    shares = _shares(bench, view).reshape(2 * MATERIALS, -1)
    scene = bench.scene
    port = planck(wavelength_nm, scene.sphere.temperature_k)
    # The room light's illuminance is relative to the port's exitance; both are Planck radiators.
    fine = np.arange(380.0, 771.0, 5.0)
    eye = luminous_efficiency(fine)
    light, lamp = (np.sum(eye * planck(fine, source.temperature_k)) for source in (scene.sphere, scene.room_light))
    room = planck(wavelength_nm, scene.room_light.temperature_k) * scene.room_light.relative_illuminance * light / lamp
    surfaces = (scene.open, scene.mask, scene.ring)
    through = [surface.transmittance_at(wavelength_nm) * port for surface in surfaces]
    back = [surface.reflectance_at(wavelength_nm) * room for surface in surfaces]
    spectra = np.stack([*through, *back], axis=1).astype(np.float32)
    return RadianceCube(wavelength_nm=wavelength_nm, radiance=(spectra @ shares).reshape(-1, *view.shape))


def _shares(bench: LabSetup, view: TargetView) -> NDArray[np.float32]:
    """Return the fraction of each cell that transmits the port, then that reflects the room light, by material."""
    rows, columns = view.shape
    mixed = outline_cells(bench.mesh, view)
    blocks = mixed.reshape(rows // BLOCK, BLOCK, columns // BLOCK, BLOCK).any(axis=(1, 3))
    centre = np.stack(np.meshgrid(*(np.arange(n // BLOCK) for n in view.shape), indexing="ij"), axis=-1)
    coarse = _fractions_along(bench, view, (centre.reshape(-1, 2) + 0.5) * BLOCK)
    coarse = coarse.reshape(-1, *blocks.shape)
    shares = coarse.repeat(BLOCK, axis=1).repeat(BLOCK, axis=2)
    plain = np.argwhere(blocks.repeat(BLOCK, axis=0).repeat(BLOCK, axis=1) & ~mixed)
    shares[:, plain[:, 0], plain[:, 1]] = _fractions_along(bench, view, plain + 0.5)
    for part in np.array_split(np.argwhere(mixed), max(1, np.count_nonzero(mixed) * RAYS // 2_000_000)):
        inside = (0.5 + np.arange(1, RAYS + 1)[:, None] * R2) % 1.0
        many = _fractions_along(bench, view, (part[:, None, :] + inside).reshape(-1, 2))
        shares[:, part[:, 0], part[:, 1]] = many.reshape(2 * MATERIALS, len(part), RAYS).mean(axis=2)
    return shares


def outline_cells(mesh: TargetMesh, view: TargetView) -> NDArray[np.bool_]:
    """Return the cells in or next to which materials meet, shape (row, col)."""
    from scipy.ndimage import binary_dilation

    rows, columns = view.shape
    mixed = np.zeros((rows + 2, columns + 2), bool)
    for line in mesh.outlines:
        corners = view.cells_px(line)
        way = np.insert(np.cumsum(np.abs(np.diff(corners, axis=0)).max(axis=1)), 0, 0.0)
        steps = np.arange(0.0, way[-1], 0.25)
        cells = np.stack([np.floor(np.interp(steps, way, axis)).astype(int) + 1 for axis in corners.T])
        inside = (cells >= 0).all(axis=0) & (cells[0] < mixed.shape[0]) & (cells[1] < mixed.shape[1])
        mixed[tuple(cells[:, inside])] = True
    return np.asarray(binary_dilation(mixed, np.ones((3, 3))), bool)[1:-1, 1:-1]


def _fractions_along(bench: LabSetup, view: TargetView, cell: Array) -> NDArray[np.float32]:
    """Return for rays through cell coordinates (row, col) the weight of port and room light, by material."""
    place = view.places_px(cell[:, 0], cell[:, 1])
    origin, towards = view.rays(place)
    face = bench.target.hits(origin, towards).face
    # A ray exactly through a seam may miss both triangles: it is displaced slightly.
    missed = face < 0
    if missed.any():
        nudged = view.rays(place[missed] + 1e-4)
        face[missed] = bench.target.hits(*nudged).face
    material = np.where(face < 0, OPEN, bench.mesh.material[face])
    depth = np.where(face < 0, 0.0, bench.mesh.vertices[bench.mesh.faces[face, 0], 2] * bench.metre_per_px)
    point = origin + towards * (1.0 + depth / view.distance_m)[:, None]
    clear = np.where(face < 0, 0.0, bench.port.is_occluded(point + towards * CLEARANCE_M, towards))
    lit = np.where(face < 0, 0.0, _room_light(bench, point))
    one_hot = material == np.arange(MATERIALS)[:, None]
    return np.concatenate([one_hot * clear, one_hot * lit]).astype(np.float32)


def _room_light(bench: LabSetup, point_m: Array) -> Array:
    """Return the irradiance by the room light relative to that at the target's centre, zero in shadow."""
    lamp = np.array(bench.scene.room_light.position_m)
    way = lamp - point_m
    distance = np.linalg.norm(way, axis=1)
    straight = np.linalg.norm(lamp)
    falloff = (straight / distance) ** 2 * (-way[:, 2] / distance) / (-lamp[2] / straight)
    start = point_m + way / distance[:, None] * CLEARANCE_M
    return np.where(bench.target.is_occluded(start, way), 0.0, falloff)
