"""Visible discs of lamps, sun and moon, which rays would miss: added to the pixels by exact
coverage.

Their images in panes of glass are added likewise: the source reflected at the plane of a pane,
where the path meets that pane.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.geometry.viewpoint import Exposure, Viewpoint
from simulate.radiance.integrator.direct_lighting import dot
from simulate.radiance.integrator.integrator_settings import LIMITS
from simulate.radiance.integrator.light_sources import SHORT, DiscLight, LampLight
from simulate.radiance.integrator.sampling import shading_frames
from simulate.radiance.integrator.spectral_scene import Panes, SpectralScene, reflect_direction

Array = NDArray[np.floating]


def coverage(row: Array, col: Array, shape: tuple[int, int]) -> Array:
    """Return the fraction of each pixel that a polygon with corners (corner,) covers, shape (row,
    col).

    Green's theorem: each segment of the outline within a pixel adds its height times the width to
    its right in that pixel, and its full height to all pixels to the right.
    """
    corners = np.clip(np.stack([row, col], axis=1) + 0.0, -1.0, np.add(shape, 1.0))
    start, end = _pieces(corners)
    middle, rise = 0.5 * (start + end), (end - start)[:, 0]
    line = np.floor(middle[:, 0]).astype(np.int64)
    in_frame = (line >= 0) & (line < shape[0]) & (middle[:, 1] < shape[1])
    line, at, rise = line[in_frame], np.maximum(middle[in_frame, 1], 0.0), rise[in_frame]
    pixel = np.floor(at).astype(np.int64)
    height = np.zeros((shape[0], shape[1] + 1))
    np.add.at(height, (line, pixel), rise * (pixel + 1.0 - at))
    np.add.at(height, (line, pixel + 1), rise * (at - pixel))
    covered = np.abs(np.cumsum(height, axis=1)[:, :-1])
    # Cancelling sums leave rounding errors.
    return np.where(
        covered > LIMITS.coverage_rounding * covered.max(initial=0.0), np.minimum(covered, 1.0), 0.0
    )


def _pieces(corner: Array) -> tuple[Array, Array]:
    """Split the sides of a polygon (corner, 2) at pixel borders: starts and ends, shape (segment,
    2).
    """
    side = np.roll(corner, -1, axis=0) - corner
    edge, along = [np.arange(len(corner))], [np.zeros(len(corner))]
    for axis in (0, 1):
        low, high = np.sort([corner[:, axis], corner[:, axis] + side[:, axis]], axis=0)
        first = np.floor(low) + 1.0
        count = np.maximum(np.ceil(high) - first, 0.0).astype(np.int64)
        which = np.repeat(np.arange(len(corner)), count)
        line = first[which] + np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
        edge.append(which)
        along.append((line - corner[which, axis]) / side[which, axis])
    which, side_fraction = np.concatenate(edge), np.concatenate(along)
    order = np.lexsort((side_fraction, which))
    start = corner[which[order]] + side_fraction[order, None] * side[which[order]]
    return start, np.roll(start, -1, axis=0)


GOLDEN_TURN = np.pi * (3.0 - 5.0**0.5)


def add_small_sources(stage: SpectralScene, view: Viewpoint, radiance: NDArray[np.float32]) -> None:
    """Add the directly visible lamps, sun and moon to the radiance of pixels, shape (pixel, band).

    Sources whose light on surfaces is neglected are included, because they may still dazzle.

    A disc of irradiance E at the lens and solid angle W has the radiance E / W; a pixel gets that
    times the fraction of its solid angle that the disc covers, by the exact area of a polygon.
    """
    planes: list[_Plane | None] = [
        None,
        *(_planes(stage.bsdfs.panes) if stage.bsdfs.panes is not None else ()),
    ]
    for exposure in view.exposures():
        for source in (*stage.lighting.discs, *stage.lighting.lamps):
            for plane in planes:
                _add_disc(stage, view, exposure, source, plane, radiance)


Source = DiscLight | LampLight


def _add_disc(
    stage: SpectralScene,
    view: Viewpoint,
    exposure: Exposure,
    source: Source,
    plane: "_Plane | None",
    radiance: NDArray[np.float32],
) -> None:
    """Add a source, or its image in a plane of panes, to the rows of an exposure."""
    eye = exposure.eye_m
    # The reflected lens sees the source as the lens sees the source's image.
    from_m = eye if plane is None else eye - 2.0 * plane.height(eye) * plane.normal
    if isinstance(source, LampLight):
        if plane is not None and plane.height(source.position_m) * plane.height(eye) <= 0:
            return
        # A camera inside a lamp, as inside a ring of diodes, does not see it.
        if np.linalg.norm(source.position_m - from_m) <= source.radius_m:
            return
    swollen = 2.0 * np.pi / LIMITS.disc_corners / np.sin(2.0 * np.pi / LIMITS.disc_corners)
    turn = 2.0 * np.pi * np.arange(LIMITS.disc_corners) / LIMITS.disc_corners
    rim = _image_directions(
        _places(source, from_m, np.full(LIMITS.disc_corners, swollen), turn), plane
    )
    row, col, front = view.project(exposure.direction_before_turn(rim))
    columns = view.shape[1]
    row, col = row[front] - exposure.first, col[front]
    if (
        len(row) < 3
        or row.max() <= 0.0
        or row.min() >= exposure.rows
        or col.max() <= 0.0
        or col.min() >= columns
    ):
        return
    covered = coverage(row, col, (exposure.rows, columns)).ravel()
    pixel = np.flatnonzero(covered)
    # For a disc within a pixel the solid angle at its position counts, not at the pixel's centre.
    middle = pixel // columns + 0.5, pixel % columns + 0.5
    disc_position = (
        np.clip(middle[0], row.min(), row.max()),
        np.clip(middle[1], col.min(), col.max()),
    )
    disc_solid_angle, pixel_solid_angle = (
        view.solid_angle_sr(exposure.picture_row + at[0], at[1]) for at in (disc_position, middle)
    )
    part = (covered[pixel] * disc_solid_angle / pixel_solid_angle).astype(np.float32)[:, None]
    ray_count = int(
        np.clip(
            LIMITS.disc_rays_per_pixel * covered.sum(), LIMITS.min_disc_rays, LIMITS.max_disc_rays
        )
    )
    way = _places(
        source, from_m, (np.arange(ray_count) + 0.5) / ray_count, GOLDEN_TURN * np.arange(ray_count)
    )
    transmittance = (
        _transmittance(stage, eye, way, source)
        if plane is None
        else _by_pane(stage, eye, from_m, way, plane, source)
    )
    row, col, _ = view.project(exposure.direction_before_turn(_image_directions(way, plane)))
    mean_transmittance = _means(
        np.stack([row - exposure.first, col], axis=1), transmittance, np.stack(middle, axis=1)
    )
    light = _irradiance(stage, source, from_m) / np.float32(_solid_angle_sr(source, from_m))
    radiance[exposure.picture_row * columns + pixel] += part * mean_transmittance * light


def _means(
    positions: Array, transmittance: NDArray[np.float32], middle: Array
) -> NDArray[np.float32]:
    """Return means of pixels over the points (row, col) in them, or of the nearest, shape (pixel,
    band or 1).
    """
    if (transmittance == transmittance[0]).all():
        return transmittance[:1]
    last = middle.max(axis=0) + 1.5
    in_window = ((positions >= 0.0) & (positions < last)).all(axis=1)
    across = int(last[1])
    of_place, of_pixel = (
        at[:, 0].astype(np.int64) * across + at[:, 1].astype(np.int64) for at in (positions, middle)
    )
    cell_count = int(last[0]) * across
    count = np.bincount(of_place[in_window], minlength=cell_count)[of_pixel]
    sums = np.stack(
        [
            np.bincount(of_place[in_window], band[in_window], minlength=cell_count)[of_pixel]
            for band in transmittance.T
        ],
        axis=1,
    )
    mean = (sums / np.maximum(count, 1)[:, None]).astype(np.float32)
    for pixel in np.flatnonzero(count == 0):
        mean[pixel] = transmittance[np.argmin(np.square(positions - middle[pixel]).sum(axis=1))]
    return mean


def _places(source: Source, eye: Array, area_fraction: Array, turn: Array) -> Array:
    """Return vectors from the lens to points of a source, shape (point, 3); of unit length for sun
    and moon.

    The points have an angle about the centre, rad, and a fraction of the disc's area that is closer
    to it.
    """
    if isinstance(source, DiscLight):
        middle, radius, length = (
            source.direction,
            1.0,
            1.0 - area_fraction * (1.0 - np.cos(source.angular_radius_rad)),
        )
        across = np.sqrt(np.maximum(1.0 - length**2, 0.0))
    else:
        middle = source.position_m - eye
        radius, length, across = source.radius_m, np.ones(len(turn)), np.sqrt(area_fraction)
    frame = shading_frames((middle / np.linalg.norm(middle))[None])[0]
    offset = np.cos(turn)[:, None] * frame[0] + np.sin(turn)[:, None] * frame[1]
    return length[:, None] * middle + radius * across[:, None] * offset


def _transmittance(
    stage: SpectralScene, eye: Array, way: Array, source: Source
) -> NDArray[np.float32]:
    """Return the transmittance to points of a source past surfaces and through panes, shape (point,
    band or 1).
    """
    length_limit = None if isinstance(source, DiscLight) else SHORT
    start = np.broadcast_to(eye, way.shape)
    transmittance = (~stage.surfaces.tracer.is_occluded(start, way, length_limit)).astype(
        np.float32
    )[:, None]
    if stage.bsdfs.panes is None:
        return transmittance
    return _weaken(
        stage.bsdfs.panes, start, way, length_limit, np.repeat(transmittance, stage.bands, axis=1)
    )


def _irradiance(stage: SpectralScene, source: Source, eye: Array) -> NDArray[np.float32]:
    """Return the irradiance by a source through air alone, shape (band,)."""
    if isinstance(source, DiscLight):
        return source.irradiance
    middle = source.position_m - eye
    distance = float(np.linalg.norm(middle))
    irradiance = source.spectrum * np.float32(
        source.per_sr(-middle[None] / distance)[0] / distance**2
    )
    return (
        irradiance * stage.air.through(np.array([distance]))[0] if stage.air.absorbs else irradiance
    )


def _solid_angle_sr(source: Source, eye: Array) -> float:
    """Return the solid angle of a source's disc, 4 pi sin^2 of half its angular radius, sr."""
    radius = (
        source.angular_radius_rad
        if isinstance(source, DiscLight)
        else np.arctan2(source.radius_m, np.linalg.norm(source.position_m - eye))
    )
    return float(4.0 * np.pi * np.sin(0.5 * radius) ** 2)


