"""The plate's gain: by control word, of stacks, under local load and after it, and over its
multi-fibres.
"""

from dataclasses import replace

import numpy as np
import pytest

from labdata import BadInput, Conditions
from simulate.camera import (
    CameraModel,
    MicrochannelPlate,
    Slot,
    StageImage,
    grid_with_margin,
    pattern,
    tube_photometry,
)

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


@pytest.mark.parametrize("recovery_ms", [1.0, 10.0, 100.0])
def test_channels_recover_with_their_time_constant(recovery_ms):
    plate = _plate(recovery_ms=recovery_ms)
    none, load = np.zeros((1, 1)), np.full((1, 1), 3.0)
    state = load
    for fields in range(1, 6):
        _, state = plate.states_under(state, none)
        assert state.item() == pytest.approx(3.0 * np.exp(-fields * 16.7 / recovery_ms))
    for _ in range(int(np.ceil(20 * recovery_ms / 16.7))):
        during, state = plate.states_under(state, load)
    assert (during.item(), state.item()) == pytest.approx((3.0, 3.0), rel=1e-6)


def test_mean_state_of_a_field_is_that_of_its_many_short_parts():
    whole, load, seen = _plate(recovery_ms=10.0), np.full((1, 1), 0.5), []
    state = start = np.full((1, 1), 2.0)
    for _ in range(1000):
        during, state = replace(whole, field_s=whole.field_s / 1000).states_under(state, load)
        seen.append(during.item())
    during, end = whole.states_under(start, load)
    assert (during.item(), end.item()) == pytest.approx((np.mean(seen), state.item()), rel=1e-9)


def test_steady_light_through_depleted_plate_is_its_steady_map():
    plate, light = _plate(depletion_blur_um=45.0), _point(300.0)
    load = plate.load(light.values, GRID)
    during, _ = plate.states_under(load, load)
    assert plate.with_depletion(during).mean(light).values == pytest.approx(
        plate.mean(light).values, rel=1e-5
    )


def test_draws_under_a_local_load_average_to_its_mean(seed):
    plate, light = _plate(depletion_blur_um=45.0), _point(300.0)
    loaded = plate.under_load(light, parts=2)
    half = light.with_values(0.5 * light.values)
    assert 2.0 * loaded.mean(half).values == pytest.approx(plate.mean(light).values, rel=1e-5)
    rng = np.random.default_rng(seed)
    sums = np.array(
        [loaded.draw(half, rng).values[80:85, 100:105].sum(dtype=float) for _ in range(200)]
    )
    expected = plate.mean(light).values[80:85, 100:105].sum(dtype=float) / 2.0
    assert abs(sums.mean() - expected) < 4.5 * sums.std(ddof=1) / np.sqrt(200)


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
