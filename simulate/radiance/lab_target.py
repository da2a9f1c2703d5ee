"""Lab targets in closed form (bars, an edge, a pinhole with its holder, or the open port), and
their light.

Lengths are in column pitches of the image; x runs right, y down, z away from the camera. The plate
lies at z = 0, the holder's ring in front of it. Cells where materials meet are averaged over many
points.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from labdata import BadInput, Kind, Target
from simulate.arrays import Array, Array32, Mask
from simulate.radiance.cube import RadianceCube
from simulate.radiance.integrator.sampling import R2
from simulate.radiance.scene import Holder, LabScene
from simulate.radiance.spectrum import luminous_efficiency, planck

OPEN, MASK, RING = 0, 1, 2
# Length of an edge beyond any image.
FAR_PX = 4e3


@dataclass(frozen=True, kw_only=True)
class PlacedTarget(Target):
    """Target whose centre lies off that of its region, or of the frame, by `offset_px` (row,
    col).
    """

    offset_px: tuple[float, float] = (0.0, 0.0)


def as_stood(kind: Kind, target: Target) -> Target:
    """Return a target with the bench's defaults for the number of bars and the tilt."""
    if kind == "bars":
        tilt = 4.0 if target.angle_deg is None else target.angle_deg
        return replace(target, bars=4 if target.bars is None else target.bars, angle_deg=tilt)
    if kind == "edge":
        return replace(target, angle_deg=5.0 if target.angle_deg is None else target.angle_deg)
    return target


@dataclass(frozen=True, kw_only=True)
class TargetView:
    """A rectangle of cells on the plane of the target, viewed from a point in front of its
    centre.
    """

    shape: tuple[int, int]  # cells, (row, col)
    cell_px: tuple[float, float]  # size of a cell (x, y), column pitches
    corner_px: tuple[
        float, float
    ]  # corner of the first cell (x, y) relative to the target's centre, column pitches
    metre_per_px: float  # size of a column pitch on the target's plane, m
    distance_m: float  # distance of the lens, m
    # Intersection of the optical axis with the plane (x, y), relative to the target's centre,
    # column pitches.
    eye_px: tuple[float, float] = (0.0, 0.0)

    def tiles(self, rows: int) -> Iterator[tuple[slice, "TargetView"]]:
        """Yield strips of at most `rows` rows of cells, each with its slice of the rows."""
        for start in range(0, self.shape[0], rows):
            stop = min(start + rows, self.shape[0])
            corner = (self.corner_px[0], self.corner_px[1] + start * self.cell_px[1])
            yield (
                slice(start, stop),
                replace(self, shape=(stop - start, self.shape[1]), corner_px=corner),
            )

    def places_px(self, cell: Array) -> Array:
        """Return positions (x, y) of cell coordinates (row, col), integers at corners, shape
        (point, 2).
        """
        return np.array(self.corner_px) + cell[:, ::-1] * np.array(self.cell_px)

    def cells_px(self, place_px: Array) -> Array:
        """Return cell coordinates (row, col) of positions (x, y), shape (point, 2)."""
        return (place_px[:, ::-1] - np.array(self.corner_px[::-1])) / np.array(self.cell_px[::-1])


# Cells along one side of the block that one point represents in uniform parts.
BLOCK = 4
# Points in a cell where materials meet: a straight border is then located to better than 1/256 of
# the cell.
POINTS = 256
MATERIALS = 3
# Points that are looked at together: as many as a processor's cache holds.
BATCH_POINTS = 100_000
# A cell's centre alone.
ONE = np.zeros((1, 2))


def render_bench(
    scene: LabScene, kind: Kind, target: Target, view: TargetView, wavelength_nm: Array
) -> RadianceCube:
    """Return the spectral radiance at the lens, averaged over each cell, for a port of radiance
    Planck(T).

    The target stands at the origin: "dark" is the plate without an opening, "flat" the port.
    Missing fields of the target are as of `as_stood`. Numbers of cells are multiples of `BLOCK`.
    Raises BadInput if the target lacks what its kind needs.

    Notes
    -----
    L = tau L_port, the port being behind all of the target, plus rho E_room/pi where the room light
    is not occluded.
    """
    fractions = _cell_fractions(scene, kind, as_stood(kind, target), view)
    radiance = np.tensordot(_spectra(scene, wavelength_nm), fractions, axes=1)
    return RadianceCube(wavelength_nm=wavelength_nm, radiance=radiance)