def _weaken(
    panes: Panes, start: Array, way: Array, length_limit: float | None, light: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Attenuate light along paths by panes, in place."""
    which, pane_transmittance = panes.transmittance_along(start, way, length_limit)
    light[which] *= pane_transmittance
    return light


@dataclass(frozen=True)
class _Plane:
    """A plane of panes: unit normal, distance from the origin along it, and the panes'
    triangles.
    """

    normal: Array
    offset_m: float
    faces: NDArray[np.int64]

    def height(self, place_m: Array) -> float:
        """Return the height of a position above the plane, m."""
        return float(place_m @ self.normal) - self.offset_m


def _planes(panes: Panes) -> list[_Plane]:
    normal = panes.tracer.planes[1]
    offset = dot(normal, panes.tracer.planes[0])
    first = np.argmax(np.abs(normal) > 10.0**-LIMITS.plane_decimals, axis=1)
    sign = np.sign(normal[np.arange(len(normal)), first])
    keys = np.round(sign[:, None] * np.column_stack([normal, offset]), LIMITS.plane_decimals)
    _, kind = np.unique(keys, axis=0, return_inverse=True)
    groups = [np.flatnonzero(kind.ravel() == number) for number in range(kind.max() + 1)]
    return [_Plane(normal[faces[0]], float(offset[faces[0]]), faces) for faces in groups]


def _image_directions(way: Array, plane: _Plane | None) -> Array:
    """Return unit directions of vectors, reflected at a plane if there is one."""
    unit = way / np.linalg.norm(way, axis=1, keepdims=True)
    return (
        unit
        if plane is None
        else reflect_direction(unit, np.broadcast_to(plane.normal, unit.shape))
    )


def _by_pane(
    stage: SpectralScene, eye: Array, image_eye: Array, way: Array, plane: _Plane, source: Source
) -> NDArray[np.float32]:
    """Return the transmittance to points of an image, over both segments of its path, shape (point,
    band).
    """
    panes, tracer = stage.bsdfs.panes, stage.surfaces.tracer
    assert panes is not None
    transmittance = np.zeros((len(way), stage.bands), np.float32)
    height, rises = plane.height(eye), way @ plane.normal
    on = np.flatnonzero(rises * height > 0.0)
    way, leg = way[on], height / rises[on]
    foot = image_eye + leg[:, None] * way
    ahead = way / np.linalg.norm(way, axis=1, keepdims=True)
    off_m = LIMITS.pane_test_length_m
    pane_hits = panes.met(foot - off_m * ahead, ahead, np.full(len(way), 2.0 * off_m))
    near_plane = np.isin(pane_hits.face, plane.faces)
    which, back = pane_hits.which[near_plane], pane_hits.mirrored[near_plane]
    foot, way, onward_way = foot[which], way[which], (1.0 - leg[which])[:, None] * way[which]
    start = np.broadcast_to(eye, foot.shape)
    # The reflected segment starts at a small distance from the pane, on the side of the lens.
    side = np.sign(np.einsum("ij,j->i", start - foot, plane.normal))[:, None] * plane.normal
    above_pane = foot + off_m * side
    length_limit, onward = (None, way) if isinstance(source, DiscLight) else (SHORT, onward_way)
    clear = ~tracer.is_occluded(start, foot - start, SHORT) & ~tracer.is_occluded(
        above_pane, onward, length_limit
    )
    light = back[clear]
    _weaken(panes, start[clear], above_pane[clear] - start[clear], SHORT, light)
    _weaken(panes, above_pane[clear], onward[clear], length_limit, light)
    transmittance[on[which[clear]]] = light
    return transmittance
