"""The stages of a budget and the simulator's were written apart: here they meet, at specimens that
nobody chose.
"""

import numpy as np
import pytest

from charact.estimators.mtf.session.mtf_budget import MeasuredCurve, MeasuredCurves, fit_mtf_budget
from charact.estimators.mtf.session.stage_transfers import STAGES, Direction, StageModel
from labdata import Camera, load_sensor
from simulate.camera import true_quantities
from simulate.virtual_bench import true_sensor

FREQUENCY = np.linspace(0.02, 0.48, 24)
DIRECTIONS: tuple[Direction, ...] = ("horizontal", "vertical")


def per_pitch(sensor: Camera, direction: Direction) -> float:
    """Pitches of the direction's pixels in a column pitch."""
    return (
        float(sensor.ccd.pitch_y_um) / float(sensor.ccd.pitch_x_um)
        if direction == "vertical"
        else 1.0
    )


@pytest.mark.parametrize("name", ["pulnix-ag5745ef3", "gen3-digital-iccd"])
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_the_product_of_the_stages_is_the_simulated_camera(
    name: str, direction: Direction, seed: int
) -> None:
    described = load_sensor(name)
    for number in range(3):
        sensor = true_sensor.draw_true_sensor(described, seed + number)
        model = StageModel.of(sensor, interlaced=sensor.video.interlaced, halo=True)
        found = model.mtf(model.mean[None], FREQUENCY * per_pitch(sensor, direction), direction)[0]
        assert found == pytest.approx(
            true_quantities.true_mtf(sensor, FREQUENCY, direction), abs=2e-3
        )


def test_stages_of_specimens_lie_in_their_intervals(seed: int) -> None:
    """Of 12 specimens' stages at 0.2 cycles per column pitch 95 % intervals hold as many, within 4
    standard errors.

    Curves exact to 0.004, each with a description whose ranges the specimen was drawn from.
    """
    described, rng = load_sensor("pulnix-ag5745ef3"), np.random.default_rng(seed)
    held = []
    for number in range(12):
        specimen = true_sensor.draw_true_sensor(described, seed + number)
        curves = [
            MeasuredCurves(
                curves=(
                    MeasuredCurve(
                        direction=direction,
                        frequency_cy_per_px=FREQUENCY * per_pitch(specimen, direction),
                        value=true_quantities.true_mtf(specimen, FREQUENCY, direction)
                        + 0.004 * rng.standard_normal(FREQUENCY.size),
                    ),
                ),
                covariance=0.004**2 * np.eye(FREQUENCY.size),
            )
            for direction in DIRECTIONS
        ]
        # Pitches of a specimen are those of its description; the gap is what its point sources
        # told.
        gap = {"photocathode.gap_mm": specimen.photocathode.gap_mm}
        found = fit_mtf_budget(
            curves, described.with_parameters(gap), interlaced=True, seed=1, quick=True, halo=True
        )
        assert found.chance > 1e-4
        exact = StageModel.of(specimen, interlaced=True, halo=True)
        logs = exact.log_stages(exact.mean[None], np.array([0.2]), "horizontal")[:, 0, 0]
        for stage, value in zip(STAGES, np.exp(logs), strict=True):
            low, high = np.quantile(
                found.product((stage,), np.array([0.2]), "horizontal"), [0.025, 0.975]
            )
            if stage not in found.known:
                held.append(low <= value <= high)
    assert abs(np.mean(held) - 0.95) < 4.0 * np.sqrt(0.95 * 0.05 / 12), np.mean(held)
