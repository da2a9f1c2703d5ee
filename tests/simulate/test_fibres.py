"""The plate and the fibres behind it: gain by control, load and place, geometry of the taper."""

from dataclasses import replace

import numpy as np
import pytest

from labdata import BadInput, Conditions, Target
from simulate import LabBench
from simulate.camera import (
    CameraModel,
    FibreGeometry,
    HaloBlur,
    MicrochannelPlate,
    Slot,
    StageImage,
    grid_with_margin,
    image_placement,
    pattern,
    true_quantities,
    tube_photometry,
)

# The taper brings light where its fibres lead: distortion conserves light, shear is fixed and
# moves hexagons whole.


FIBRE_GRID = grid_with_margin(300, 400, per_pixel=2, margin=10, pitch_x_mm=0.018, pitch_y_mm=0.0213)


def _spot(x_mm: float, y_mm: float) -> StageImage:
    x, y = image_placement.cell_centres(FIBRE_GRID)
    image = np.exp(-0.5 * ((x - x_mm) ** 2 + (y - y_mm) ** 2) / 0.05**2)
    return StageImage(values=image.astype(np.float32), grid=FIBRE_GRID)


def _centre(light: StageImage) -> np.ndarray:
    x, y = image_placement.cell_centres(FIBRE_GRID)
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
    radius = np.hypot(*place) / image_placement.corner_mm(FIBRE_GRID)
    assert _centre(bent) == pytest.approx(np.array(place) * (1.0 + fraction * radius**2), abs=4e-4)


def test_the_axis_stays_and_the_corner_moves_by_the_fraction():
    corner = image_placement.corner_mm(FIBRE_GRID)
    radial = image_placement.Radial(fraction=0.02, corner_mm=corner)
    x, _, area = radial.source(np.array([0.0, 1.02 * corner]), np.zeros(2))
    assert x == pytest.approx([0.0, corner], rel=1e-6)
    assert area == pytest.approx([1.0, 1.0 / (1.02 * 1.06)], rel=1e-6)


def test_shears_shift_whole_hexagons_by_the_stated_rms():
    offsets = pattern.multifibre_offsets(FIBRE_GRID, 0.3, 0.04, 5)
    kinds = np.unique(offsets[0])
    cells_per_hexagon = 0.3**2 * np.sqrt(3.0) / 2.0 / (FIBRE_GRID.cell_area_cm2 * 100.0)
    assert len(kinds) == pytest.approx(offsets[0].size / cells_per_hexagon, rel=0.25)
    # Neighbours 0.3 mm apart along a row are different hexagons everywhere.
    step = round(0.3 / (FIBRE_GRID.pitch_x_mm / 2))
    difference = offsets[:, :, step:] - offsets[:, :, :-step]
    rms = np.sqrt((difference**2).sum(axis=0).mean(dtype=float))
    assert rms == pytest.approx(0.04, rel=4.5 / np.sqrt(2 * len(kinds)))


def test_borders_of_shears_are_the_dark_lines_of_the_pattern():
    offsets = pattern.multifibre_offsets(FIBRE_GRID, 0.3 * 1.6, 0.04, 5)[0]
    lines = pattern.multifibre_transmission(FIBRE_GRID, 1.0, 0.3, 0.006, 1.6)
    for axis in (0, 1):
        border = np.diff(offsets, axis=axis) != 0.0
        beside = np.minimum(np.delete(lines, 0, axis), np.delete(lines, -1, axis))
        assert 0.02 < border.mean() < 0.1
        # A border runs between two cells: one of them is half a cell from a line 6 um wide at the
        # most.
        assert beside[border].max() < 0.9
        assert beside.mean() > 0.9


def test_shear_leaves_a_flat_flat_and_follows_its_specimen():
    flat = StageImage(values=np.full(FIBRE_GRID.shape, 2.0, np.float32), grid=FIBRE_GRID)
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


# The plate's gain: by control word, of stacks, under local load and after it, and over its multi-
# fibres.


GRID = grid_with_margin(60, 80, per_pixel=2, margin=10, pitch_x_mm=0.018, pitch_y_mm=0.0213)
# Luminous gain of a published intensified camera at six control words (physics reference, 1.4;
# truth 18).
CONTROL = {0: 2512, 51: 5012, 102: 9772, 153: 19055, 204: 36728, 255: 70795}


