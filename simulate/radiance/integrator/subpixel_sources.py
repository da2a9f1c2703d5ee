"""Visible discs of lamps, sun and moon, which rays would miss: added to the pixels by exact
coverage.

Their images in panes of glass are added likewise: the source reflected at the plane of a pane,
where the path meets that pane.
"""

from dataclasses import dataclass

import numpy as np

from simulate.arrays import Array, Array32, Index
from simulate.radiance.geometry.viewpoint import Exposure, Viewpoint
from simulate.radiance.integrator.direct_lighting import dot
from simulate.radiance.integrator.integrator_settings import LIMITS
from simulate.radiance.integrator.light_sources import SHORT, DiscLight, LampLight
from simulate.radiance.integrator.sampling import shading_frames
from simulate.radiance.integrator.spectral_scene import Panes, SpectralScene, reflect_direction


def coverage(row: Array, col: Array, shape: tuple[int, int]) -> Array:
    """Return the fraction of each pixel that a polygon with corners (corner,) covers, shape (row,
    col).

    Green's theorem: each segment of the outline within a pixel adds its height times the width to
    its right in that pixel, and its full height to all pixels to the right.
    """
    corners = np.clip(np.stack([row, col], axis=1) + 0.0, -1.0, np.add(shape, 1.0))
    start, end = _pieces(corners)
    centre, row_step = 0.5 * (start + end), (end - start)[:, 0]
    line = np.floor(centre[:, 0]).astype(np.int64)
    in_frame = (line >= 0) & (line < shape[0]) & (centre[:, 1] < shape[1])
    line, col_position, row_step = (
        line[in_frame],
        np.maximum(centre[in_frame, 1], 0.0),
        row_step[in_frame],
    )
    pixel = np.floor(col_position).astype(np.int64)
    height = np.zeros((shape[0], shape[1] + 1))
    np.add.at(height, (line, pixel), row_step * (pixel + 1.0 - col_position))
    np.add.at(height, (line, pixel + 1), row_step * (col_position - pixel))
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
    indices, fractions = [np.arange(len(corner))], [np.zeros(len(corner))]
    for axis in (0, 1):
        low, high = np.sort([corner[:, axis], corner[:, axis] + side[:, axis]], axis=0)
        first_line = np.floor(low) + 1.0
        count = np.maximum(np.ceil(high) - first_line, 0.0).astype(np.int64)
        side_index = np.repeat(np.arange(len(corner)), count)
        line = (
            first_line[side_index]
            + np.arange(len(side_index))
            - np.repeat(np.cumsum(count) - count, count)
        )
        indices.append(side_index)
        fractions.append((line - corner[side_index, axis]) / side[side_index, axis])
    side_index, side_fraction = np.concatenate(indices), np.concatenate(fractions)
    order = np.lexsort((side_fraction, side_index))
    start = corner[side_index[order]] + side_fraction[order, None] * side[side_index[order]]
    return start, np.roll(start, -1, axis=0)


GOLDEN_TURN = np.pi * (3.0 - 5.0**0.5)


def add_small_sources(scene: SpectralScene, view: Viewpoint, radiance: Array32) -> None:
    """Add the directly visible lamps, sun and moon to the radiance of pixels, shape (pixel, band).

    Sources whose light on surfaces is neglected are included, because they may still dazzle.

    A disc of irradiance E at the lens and solid angle W has the radiance E / W; a pixel gets that
    times the fraction of its solid angle that the disc covers, by the exact area of a polygon.
    """
    planes: list[_Plane | None] = [
        None,
        *(_planes(scene.bsdfs.panes) if scene.bsdfs.panes is not None else ()),
    ]
    for exposure in view.exposures():
        for source in (*scene.lighting.discs, *scene.lighting.lamps):
            for plane in planes:
                _add_disc(scene, view, exposure, source, plane, radiance)


Source = DiscLight | LampLight


