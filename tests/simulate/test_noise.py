"""True quantities of noise agree with cascade theory (physics reference, 5.2, 6.4 and 10)."""

from dataclasses import dataclass

import numpy as np
import pytest

from simulate.camera import (
    PixelAperture,
    TubeShare,
    true_quantities,
)
from tests.simulate import pulse_theory


@dataclass(frozen=True)
class GaussianFibres:
    """The fibres of table 5.2, a Gaussian of 80 lp/mm at the photocathode."""

    def transfer(self, fx_per_mm, fy_per_mm):
        return np.exp(-(fx_per_mm**2 + fy_per_mm**2) / 80.0**2)


# Post-gain share; blur factor and correlation in the row for single rows (21.3 um), then for row
# pairs (42.5 um).
TABLE = [
    (1.0, 0.204, 0.45, 0.38, 0.282, 0.47, 0.18),
    (0.8, 0.250, 0.39, 0.33, 0.331, 0.41, 0.15),
    (0.5, 0.349, 0.29, 0.24, 0.434, 0.31, 0.11),
    (0.25, 0.482, 0.20, 0.17, 0.562, 0.21, 0.08),
    (0.0, 0.701, 0.11, 0.09, 0.762, 0.11, 0.04),
]


def _johnson(share: float) -> TubeShare:
    return TubeShare(share=share, frequency_lp_per_mm=26.25, exponent=1.184)


@pytest.mark.parametrize("row", TABLE)
def test_blur_factor_and_correlations_are_those_of_table_5_2(row):
    share, *published = row
    for height_mm, expected in ((0.0213, published[:3]), (0.0425, published[3:])):
        blurs = (
            _johnson(share),
            GaussianFibres(),
            PixelAperture(width_mm=0.018, height_mm=height_mm),
        )
        found = true_quantities.pulse_correlation(blurs, None, 0.018, height_mm)
        assert found[0] == pytest.approx(expected[0], abs=1.5e-3)
        assert found[1:] == pytest.approx(expected[1:], abs=6e-3)


NO_DECAY = {"phosphor__fast_decay_ms": 1e-9, "phosphor__slow_decay_ms": 1e-9}


@pytest.mark.parametrize("decay", [{}, NO_DECAY], ids=["glowing", "without decay"])
def test_truths_of_the_noise_of_flats_are_campbells(decay, plain):
    """The moments of frames are held against the same theory in test_moments.py."""
    sensor, level = plain(120, 160, **decay), 3.0
    truths, camera = true_quantities.true_quantities(sensor), pulse_theory.of_sensor(sensor)
    theory = pulse_theory.campbell(camera, level)
    shares, weight = pulse_theory.field_shares(camera)
    dn_per_e = float(sensor.video.conversion_gain_dn_per_e)
    signal = truths["photoelectron_gain"] * 2.0 * level
    assert dn_per_e * theory.mean == pytest.approx(signal, rel=1e-3)
    # All the light of a pulse lies on the pixels of a field, whatever its blur.
    pulses = float(weight @ np.sum(shares**2, axis=1)) * camera.height_moment(2)
    covariance_gain = dn_per_e * (1.0 + pulses / camera.height_moment(1))
    assert truths["field_covariance_gain"] == pytest.approx(covariance_gain, rel=1e-3)
    variance = dn_per_e**2 * theory.variance - truths["read_noise"] ** 2
    assert truths["blur_factor"] * covariance_gain * signal == pytest.approx(variance, rel=3e-3)
    # The next line of a field is the line after next of the frame.
    shared = dn_per_e**2 * np.array([theory.horizontal[0], theory.vertical[1]]) / variance
    correlations = [truths["correlation_horizontal"], truths["correlation_vertical"]]
    assert correlations == pytest.approx(shared, abs=2e-3)


def test_without_decay_field_and_pulse_have_one_covariance_gain(plain):
    q = true_quantities.true_quantities(plain(120, 160, **NO_DECAY))
    assert q["covariance_gain"] == pytest.approx(
        q["system_gain"] + q["photoelectron_gain"] * q["excess_noise_factor"]
    )
    assert q["field_covariance_gain"] == pytest.approx(q["covariance_gain"], rel=1e-3)
    assert q["field_correlation"] == pytest.approx(0.0, abs=1e-6)
