"""The tube's numbers follow from its data sheet as the reference calculations say (physics
reference, section 8).
"""

import numpy as np
import pytest

from simulate.camera import (
    ELEMENTARY_CHARGE_C,
    JOULE_METRE,
    CameraModel,
    MicrochannelPlate,
    StageImage,
    grid_with_margin,
    key_of,
    poisson_numbers,
    true_quantities,
    tube_photometry,
)


def test_gallium_arsenide_of_table_1_2_has_1996_microamperes_per_lumen(sheet):
    cathode = sheet.photocathode
    table = np.asarray(cathode.relative_quantum_efficiency)
    assert tube_photometry.luminous_sensitivity(cathode.wavelength_nm, table) == pytest.approx(
        1996, rel=0.01
    )
    at_830 = (
        np.interp(830.0, cathode.wavelength_nm, table) * ELEMENTARY_CHARGE_C * 830e-9 / JOULE_METRE
    )
    assert at_830 * 1e3 == pytest.approx(228, rel=0.005)


def test_scaled_quantum_efficiency_gives_the_sheets_sensitivity(sheet):
    fine = np.arange(400.0, 1000.0, 1.0)
    found = tube_photometry.luminous_sensitivity(
        fine, tube_photometry.quantum_efficiency(sheet, fine)
    )
    assert found == pytest.approx(1350, rel=1e-3)


def test_ebi_is_1_13_photoelectrons_per_second_and_pixel_of_one_row(sheet):
    assert true_quantities.true_quantities(sheet)["ebi"] / 2.0 == pytest.approx(1.129, rel=1e-3)


def test_ebi_doubles_with_six_kelvin(sheet):
    assert tube_photometry.ebi_per_s_cm2(sheet, 31.0) == pytest.approx(
        2.0 * tube_photometry.ebi_per_s_cm2(sheet, 25.0)
    )


def test_luminous_gain_15000_is_10229_photons_per_photoelectron(sheet):
    assert tube_photometry.photons_per_photoelectron(sheet) == pytest.approx(10229, rel=1e-3)


def test_gain_doubles_within_45_to_70_volt_of_800(sheet):
    for step_v in (45.0, 70.0):
        factor = tube_photometry.gain_factor(sheet, 800.0 + step_v, None)
        assert (factor < 2.0) == (step_v < 57.0)


# Section 1.4: relative variance of pulse heights 0.5 (shape 2) and 1 (exponential).
def drawn_pulses(
    plate: MicrochannelPlate, level: float, count: int, rng: np.random.Generator
) -> np.ndarray:
    """Sums of the pulses in so many cells that expect a level of photoelectrons."""
    grid = grid_with_margin(1, 1, per_pixel=2, margin=0, pitch_x_mm=0.018, pitch_y_mm=0.018)
    light = StageImage(values=np.full((1, count), level, np.float32), grid=grid)
    return plate.draw(light, rng).values.ravel().astype(float)


@pytest.mark.parametrize(
    ("probability", "shape", "factor"),
    [
        (1.0, 2.0, 1.50),
        (1.0, 1.0, 2.00),
        (0.75, 2.0, 2.00),
        (0.63, 2.0, 2.38),
        (0.63, 1.0, 3.17),
        (0.5, 1.0, 4.00),
    ],
)
@pytest.mark.parametrize("level", [0.05, 30.0])
def test_excess_noise_factor_of_drawn_pulses(probability, shape, factor, level, seed):
    plate = MicrochannelPlate(
        detection_probability=probability,
        pulse_height_shape=shape,
        gain=1.0,
        saturation_e_per_s_cm2=np.inf,
        field_s=1.0,
    )
    assert plate.excess_noise_factor == pytest.approx(factor, abs=0.006)
    count = 200_000
    rng = np.random.default_rng([seed, int(1000 * level), int(100 * probability), int(shape)])
    pulses = drawn_pulses(plate, level, count, rng)
    assert abs(pulses.mean() - level) < 4.5 * np.sqrt(level * plate.excess_noise_factor / count)
    squares = (pulses - level) ** 2
    assert abs(squares.mean() - level * plate.excess_noise_factor) < 4.5 * squares.std() / np.sqrt(
        count
    )


@pytest.mark.parametrize("level", [0.3, 6.0, 11.9, 12.1, 150.0, 5000.0])
def test_charge_is_poisson(level, seed):
    from scipy import stats

    count = 200_000
    charge = poisson_numbers(key_of(seed, 1, int(10 * level)), np.full(count, level, np.float32))
    assert abs(charge.mean(dtype=float) - level) < 4.5 * np.sqrt(level / count)
    edges = stats.poisson.ppf(np.linspace(0.0, 1.0, 21)[1:-1], level)
    edges = np.unique(edges)
    expected = np.diff(np.concatenate([[0.0], stats.poisson.cdf(edges, level), [1.0]])) * count
    found = np.bincount(np.searchsorted(edges, charge), minlength=len(edges) + 1)
    chi2 = np.sum((found - expected) ** 2 / expected)
    # Tail probability of 4.5 standard deviations.
    assert chi2 < stats.chi2.isf(3.4e-6, len(expected) - 1)


def test_plate_saturates_to_half_at_its_saturation_current(sheet):
    from labdata import Conditions

    camera = CameraModel(sheet)
    plate = camera.chain(Conditions()).stages[3]
    per_s_cm2 = plate.saturation_e_per_s_cm2 / plate.gain
    cell = per_s_cm2 * camera.field_s * camera.cells.cell_area_cm2
    light = StageImage(values=np.full((8, 8), cell, np.float32), grid=camera.cells)
    assert plate.gain_under_load(light).item() == pytest.approx(plate.gain / 2.0, rel=1e-5)
