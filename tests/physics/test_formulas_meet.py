"""The fit's formulas and the simulator's were written apart: here they meet, at specimens that
nobody chose.
"""

import numpy as np
import pytest

from charact.fitting import predicted_quantities
from charact.observables import Values
from labdata import Camera, Conditions, load_sensor
from simulate.camera import true_quantities
from simulate.virtual_bench import true_sensor

GATE_S = 0.0133
MCP_V = 780.0
FREQUENCY = np.linspace(0.02, 0.6, 30)


@pytest.fixture(scope="module", params=range(4))
def specimen(request: pytest.FixtureRequest, seed: int) -> Camera:
    return true_sensor.draw_true_sensor(load_sensor("pulnix-ag5745ef3"), seed + request.param)


@pytest.fixture(scope="module")
def values(specimen: Camera) -> Values:
    known = {
        path: np.array([float(parameter)]) for path, parameter in specimen.parameters().items()
    }
    return {**known, "video.filter_order": np.array([float(specimen.video.filter_order)])}


def test_the_mtf_is_the_same_in_both_directions(specimen: Camera, values: Values) -> None:
    pitch_ratio = float(specimen.ccd.pitch_y_um) / float(specimen.ccd.pitch_x_um)
    for direction, at in (
        ("horizontal", (FREQUENCY,)),
        ("vertical", (0.0 * FREQUENCY, FREQUENCY * pitch_ratio)),
    ):
        expected = true_quantities.true_mtf(specimen, FREQUENCY, direction)
        assert predicted_quantities.mtf(values, *at)[0] == pytest.approx(
            expected, rel=1e-3, abs=1e-6
        )


def test_every_quantity_of_the_camera_is_the_same(specimen: Camera, values: Values) -> None:
    told = true_quantities.true_quantities(specimen, Conditions(mcp_v=MCP_V, gate_ns=GATE_S * 1e9))
    reference_v = float(specimen.microchannel_plate.reference_v)
    gain = predicted_quantities.photoelectron_gain(values, MCP_V, reference_v)
    for name, found, within in (
        ("photoelectron_gain", gain, 1e-6),
        ("excess_noise_factor", predicted_quantities.excess_noise_factor(values), 1e-9),
        ("covariance_gain", predicted_quantities.covariance_gain(values, gain), 1e-6),
        ("blur_factor", predicted_quantities.blur_factor(values, gain), 0.02),
        ("halo_diameter", predicted_quantities.halo_diameter_px(values), 1e-9),
        ("ebi", predicted_quantities.background_rate(values), 1e-6),
        ("photoelectrons_per_lux", predicted_quantities.photoelectrons(values, 1.0, GATE_S), 1e-6),
        ("decay_factor", predicted_quantities.lag_noise_fraction(values, GATE_S), 2e-3),
    ):
        assert found[0] == pytest.approx(told[name], rel=within), name


def test_blur_table_of_the_physics_reference() -> None:
    """Row pairs of a tube with fc 26.25 lp/mm and n 1.184, its video filter aside: 0.331 at a share
    of 0.8 (5.2).
    """
    sensor = load_sensor("pulnix-ag5745ef3")
    known = {path: np.array([float(parameter)]) for path, parameter in sensor.parameters().items()}
    # The table's taper is a Gaussian of 80 lp/mm at the cathode without fibres, and its pixel clock
    # is not filtered.
    known |= {
        "video.filter_order": np.array([3.0]),
        "video.bandwidth_mhz": np.array([1e3]),
        "taper.fibre_pitch_um": np.array([1e-3]),
        "taper.interface_mtf_lp_per_mm": np.array([80.0 * 18.0 / 11.0]),
    }
    for share, expected in ((1.0, 0.282), (0.8, 0.331), (0.5, 0.434), (0.25, 0.562)):
        known["tube.post_gain_share"] = np.array([share])
        assert predicted_quantities.blur_factor(known, np.array([10.0]))[0] == pytest.approx(
            expected, rel=0.03
        )