def _add_disc(
    scene: SpectralScene,
    view: Viewpoint,
    exposure: Exposure,
    source: Source,
    plane: "_Plane | None",
    radiance: Array32,
) -> None:
    """Add a source, or its image in a plane of panes, to the rows of an exposure."""
    eye = exposure.eye_m
    # The reflected lens sees the source as the lens sees the source's image.
    viewer_m = eye if plane is None else eye - 2.0 * plane.height(eye) * plane.normal
    if isinstance(source, LampLight):
        if plane is not None and plane.height(source.position_m) * plane.height(eye) <= 0:
            return
        # A camera inside a lamp, as inside a ring of diodes, does not see it.
        if np.linalg.norm(source.position_m - viewer_m) <= source.radius_m:
            return
    area_fraction = 2.0 * np.pi / LIMITS.disc_corners / np.sin(2.0 * np.pi / LIMITS.disc_corners)
    angle = 2.0 * np.pi * np.arange(LIMITS.disc_corners) / LIMITS.disc_corners
    rim = _image_directions(
        _source_points(source, viewer_m, np.full(LIMITS.disc_corners, area_fraction), angle), plane
    )
    row, col, in_front = view.project(exposure.direction_before_turn(rim))
    columns = view.shape[1]
    row, col = row[in_front] - exposure.first, col[in_front]
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
    centre = pixel // columns + 0.5, pixel % columns + 0.5
    disc_position = (
        np.clip(centre[0], row.min(), row.max()),
        np.clip(centre[1], col.min(), col.max()),
    )
    disc_solid_angle, pixel_solid_angle = (
        view.solid_angle_sr(exposure.picture_row + point[0], point[1])
        for point in (disc_position, centre)
    )
    weight = (covered[pixel] * disc_solid_angle / pixel_solid_angle).astype(np.float32)[:, None]
    ray_count = int(
        np.clip(
            LIMITS.disc_rays_per_pixel * covered.sum(), LIMITS.min_disc_rays, LIMITS.max_disc_rays
        )
    )
    vector = _source_points(
        source,
        viewer_m,
        (np.arange(ray_count) + 0.5) / ray_count,
        GOLDEN_TURN * np.arange(ray_count),
    )
    transmittance = (
        _transmittance(scene, eye, vector, source)
        if plane is None
        else _pane_transmittance(scene, eye, viewer_m, vector, plane, source)
    )
    row, col, _ = view.project(exposure.direction_before_turn(_image_directions(vector, plane)))
    mean_transmittance = _means(
        np.stack([row - exposure.first, col], axis=1), transmittance, np.stack(centre, axis=1)
    )
    light = _irradiance(scene, source, viewer_m) / np.float32(_solid_angle_sr(source, viewer_m))
    radiance[exposure.picture_row * columns + pixel] += weight * mean_transmittance * light


def _means(positions: Array, transmittance: Array32, centre: Array) -> Array32:
    """Return means of pixels over the points (row, col) in them, or of the nearest, shape (pixel,
    band or 1).
    """
    if (transmittance == transmittance[0]).all():
        return transmittance[:1]
    stop = centre.max(axis=0) + 1.5
    in_window = ((positions >= 0.0) & (positions < stop)).all(axis=1)
    n_columns = int(stop[1])
    point_cell, pixel_cell = (
        position[:, 0].astype(np.int64) * n_columns + position[:, 1].astype(np.int64)
        for position in (positions, centre)
    )
    cell_count = int(stop[0]) * n_columns
    count = np.bincount(point_cell[in_window], minlength=cell_count)[pixel_cell]
    sums = np.stack(
        [
            np.bincount(point_cell[in_window], band[in_window], minlength=cell_count)[pixel_cell]
            for band in transmittance.T
        ],
        axis=1,
    )
    mean = (sums / np.maximum(count, 1)[:, None]).astype(np.float32)
    for pixel in np.flatnonzero(count == 0):
        mean[pixel] = transmittance[np.argmin(np.square(positions - centre[pixel]).sum(axis=1))]
    return mean


def _source_points(source: Source, eye: Array, area_fraction: Array, angle: Array) -> Array:
    """Return vectors from the lens to points of a source, shape (point, 3); of unit length for sun
    and moon.

    The points have an angle about the centre, rad, and a fraction of the disc's area that is closer
    to it.
    """
    if isinstance(source, DiscLight):
        centre, radius, length = (
            source.direction,
            1.0,
            1.0 - area_fraction * (1.0 - np.cos(source.angular_radius_rad)),
        )
        disc_radius = np.sqrt(np.maximum(1.0 - length**2, 0.0))
    else:
        centre = source.position_m - eye
        radius, length, disc_radius = source.radius_m, np.ones(len(angle)), np.sqrt(area_fraction)
    frame = shading_frames((centre / np.linalg.norm(centre))[None])[0]
    offset = np.cos(angle)[:, None] * frame[0] + np.sin(angle)[:, None] * frame[1]
    return length[:, None] * centre + radius * disc_radius[:, None] * offset


def _transmittance(scene: SpectralScene, eye: Array, vector: Array, source: Source) -> Array32:
    """Return the transmittance to points of a source past surfaces and through panes, shape (point,
    band or 1).
    """
    length_limit = None if isinstance(source, DiscLight) else SHORT
    start = np.broadcast_to(eye, vector.shape)
    transmittance = (~scene.surfaces.tracer.is_occluded(start, vector, length_limit)).astype(
        np.float32
    )[:, None]
    if scene.bsdfs.panes is None:
        return transmittance
    return _attenuate(
        scene.bsdfs.panes,
        start,
        vector,
        length_limit,
        np.repeat(transmittance, scene.bands, axis=1),
    )