def _plate(**changes) -> MicrochannelPlate:
    given = {
        "detection_probability": 0.62,
        "pulse_height_shape": 1.0,
        "gain": 50.0,
        "saturation_e_per_s_cm2": 1e12,
    }
    return MicrochannelPlate(**given | {"field_s": 0.0167} | changes)


def _flat(level: float) -> StageImage:
    return StageImage(values=np.full(GRID.shape, level, np.float32), grid=GRID)


@pytest.mark.parametrize(("word", "luminous_gain"), CONTROL.items())
def test_control_word_follows_the_published_table(sheet, word, luminous_gain):
    """Truth 18, within 3 %."""
    gain = float(sheet.tube.luminous_gain) * tube_photometry.gain_factor(sheet, None, word)
    assert gain == pytest.approx(luminous_gain, rel=0.03)


def test_control_word_sets_the_gain_of_the_plate(sheet):
    camera = CameraModel(sheet)
    nominal = camera.stage(Slot.MCP, Conditions()).gain
    assert camera.stage(Slot.MCP, Conditions(gain_control=187.5)).gain == pytest.approx(
        1.95 * nominal, rel=1e-3
    )
    with pytest.raises(BadInput, match="same gain"):
        camera.chain(Conditions(gain_control=100.0, mcp_v=800.0))
    with pytest.raises(BadInput, match="em_gain"):
        camera.chain(Conditions(em_gain=100.0))


def test_flat_light_sees_the_same_gain_by_place_as_over_the_whole_plate():
    local, whole = _plate(depletion_blur_um=45.0), _plate()
    for level in (0.01, 1.0, 100.0):
        expected = whole.mean(_flat(level)).values
        assert local.mean(_flat(level)).values == pytest.approx(expected, rel=1e-5)
    half = 1e12 * GRID.cell_area_cm2 * 0.0167 / 50.0
    assert local.gain_under_load(_flat(half)) == pytest.approx(25.0, rel=1e-5)


def _point(level: float) -> StageImage:
    """A bright spot of 5 cells' width and a faint halo far from it."""
    values = np.full(GRID.shape, 1e-4 * level, np.float32)
    values[80:85, 100:105] = level
    return StageImage(values=values, grid=GRID)


def test_bright_core_compresses_while_its_halo_keeps_growing():
    plate = _plate(depletion_blur_um=45.0)
    cores, halos = zip(
        *(
            (out[82, 102], out[20, 20])
            for out in (plate.mean(_point(n)).values for n in (10.0, 1e3, 1e5))
        ),
        strict=True,
    )
    assert np.diff(np.log10(halos)) == pytest.approx([2.0, 2.0], abs=0.02)
    # A hundred times the light gives the core less than three times the electrons.
    assert np.log10(cores[2] / cores[1]) < 0.5
    assert cores[2] < plate.gain * 1e5 * 0.05


def test_load_reaches_as_far_as_its_blur():
    spot = np.zeros(GRID.shape)
    spot[80, 100] = 1e6
    load = _plate(gain=1.0, depletion_blur_um=45.0).load(spot, GRID)
    x = (np.arange(GRID.shape[1]) - 100) * GRID.pitch_x_mm / GRID.per_column
    y = (np.arange(GRID.shape[0]) - 80) * GRID.pitch_y_mm / GRID.per_row
    assert np.sqrt((load * x**2).sum() / load.sum()) == pytest.approx(0.045, rel=0.02)
    assert np.sqrt((load * y[:, None] ** 2).sum() / load.sum()) == pytest.approx(0.045, rel=0.02)
    assert load.sum() == pytest.approx(1e6 / (1e12 * GRID.cell_area_cm2 * 0.0167), rel=1e-6)


def test_mean_state_of_a_field_is_that_of_its_many_short_parts():
    whole, load, seen = _plate(recovery_ms=10.0), np.full((1, 1), 0.5), []
    state = start = np.full((1, 1), 2.0)
    for _ in range(1000):
        during, state = replace(whole, field_s=whole.field_s / 1000).states_under(state, load)
        seen.append(during.item())
    during, end = whole.states_under(start, load)
    assert (during.item(), end.item()) == pytest.approx((np.mean(seen), state.item()), rel=1e-9)


