"""A point of the scene lands in the frame where the truth's pixel and the distortions of lens and
taper say.
"""

from dataclasses import replace

import numpy as np
import pytest

from labdata import load_camera
from simulate import Shot, conditions_of
from simulate.camera import camera_from_description, photoelectrons_from_radiance
from simulate.radiance import RadianceCube

HALF_PX = 14


@pytest.mark.parametrize("name", ["pulnix-ag5745ef3", "emccd-512"])
def test_light_is_displaced_by_each_distortion_in_turn(name):
    description = load_camera(name)
    if description.has_tube:
        # Without the random offsets of multi-fibres, of about a pixel.
        description = replace(description, taper=replace(description.taper, shear_um=0.0))
    camera, conditions = camera_from_description(description), conditions_of(description)
    rows, columns = camera.shape
    radiance = np.zeros((2, rows, columns), np.float32)
    row, col = rows // 12, columns // 10
    radiance[:, row, col] = 1e-6
    freed = photoelectrons_from_radiance(
        camera, RadianceCube(wavelength_nm=np.array([550.0, 560.0]), radiance=radiance), conditions
    )
    light = camera.to_mcp_input(freed, conditions)
    shot = Shot(camera=camera, light=light, kind="scene", conditions=conditions)
    assert len(shot.frame_distortion) == 1 + camera.has_tube and all(shot.frame_distortion)

    # From the truth's pixel to the frame's, in columns and rows from the middle; pixels need not be
    # square.
    lens, cells = camera.lens(), camera.cells
    focal_px = lens.focal_length_mm / cells.pitch_x_mm, lens.focal_length_mm / cells.pitch_y_mm
    place = np.array(
        [(col + 0.5 - 0.5 * columns) / focal_px[0], (row + 0.5 - 0.5 * rows) / focal_px[1]]
    )
    corner = np.hypot(0.5 * columns / focal_px[0], 0.5 * rows / focal_px[1])
    landed = place
    for fraction in shot.frame_distortion:
        landed = landed * (1.0 + fraction * (np.hypot(*landed) / corner) ** 2)
    expected, before = landed * focal_px, place * focal_px

    grid = light.grid
    values = light.values[(..., *grid.inside)].astype(float)
    values = values.reshape(values.shape[0] // grid.per_row, grid.per_row, -1, grid.per_column).sum(
        axis=(1, 3)
    )
    centre = round(expected[1] + 0.5 * values.shape[0]), round(expected[0] + 0.5 * values.shape[1])
    first = [max(0, at - HALF_PX) for at in centre]
    window = values[first[0] : centre[0] + HALF_PX + 1, first[1] : centre[1] + HALF_PX + 1]
    bright = np.maximum(window - 0.1 * window.max(), 0.0)
    at_row, at_col = (
        (bright * (axis + 0.5)).sum() / bright.sum() for axis in np.indices(window.shape)
    )
    found = at_col + first[1] - 0.5 * values.shape[1], at_row + first[0] - 0.5 * values.shape[0]
    assert found == pytest.approx(expected, abs=0.1)
    assert np.hypot(*(expected - before)) > 0.5