def sum_bench_bands(
    scene: LabScene,
    kind: Kind,
    target: Target,
    view: TargetView,
    wavelength_nm: Array,
    weight: Array,
) -> Array32:
    """Return the radiance of `render_bench` summed over weighted bands, shape (row, col)."""
    fractions = _cell_fractions(scene, kind, as_stood(kind, target), view)
    summed = (weight @ _spectra(scene, wavelength_nm)).astype(np.float32)
    return np.tensordot(summed, fractions, axes=1)


def _spectra(scene: LabScene, wavelength_nm: Array) -> Array32:
    """Return the radiance by band that cells transmit, then that they reflect, by material, shape
    (band, 2 * MATERIALS).
    """
    port = planck(wavelength_nm, scene.sphere.temperature_k)
    # The room light's illuminance is relative to the port's exitance; both are Planck radiators.
    fine = np.arange(380.0, 771.0, 5.0)
    eye = luminous_efficiency(fine)
    light, lamp = (
        np.sum(eye * planck(fine, source.temperature_k))
        for source in (scene.sphere, scene.room_light)
    )
    room = (
        planck(wavelength_nm, scene.room_light.temperature_k)
        * scene.room_light.relative_illuminance
        * light
        / lamp
    )
    surfaces = (scene.open, scene.mask, scene.ring)
    transmitted = [surface.transmittance_at(wavelength_nm) * port for surface in surfaces]
    reflected = [surface.reflectance_at(wavelength_nm) * room for surface in surfaces]
    return np.stack([*transmitted, *reflected], axis=1).astype(np.float32)


