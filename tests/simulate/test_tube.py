"""The tube follows from its data sheet; its supply lowers the gap voltage in bright light."""

import numpy as np
import pytest

from labdata import BadInput, Conditions
from simulate.camera import (
    ELEMENTARY_CHARGE_C,
    JOULE_METRE,
    BrightSourceProtection,
    CameraModel,
    MicrochannelPlate,
    Photocathode,
    Slot,
    StageImage,
    grid_with_margin,
    key_of,
    poisson_numbers,
    true_quantities,
    tube_photometry,
)

# The tube's numbers follow from its data sheet as the reference calculations say (physics
# reference, section 8).


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


# The cathode and its supply: the gate leaks by its ratio, bright light lowers the gap voltage and
# widens its blur.


SUPPLY = {
    "gap_v": 800.0,
    "bright_source_v": 400.0,
    "bright_source_lux": 1.0,
    "gap_mm": 0.21,
    "lateral_energy_ev": 0.1,
}
CATHODE = {"quantum_efficiency": 0.2, "gate_s": 1e-3, "ebi_per_s_cm2": 0.0}


@pytest.fixture
def supply() -> BrightSourceProtection:
    return BrightSourceProtection(**SUPPLY)


def _transfer(blur, frequency: float) -> float:
    return float(blur.transfer(np.array([frequency]), np.zeros(1))[0])


@pytest.mark.parametrize(
    ("voltage_v", "radius_um", "at_64"), [(800.0, 4.7, 0.41), (400.0, 6.6, 0.17)]
)
def test_flight_across_the_gap_is_that_of_table_1_5(supply, voltage_v, radius_um, at_64):
    from simulate.camera import GapSpread

    radius = supply.flight_um(voltage_v)
    assert radius == pytest.approx(radius_um, abs=0.05)
    assert _transfer(GapSpread(radius_um=radius), 64.0) == pytest.approx(at_64, abs=0.005)


def test_voltage_falls_linearly_with_light_to_its_floor(supply):
    assert [supply.voltage_v(lux) for lux in (0.0, 0.25, 1.0, 50.0)] == pytest.approx(
        [800.0, 700.0, 400.0, 400.0]
    )


def test_only_what_the_full_voltage_does_not_explain_is_a_further_blur(supply):
    assert supply.blur(0.0) is None
    extra = supply.blur(1.0)
    assert _transfer(extra, 64.0) * 0.41 == pytest.approx(0.17, abs=0.003)


def test_gap_keeps_all_electrons_under_protection(plain):
    camera = CameraModel(plain(24, 40))
    rng = np.random.default_rng(1)
    light = StageImage(
        values=rng.random(camera.scene_cells.shape, np.float32), grid=camera.scene_cells
    )
    free, bright = (camera.to_plate(Conditions(), lux).mean(light) for lux in (0.0, 1.0))
    assert bright.values.sum(dtype=float) == pytest.approx(free.values.sum(dtype=float), rel=1e-3)
    assert bright.values.std() < 0.99 * free.values.std()


@pytest.mark.parametrize("ratio", [1e9, 1e4, 1.0])
def test_shut_gate_passes_light_and_dark_by_its_ratio(ratio):
    gate = Photocathode(
        quantum_efficiency=0.2, gate_s=1e-6, ebi_per_s_cm2=3e5, on_off_ratio=ratio, field_s=0.016
    )
    assert gate.open_s == pytest.approx(1e-6 + (0.016 - 1e-6) / ratio, rel=1e-12)
    assert gate.mean(StageImage(values=np.array([[5.0]]))).values.item() == pytest.approx(
        gate.open_s, rel=1e-9
    )


def test_gate_open_all_the_field_has_nothing_to_leak(sheet):
    cathode = CameraModel(sheet).stage(Slot.PHOTOCATHODE, Conditions())
    assert cathode.open_s == cathode.gate_s


@pytest.mark.parametrize(
    ("make", "change"),
    [
        (BrightSourceProtection, SUPPLY | {"bright_source_v": 900.0}),
        (BrightSourceProtection, SUPPLY | {"bright_source_v": 0.0}),
        (BrightSourceProtection, SUPPLY | {"bright_source_lux": 0.0}),
        (Photocathode, CATHODE | {"gate_s": 0.0}),
        (Photocathode, CATHODE | {"gate_s": -1.0}),
        (Photocathode, CATHODE | {"on_off_ratio": 0.5}),
    ],
)
def test_impossible_supplies_and_gates_are_refused(make, change):
    with pytest.raises(BadInput):
        make(**change)