def _irradiance(scene: SpectralScene, source: Source, eye: Array) -> Array32:
    """Return the irradiance by a source through air alone, shape (band,)."""
    if isinstance(source, DiscLight):
        return source.irradiance
    vector = source.position_m - eye
    distance = float(np.linalg.norm(vector))
    irradiance = source.spectrum * np.float32(
        source.per_sr(-vector[None] / distance)[0] / distance**2
    )
    return (
        irradiance * scene.air.transmittance(np.array([distance]))[0]
        if scene.air.is_present
        else irradiance
    )


def _solid_angle_sr(source: Source, eye: Array) -> float:
    """Return the solid angle of a source's disc, 4 pi sin^2 of half its angular radius, sr."""
    radius = (
        source.angular_radius_rad
        if isinstance(source, DiscLight)
        else np.arctan2(source.radius_m, np.linalg.norm(source.position_m - eye))
    )
    return float(4.0 * np.pi * np.sin(0.5 * radius) ** 2)


def _attenuate(
    panes: Panes,
    start: Array,
    vector: Array,
    length_limit: float | None,
    light: Array32,
) -> Array32:
    """Attenuate light along paths by panes, in place."""
    rows, pane_transmittance = panes.transmittance_along(start, vector, length_limit)
    light[rows] *= pane_transmittance
    return light


@dataclass(frozen=True)
class _Plane:
    """A plane of panes: unit normal, distance from the origin along it, and the panes'
    triangles.
    """

    normal: Array
    offset_m: float
    faces: Index

    def height(self, position_m: Array) -> float:
        """Return the height of a position above the plane, m."""
        return float(position_m @ self.normal) - self.offset_m


def _planes(panes: Panes) -> list[_Plane]:
    normal = panes.tracer.planes[1]
    offset = dot(normal, panes.tracer.planes[0])
    first_axis = np.argmax(np.abs(normal) > 10.0**-LIMITS.plane_decimals, axis=1)
    sign = np.sign(normal[np.arange(len(normal)), first_axis])
    keys = np.round(sign[:, None] * np.column_stack([normal, offset]), LIMITS.plane_decimals)
    _, plane_of_face = np.unique(keys, axis=0, return_inverse=True)
    plane_faces = [
        np.flatnonzero(plane_of_face.ravel() == number) for number in range(plane_of_face.max() + 1)
    ]
    return [_Plane(normal[faces[0]], float(offset[faces[0]]), faces) for faces in plane_faces]


def _image_directions(vector: Array, plane: _Plane | None) -> Array:
    """Return unit directions of vectors, reflected at a plane if there is one."""
    unit = vector / np.linalg.norm(vector, axis=1, keepdims=True)
    return (
        unit
        if plane is None
        else reflect_direction(unit, np.broadcast_to(plane.normal, unit.shape))
    )


def _pane_transmittance(
    scene: SpectralScene, eye: Array, image_eye: Array, vector: Array, plane: _Plane, source: Source
) -> Array32:
    """Return the transmittance to points of an image, over both segments of its path, shape (point,
    band).
    """
    panes, tracer = scene.bsdfs.panes, scene.surfaces.tracer
    assert panes is not None
    transmittance = np.zeros((len(vector), scene.bands), np.float32)
    height, slope = plane.height(eye), vector @ plane.normal
    rows = np.flatnonzero(slope * height > 0.0)
    vector, pane_fraction = vector[rows], height / slope[rows]
    foot = image_eye + pane_fraction[:, None] * vector
    unit = vector / np.linalg.norm(vector, axis=1, keepdims=True)
    off_m = LIMITS.pane_test_length_m
    pane_hits = panes.hits(foot - off_m * unit, unit, np.full(len(vector), 2.0 * off_m))
    in_plane = np.isin(pane_hits.face, plane.faces)
    hit_rows, reflectance = pane_hits.rays[in_plane], pane_hits.reflectance[in_plane]
    foot, vector, next_segment = (
        foot[hit_rows],
        vector[hit_rows],
        (1.0 - pane_fraction[hit_rows])[:, None] * vector[hit_rows],
    )
    start = np.broadcast_to(eye, foot.shape)
    # The reflected segment starts at a small distance from the pane, on the side of the lens.
    side = np.sign(np.einsum("ij,j->i", start - foot, plane.normal))[:, None] * plane.normal
    above_pane = foot + off_m * side
    length_limit, next_vector = (
        (None, vector) if isinstance(source, DiscLight) else (SHORT, next_segment)
    )
    unoccluded = ~tracer.is_occluded(start, foot - start, SHORT) & ~tracer.is_occluded(
        above_pane, next_vector, length_limit
    )
    light = reflectance[unoccluded]
    _attenuate(panes, start[unoccluded], above_pane[unoccluded] - start[unoccluded], SHORT, light)
    _attenuate(panes, above_pane[unoccluded], next_vector[unoccluded], length_limit, light)
    transmittance[rows[hit_rows[unoccluded]]] = light
    return transmittance