def _cell_fractions(scene: LabScene, kind: Kind, target: Target, view: TargetView) -> Array32:
    """Return the fraction of each cell that transmits the port, then that reflects the room light,
    by material.
    """
    rows, columns = view.shape
    mixed = outline_cells(target_outlines(kind, target, scene.holder), view)
    blocks = mixed.reshape(rows // BLOCK, BLOCK, columns // BLOCK, BLOCK).any(axis=(1, 3))
    centre = np.stack(
        np.meshgrid(*(np.arange(n // BLOCK) for n in view.shape), indexing="ij"), axis=-1
    )
    coarse = _fractions_at(scene, kind, target, view, (centre.reshape(-1, 2) + 0.5) * BLOCK)
    fractions = coarse.reshape(-1, *blocks.shape).repeat(BLOCK, axis=1).repeat(BLOCK, axis=2)
    uniform_cells = np.argwhere(blocks.repeat(BLOCK, axis=0).repeat(BLOCK, axis=1) & ~mixed)
    fractions[:, uniform_cells[:, 0], uniform_cells[:, 1]] = _fractions_at(
        scene, kind, target, view, uniform_cells + 0.5
    )
    subcells = (0.5 + np.arange(1, POINTS + 1)[:, None] * R2) % 1.0 - 0.5
    mixed_cells = np.argwhere(mixed)
    for cells in np.array_split(mixed_cells, 1 + len(mixed_cells) * POINTS // BATCH_POINTS):
        fractions[:, cells[:, 0], cells[:, 1]] = _fractions_at(
            scene, kind, target, view, cells + 0.5, subcells
        )
    return fractions


def target_outlines(kind: Kind, target: Target, holder: Holder) -> list[Array]:
    """Return the polylines (x, y) where materials meet in the image, each of shape (point, 2),
    column pitches.
    """
    if kind == "bars":
        if target.frequency_cy_per_px is None or target.bars is None:
            raise BadInput("bars must have a frequency_cy_per_px, got none")
        width = 0.5 / target.frequency_cy_per_px
        bar_starts = width * (2.0 * np.arange(target.bars) - target.bars + 0.5)
        box = width * np.array([[0.0, -3.5], [1.0, -3.5], [1.0, 3.5], [0.0, 3.5], [0.0, -3.5]])
        return [(box + np.array([start, 0.0])) @ _tilt(target) for start in bar_starts]
    if kind == "edge":
        return [np.array([[0.0, -FAR_PX], [0.0, FAR_PX]]) @ _tilt(target)]
    if kind == "point":
        if target.pinhole_px is None or not target.pinhole_px > 0.0:
            raise BadInput(
                f"a point source must have a positive pinhole_px, got {target.pinhole_px}"
            )
        azimuth = np.linspace(0.0, 2.0 * np.pi, 257)
        circle = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
        return [
            radius * circle
            for radius in (0.5 * target.pinhole_px, holder.inner_radius_px, holder.outer_radius_px)
        ]
    if kind in ("flat", "dark"):
        return []
    raise BadInput(f"a lab target must be dark, flat, edge, bars or point, got {kind!r}")


def _tilt(target: Target) -> Array:
    angle = np.deg2rad(target.angle_deg or 0.0)
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def outline_cells(outlines: list[Array], view: TargetView) -> Mask:
    """Return the cells in or next to which materials meet, shape (row, col)."""
    from scipy.ndimage import binary_dilation

    rows, columns = view.shape
    mixed = np.zeros((rows + 2, columns + 2), bool)
    for line in outlines:
        corners = view.cells_px(line)
        arc_length = np.insert(np.cumsum(np.abs(np.diff(corners, axis=0)).max(axis=1)), 0, 0.0)
        steps = np.arange(0.0, arc_length[-1], 0.25)
        cells = np.stack(
            [np.floor(np.interp(steps, arc_length, axis)).astype(int) + 1 for axis in corners.T]
        )
        in_frame = (
            (cells >= 0).all(axis=0) & (cells[0] < mixed.shape[0]) & (cells[1] < mixed.shape[1])
        )
        mixed[tuple(cells[:, in_frame])] = True
    return np.asarray(binary_dilation(mixed, np.ones((3, 3))), bool)[1:-1, 1:-1]


def _fractions_at(
    scene: LabScene, kind: Kind, target: Target, view: TargetView, cell: Array, points: Array = ONE
) -> Array32:
    """Return for cell coordinates (row, col) the weight of port and room light, by material, shape
    (2 * MATERIALS, cell).

    `points`: distances (row, col) from the coordinates, cells, over which is averaged; over these
    the irradiance by the room light does not change.
    """
    centre_px, turn = view.places_px(cell), _tilt(target).T
    away_px = points[:, ::-1] * np.array(view.cell_px)
    x, y = (
        centre[:, None] + away
        for centre, away in zip((centre_px @ turn).T, (away_px @ turn).T, strict=True)
    )
    is_open = _is_open(kind, target, x, y)
    seen = {OPEN: is_open, MASK: ~is_open}
    lamp_m, height_m = np.array(scene.room_light.position_m), scene.holder.height_m
    centre_m = np.column_stack([centre_px * view.metre_per_px, np.zeros(len(cell))])
    light = dict.fromkeys(range(MATERIALS), _room_light(centre_m, lamp_m))
    lit = seen
    if kind == "point":

        def meets_ring(source_px: Array, part: float) -> Mask:
            """Whether lines from the plate to a source meet the ring, that part of the way on."""
            to_x, to_y = part * (source_px @ turn)
            radius_px = np.hypot((1.0 - part) * x + to_x, (1.0 - part) * y + to_y)
            holder = scene.holder
            return (holder.inner_radius_px < radius_px) & (radius_px < holder.outer_radius_px)

        eye_px, part = np.array(view.eye_px), height_m / view.distance_m
        ring = meets_ring(eye_px, part)
        seen = {material: mask & ~ring for material, mask in seen.items()} | {RING: ring}
        eye_m = np.array([*eye_px * view.metre_per_px, -view.distance_m])
        light[RING] = _room_light(centre_m + part * (eye_m - centre_m), lamp_m)
        lit = seen
        if 0.0 < height_m < -lamp_m[2]:
            shaded = meets_ring(lamp_m[:2] / view.metre_per_px, -height_m / lamp_m[2])
            lit = {material: seen[material] & ~shaded for material in (OPEN, MASK)} | {RING: ring}
    weights = np.zeros((2 * MATERIALS, len(cell)), np.float32)
    for material, mask in seen.items():
        weights[material] = np.count_nonzero(mask, axis=1)
        lit_points = np.count_nonzero(lit[material], axis=1)
        weights[MATERIALS + material] = lit_points * light[material]
    return weights / np.float32(len(points))


def _room_light(position_m: Array, lamp_m: Array) -> Array:
    """Return the irradiance by the room light relative to that at the target's centre."""
    vector = lamp_m - position_m
    distance, centre_distance = np.linalg.norm(vector, axis=1), np.linalg.norm(lamp_m)
    return (
        (centre_distance / distance) ** 2
        * (vector[:, 2] / distance)
        / (lamp_m[2] / centre_distance)
    )


def _is_open(kind: Kind, target: Target, x: Array, y: Array) -> Mask:
    """Return whether positions on the plate, along the target's own axes, are clear."""
    if kind == "edge":
        return x > 0.0
    if kind == "bars":
        width, bars = 0.5 / (target.frequency_cy_per_px or np.inf), target.bars or 0
        number = np.floor(x / width + bars - 0.5)
        return (
            (np.abs(y) < 3.5 * width) & (number >= 0) & (number < 2 * bars - 1) & (number % 2 == 0)
        )
    if kind == "point":
        return np.hypot(x, y) < 0.5 * (target.pinhole_px or 0.0)
    return np.full(x.shape, kind == "flat")
