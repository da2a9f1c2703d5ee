"""The taper brings light where its fibres lead: distortion conserves light, shear is fixed and
moves hexagons whole.
"""

from dataclasses import replace

import numpy as np
import pytest

from labdata import Conditions
from simulate.camera import (
    CameraModel,
    FibreGeometry,
    StageImage,
    grid_with_margin,
    image_placement,
    pattern,
)

GRID = grid_with_margin(300, 400, per_pixel=2, margin=10, pitch_x_mm=0.018, pitch_y_mm=0.0213)


def _spot(x_mm: float, y_mm: float) -> StageImage:
    x, y = image_placement.cell_centres(GRID)
    image = np.exp(-0.5 * ((x - x_mm) ** 2 + (y - y_mm) ** 2) / 0.05**2)
    return StageImage(values=image.astype(np.float32), grid=GRID)


def _centre(light: StageImage) -> np.ndarray:
    x, y = image_placement.cell_centres(GRID)
    total = light.values.sum(dtype=float)
    return (
        np.array([(light.values * x).sum(dtype=float), (light.values * y).sum(dtype=float)]) / total
    )


@pytest.mark.parametrize("fraction", [0.02, -0.03])
@pytest.mark.parametrize("place", [(1.0, 0.5), (-2.5, 2.0)])
def test_distortion_moves_a_spot_by_its_law_and_keeps_its_light(fraction, place):
    spot = _spot(*place)
    bent = FibreGeometry(distortion_fraction=fraction).mean(spot)
    assert bent.values.sum(dtype=float) == pytest.approx(spot.values.sum(dtype=float), rel=2e-4)
    radius = np.hypot(*place) / image_placement.corner_mm(GRID)
    assert _centre(bent) == pytest.approx(np.array(place) * (1.0 + fraction * radius**2), abs=4e-4)


def test_the_axis_stays_and_the_corner_moves_by_the_fraction():
    corner = image_placement.corner_mm(GRID)
    radial = image_placement.Radial(fraction=0.02, corner_mm=corner)
    x, _, area = radial.source(np.array([0.0, 1.02 * corner]), np.zeros(2))
    assert x == pytest.approx([0.0, corner], rel=1e-6)
    assert area == pytest.approx([1.0, 1.0 / (1.02 * 1.06)], rel=1e-6)


def test_shears_shift_whole_hexagons_by_the_stated_rms():
    offsets = pattern.multifibre_offsets(GRID, 0.3, 0.04, 5)
    kinds = np.unique(offsets[0])
    cells_per_hexagon = 0.3**2 * np.sqrt(3.0) / 2.0 / (GRID.cell_area_cm2 * 100.0)
    assert len(kinds) == pytest.approx(offsets[0].size / cells_per_hexagon, rel=0.25)
    # Neighbours 0.3 mm apart along a row are different hexagons everywhere.
    step = round(0.3 / (GRID.pitch_x_mm / 2))
    difference = offsets[:, :, step:] - offsets[:, :, :-step]
    rms = np.sqrt((difference**2).sum(axis=0).mean(dtype=float))
    assert rms == pytest.approx(0.04, rel=4.5 / np.sqrt(2 * len(kinds)))


def test_borders_of_shears_are_the_dark_lines_of_the_pattern():
    offsets = pattern.multifibre_offsets(GRID, 0.3 * 1.6, 0.04, 5)[0]
    lines = pattern.multifibre_transmission(GRID, 1.0, 0.3, 0.006, 1.6)
    for axis in (0, 1):
        border = np.diff(offsets, axis=axis) != 0.0
        beside = np.minimum(np.delete(lines, 0, axis), np.delete(lines, -1, axis))
        assert 0.02 < border.mean() < 0.1
        # A border runs between two cells: one of them is half a cell from a line 6 um wide at the
        # most.
        assert beside[border].max() < 0.9
        assert beside.mean() > 0.9


def test_shear_leaves_a_flat_flat_and_follows_its_specimen():
    flat = StageImage(values=np.full(GRID.shape, 2.0, np.float32), grid=GRID)
    sheared = FibreGeometry(shear_um=25.0, demagnification=1.6, pattern_seed=3)
    assert sheared.mean(flat).values == pytest.approx(2.0, rel=1e-5)
    spot = _spot(0.3, 0.2)
    assert np.array_equal(sheared.mean(spot).values, sheared.mean(spot).values)
    assert not np.array_equal(
        sheared.mean(spot).values, replace(sheared, pattern_seed=4).mean(spot).values
    )
    moved = _centre(sheared.mean(spot)) - _centre(spot)
    assert 0.0 < np.hypot(*moved) < 5 * 0.025 * 1.6


def test_geometry_without_numbers_is_no_geometry():
    spot = _spot(0.3, 0.2)
    assert FibreGeometry().mean(spot) is spot


def test_bench_camera_has_no_geometry_and_a_whole_one_has(sheet):
    bench, whole = CameraModel(sheet), CameraModel(sheet, geometry=True)
    assert "taper distortion and fibre shear" not in [
        stage.name for stage in bench.chain(Conditions()).stages
    ]
    assert "taper distortion and fibre shear" in [
        stage.name for stage in whole.chain(Conditions()).stages
    ]
