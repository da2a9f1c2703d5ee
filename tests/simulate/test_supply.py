"""The cathode and its supply: the gate leaks by its ratio, bright light lowers the gap voltage and
widens its blur.
"""

import numpy as np
import pytest

from labdata import BadInput, Conditions
from simulate.camera import BrightSourceProtection, CameraModel, Photocathode, Slot, StageImage


@pytest.fixture
def supply() -> BrightSourceProtection:
    return BrightSourceProtection(
        gap_v=800.0,
        bright_source_v=400.0,
        bright_source_lux=1.0,
        gap_mm=0.21,
        lateral_energy_ev=0.1,
    )


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
    "change", [{"bright_source_v": 900.0}, {"bright_source_v": 0.0}, {"bright_source_lux": 0.0}]
)
def test_impossible_supplies_are_refused(change):
    given = {
        "gap_v": 800.0,
        "bright_source_v": 400.0,
        "bright_source_lux": 1.0,
        "gap_mm": 0.21,
        "lateral_energy_ev": 0.1,
    }
    with pytest.raises(BadInput):
        BrightSourceProtection(**given | change)


@pytest.mark.parametrize("change", [{"gate_s": 0.0}, {"gate_s": -1.0}, {"on_off_ratio": 0.5}])
def test_impossible_gates_are_refused(change):
    with pytest.raises(BadInput):
        Photocathode(**{"quantum_efficiency": 0.2, "gate_s": 1e-3, "ebi_per_s_cm2": 0.0} | change)