def test_multifibre_pattern_lowers_lines_and_keeps_the_gain():
    grid = grid_with_margin(480, 760, per_pixel=2, margin=10, pitch_x_mm=0.018, pitch_y_mm=0.0213)
    lines = pattern.multifibre_gain(grid, 0.04, 0.7, 0.02)
    assert lines.mean(dtype=float) == pytest.approx(1.0, abs=1e-6)
    assert lines.max() / lines.min() == pytest.approx(1.0 / 0.96, rel=0.01)
    assert np.median(lines) > 1.0
    # Hexagons of 0.7 mm between opposite sides repeat after 0.7 mm along a row.
    period = round(0.7 / (grid.pitch_x_mm / grid.per_column))
    contrast = (lines - lines.mean()).astype(float)
    correlation = (contrast[:, :-period] * contrast[:, period:]).mean() / contrast.var()
    assert correlation > 0.6
    assert (contrast[:, : -period // 2] * contrast[:, period // 2 :]).mean() / contrast.var() < 0.2


def test_pattern_of_the_plate_is_in_means_and_draws_alike(seed):
    plate = _plate(pattern_contrast=0.5, pattern_pitch_um=700.0, line_um=100.0)
    light = _flat(2000.0)
    drawn = plate.draw(light, np.random.default_rng(seed)).values
    expected = plate.mean(light).values
    assert expected.std() / expected.mean() > 0.05
    residual = drawn / expected - 1.0
    assert residual.std() == pytest.approx(np.sqrt(plate.excess_noise_factor / 2000.0), rel=0.02)


@pytest.mark.parametrize(
    "change",
    [
        {"pattern_contrast": 1.0},
        {"pattern_contrast": -0.1},
        {"gain": float("nan")},
        {"recovery_ms": 0.0},
        {"depletion_blur_um": -1.0},
        {"saturation_e_per_s_cm2": 0.0},
    ],
)
def test_impossible_plates_are_refused(change):
    with pytest.raises(BadInput):
        _plate(**change)


def test_lines_narrower_than_a_cell_take_as_much_light_wherever_they_fall():
    """Lines of 6 um on cells of 10 and of 5 um: hexagons of pitch p have 2/p of border per area."""
    lost = []
    for per_pixel in (2, 4):
        grid = grid_with_margin(
            200, 300, per_pixel=per_pixel, margin=10, pitch_x_mm=0.018, pitch_y_mm=0.0213
        )
        lines = pattern.multifibre_gain(grid, 0.5, 0.7, 0.006)
        lost.append(1.0 - 1.0 / lines.max())
    # Across a line the loss is a Gaussian of 3 um standard deviation.
    assert lost == pytest.approx([0.5 * 0.003 * np.sqrt(2.0 * np.pi) * 2.0 / 0.7] * 2, rel=0.02)


# The halo: as wide as four gaps whatever the light, and flat with a bright rim for elastic
# electrons.


GAP_MM = 0.21
# Section 1.5: density times d^2 at r/d = 0.1, 0.3, ... 1.9, elastic and for energies uniform in
# 0..1.
ELASTIC = [0.040, 0.040, 0.041, 0.042, 0.045, 0.048, 0.053, 0.061, 0.077, 0.182]
UNIFORM = [1.21, 0.38, 0.21, 0.14, 0.10, 0.07, 0.05, 0.04, 0.03, 0.01]


def _landing(rng: np.random.Generator, elastic: bool, count: int) -> np.ndarray:
    """Distances, in gaps, of electrons re-emitted by the cosine law: r = 2 e d sin(2 t)."""
    angle = np.arcsin(np.sqrt(rng.random(count)))
    energy = 1.0 if elastic else rng.random(count)
    return 2.0 * energy * np.sin(2.0 * angle)


@pytest.mark.parametrize(("elastic", "table"), [(True, ELASTIC), (False, UNIFORM)])
def test_cosine_emission_lands_within_two_gaps_as_tabulated(elastic, table, seed):
    distance = _landing(np.random.default_rng(seed), elastic, 400_000)
    assert distance.max() <= 2.0
    assert not elastic or distance.max() > 2.0 - 1e-6
    edges = np.linspace(0.0, 2.0, 11)
    density = np.histogram(distance, edges)[0] / len(distance) / (np.pi * np.diff(edges**2))
    assert density == pytest.approx(table, rel=0.03, abs=0.006)


@pytest.mark.parametrize("elastic", [True, False])
def test_transfer_is_the_hankel_transform_of_the_landing_distances(elastic, seed):
    from scipy.special import j0

    count = 200_000
    distance_mm = GAP_MM * _landing(np.random.default_rng(seed), elastic, count)
    halo = HaloBlur(fraction=1.0, gap_mm=GAP_MM, elastic_share=float(elastic))
    for frequency in (0.3, 1.0, 3.0, 8.0):
        sample = j0(2.0 * np.pi * frequency * distance_mm)
        found = float(halo.transfer(np.array([frequency]), np.array([0.0]))[0])
        assert abs(sample.mean() - found) < 4.5 * sample.std() / np.sqrt(count)


def test_halo_of_the_camera_ends_at_four_gaps_at_every_light_level(plain):
    """A sharp elastic halo on a nearly blurless tube: no light of the point beyond two gaps."""
    sensor = plain(
        120,
        120,
        photocathode__halo_elastic_share=1.0,
        photocathode__ebi_lm_per_cm2=0.0,
        tube__mtf_frequency_lp_per_mm=400.0,
        tube__mtf_exponent=2.0,
        ccd__full_well_e=1e12,
    )
    bench, target = LabBench(sensor), Target(pinhole_px=1.5)
    radius_px = true_quantities.true_quantities(sensor)["halo_diameter"] / 2.0
    assert 2.0 * radius_px == pytest.approx(4.0 * GAP_MM / 0.018)
    row, col = np.indices((120, 120))
    distance = np.hypot(col + 0.5 - 60.0, (row + 0.5 - 60.0) * 13.0 / 11.0)
    for lux in (1e-3, 1e-1):
        light = bench.mean("point", target, Conditions(illuminance_lux=lux)) - 400.0
        background = np.median(light[distance > radius_px + 12.0])
        rim = light[np.abs(distance - radius_px + 1.0) < 1.0].mean() - background
        plateau = light[(distance > 6.0) & (distance < 12.0)].mean() - background
        beyond = (
            light[(distance > radius_px + 4.0) & (distance < radius_px + 10.0)].mean() - background
        )
        assert rim > 1.5 * plateau > 0.0
        assert abs(beyond) < 0.06 * plateau


def test_halo_holds_its_fraction_of_the_light(plain):
    sensor = plain(120, 120, photocathode__ebi_lm_per_cm2=0.0, photocathode__halo_fraction=0.2)
    bench, conditions = LabBench(sensor), Conditions(illuminance_lux=1e-2)
    plate = bench.mcp_input("point", Target(pinhole_px=3.0), conditions).values
    none = LabBench(sensor.with_values({"photocathode.halo_fraction": 0.0}))
    sharp = none.mcp_input("point", Target(pinhole_px=3.0), conditions).values
    # The holder's ring glows beside the picture and its halo reaches in.
    assert plate.sum() == pytest.approx(sharp.sum(), rel=2e-3)
    grid = bench.camera.cells
    y, x = ((np.arange(n) + 0.5) / 2 - 10.0 for n in grid.shape)
    distance = np.hypot((x - 60.0)[None, :], ((y - 60.5) * 13.0 / 11.0)[:, None])
    far = (distance > 4.0) & (distance < 30.0)
    # The density of the mixed halo falls off as tabulated; what lies within 4 px is the rest.
    inside = 0.3 * (1.0 - np.sqrt(1.0 - (4.0 / 23.33) ** 2))
    reach = 4.0 / 23.33
    spread = 0.7 * (
        1.0 - np.mean(np.sqrt(np.maximum(0.0, 1.0 - (reach / np.linspace(5e-4, 1.0, 2000)) ** 2)))
    )
    expected = 0.2 * (1.0 - inside - spread) * sharp.sum()
    assert (plate - sharp)[far].sum() == pytest.approx(expected, rel=0.05)
