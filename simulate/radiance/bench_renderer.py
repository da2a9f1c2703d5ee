"""Renderer of the lab bench: spectral radiance of a target, with many rays in cells where materials meet."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.cube import RadianceCube
from simulate.radiance.geometry.ray_tracer import RayTracer, tracer
from simulate.radiance.integrator.low_discrepancy import R2
from simulate.radiance.scene import LabScene
from simulate.radiance.spectrum import planck
from simulate.radiance.target_mesh import OPEN, TargetMesh


@dataclass(frozen=True, kw_only=True)
class TargetView:
    """A rectangle of cells on the plane of the target, viewed from a point in front of its centre.

    Parameters
    ----------
    shape
        Cells, (row, col).
    cell_px
        Size of a cell (x, y), column pitches.
    corner_px
        Corner of the first cell (x, y) relative to the target's centre, column pitches.
    metre_per_px
        Size of a column pitch on the target's plane, m.
    distance_m
        Distance of the lens, m.
    eye_px
        Intersection of the optical axis with the plane (x, y), relative to the target's centre, column pitches.
    """

    shape: tuple[int, int]
    cell_px: tuple[float, float]
    corner_px: tuple[float, float]
    metre_per_px: float
    distance_m: float
    eye_px: tuple[float, float] = (0.0, 0.0)

    def tiles(self, rows: int) -> Iterator[tuple[slice, "TargetView"]]:
        """Yield strips of at most `rows` rows of cells, each with its slice of the rows."""
        for start in range(0, self.shape[0], rows):
            stop = min(start + rows, self.shape[0])
            corner = (self.corner_px[0], self.corner_px[1] + start * self.cell_px[1])
            yield slice(start, stop), replace(self, shape=(stop - start, self.shape[1]), corner_px=corner)

    def places_px(self, row: NDArray[np.floating], col: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return positions (x, y) of cell coordinates, integers at the corners of cells, shape (point, 2)."""
        x = self.corner_px[0] + col * self.cell_px[0]
        y = self.corner_px[1] + row * self.cell_px[1]
        return np.stack([x, y], axis=-1)

    def cells_px(self, place_px: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return cell coordinates (row, col) of positions (x, y), shape (point, 2)."""
        return (place_px[:, ::-1] - np.array(self.corner_px[::-1])) / np.array(self.cell_px[::-1])

    def rays(self, place_px: NDArray[np.floating]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
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
    """A target on the lab bench.

    Parameters
    ----------
    scene
        The bench.
    mesh
        The target.
    metre_per_px
        Column pitch on the target's plane, m.
    target, port
        Ray tracers of the target and of the sphere's port.
    """

    scene: LabScene
    mesh: TargetMesh
    metre_per_px: float
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


def render_bench(bench: LabSetup, view: TargetView, wavelength_nm: NDArray[np.floating]) -> RadianceCube:
    """Return the spectral radiance at the lens, averaged over each cell, for a port of radiance Planck(T).

    Parameters
    ----------
    bench
        Target and lights.
    view
        Cells; their numbers are multiples of `BLOCK`.
    wavelength_nm
        Wavelengths, shape (band,), nm.

    Notes
    -----
    L = tau L_port where the transmitted ray meets the port, plus rho E_room/pi where the room light is not occluded.
    """
    shares = _shares(bench, view).reshape(2 * MATERIALS, -1)
    scene = bench.scene
    port = planck(wavelength_nm, scene.sphere.temperature_k)
    room = planck(wavelength_nm, scene.room_light.temperature_k) * _room_scale(scene)
    surfaces = (scene.open, scene.mask, scene.ring)
    through = [surface.transmittance_at(wavelength_nm) * port for surface in surfaces]
    back = [surface.reflectance_at(wavelength_nm) * room for surface in surfaces]
    spectra = np.stack([*through, *back], axis=1).astype(np.float32)
    return RadianceCube(wavelength_nm=wavelength_nm, radiance=(spectra @ shares).reshape(-1, *view.shape))


def _room_scale(scene: LabScene) -> float:
    """Return the radiance of a white diffuser in the room light over that of a black body, dimensionless.

    The lamp's illuminance is relative to the port's exitance; both are Planck radiators.
    """
    from simulate.radiance.spectrum import luminous_efficiency

    fine = np.arange(380.0, 771.0, 5.0)
    eye = luminous_efficiency(fine)
    port = np.sum(eye * planck(fine, scene.sphere.temperature_k))
    lamp = np.sum(eye * planck(fine, scene.room_light.temperature_k))
    return float(scene.room_light.relative_illuminance * port / lamp)


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
    rows, columns = view.shape
    mixed = np.zeros((rows + 2, columns + 2), bool)
    for line in mesh.outlines:
        corners = view.cells_px(line)
        way = np.insert(np.cumsum(np.abs(np.diff(corners, axis=0)).max(axis=1)), 0, 0.0)
        steps = np.arange(0.0, way[-1], 0.25)
        cells = np.stack([np.floor(np.interp(steps, way, axis)).astype(int) + 1 for axis in corners.T])
        inside = (cells >= 0).all(axis=0) & (cells[0] < mixed.shape[0]) & (cells[1] < mixed.shape[1])
        mixed[tuple(cells[:, inside])] = True
    return _dilate(mixed)[1:-1, 1:-1]


def _dilate(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    wide = mask.copy()
    wide[1:] |= mask[:-1]
    wide[:-1] |= mask[1:]
    both = wide.copy()
    both[:, 1:] |= wide[:, :-1]
    both[:, :-1] |= wide[:, 1:]
    return both


def _fractions_along(bench: LabSetup, view: TargetView, cell: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return for rays through cell coordinates (row, col) the weight of port and room light, by material."""
    place = view.places_px(cell[:, 0], cell[:, 1])
    origin, towards = view.rays(place)
    face = bench.target.first_hit(origin, towards)
    # A ray exactly through a seam may miss both triangles: it is displaced slightly.
    missed = face < 0
    if missed.any():
        nudged = view.rays(place[missed] + 1e-4)
        face[missed] = bench.target.first_hit(*nudged)
    material = np.where(face < 0, OPEN, bench.mesh.material[face])
    depth = np.where(face < 0, 0.0, bench.mesh.vertices[bench.mesh.faces[face, 0], 2] * bench.metre_per_px)
    point = origin + towards * (1.0 + depth / view.distance_m)[:, None]
    clear = np.where(face < 0, 0.0, _port_behind(bench, point, towards))
    lit = np.where(face < 0, 0.0, _room_light(bench, point))
    one_hot = material == np.arange(MATERIALS)[:, None]
    return np.concatenate([one_hot * clear, one_hot * lit]).astype(np.float32)


def _port_behind(bench: LabSetup, point_m: NDArray[np.floating], towards: NDArray[np.floating]) -> NDArray[np.bool_]:
    return bench.port.is_occluded(point_m + towards * CLEARANCE_M, towards)


def _room_light(bench: LabSetup, point_m: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the irradiance by the room light relative to that at the target's centre, zero in shadow."""
    lamp = np.array(bench.scene.room_light.position_m)
    way = lamp - point_m
    distance = np.linalg.norm(way, axis=1)
    straight = np.linalg.norm(lamp)
    falloff = (straight / distance) ** 2 * (-way[:, 2] / distance) / (-lamp[2] / straight)
    start = point_m + way / distance[:, None] * CLEARANCE_M
    return np.where(bench.target.is_occluded(start, way), 0.0, falloff)
