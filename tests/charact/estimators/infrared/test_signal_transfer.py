"""Black-body law, and the slope of the signal against temperature at a stated background."""

import numpy as np
import pytest
from scipy.special import chdtrc

from charact.estimators.infrared import INFRARED, Response, fit_signal_transfer
from labdata import BadInput
from tests.truth.infrared import Camera, band_radiance

PHOTON_J_UM = 6.62607015e-34 * 2.99792458e8 * 1e6
# T (K), band (um): L, dL/dT, photon radiance by quadrature and by series, CODATA 2018.
PLANCK = [
    (273.15, 3, 5, 0.644266, 0.0278635, 1.45943e19),
    (273.15, 8, 12, 23.8219, 0.465701, 1.20516e21),
    (273.15, 8, 14, 35.1520, 0.637354, 1.94537e21),
    (300, 3, 5, 1.86596, 0.0676983, 4.18311e19),
    (300, 3.4, 4.1, 0.331898, 0.0138860, 6.40040e18),
    (300, 7.5, 13.5, 55.4916, 0.882489, 2.91534e21),
    (300, 8, 12, 38.5004, 0.629704, 1.93596e21),
    (310, 3, 5, 2.65284, 0.0905267, 5.92467e19),
    (310, 8, 14, 63.6944, 0.914474, 3.47678e21),
]


@pytest.mark.parametrize(("kelvin", "low", "high", "radiance", "derivative", "photons"), PLANCK)
def test_band_radiance_agrees_with_the_table(kelvin, low, high, radiance, derivative, photons):
    energy, counted = (Response(low_um=low, high_um=high, photons=count) for count in (False, True))
    assert float(energy.radiance(kelvin)) == pytest.approx(radiance, rel=3e-6)
    assert float(energy.derivative(kelvin)) == pytest.approx(derivative, rel=3e-6)
    assert float(counted.radiance(kelvin)) / PHOTON_J_UM == pytest.approx(photons, rel=3e-6)
    assert float(energy.radiance(kelvin)) == pytest.approx(
        band_radiance(low, high, kelvin)[0], rel=1e-8
    )


@pytest.mark.parametrize(("low", "high", "growth"), [(8, 12, 0.052), (3, 5, 0.165)])
def test_contrast_per_kelvin_grows_from_295_to_300(low, high, growth):
    band = Response(low_um=low, high_um=high)
    assert float(band.derivative(300.0) / band.derivative(295.0)) - 1.0 == pytest.approx(
        growth, abs=5e-4
    )


def fit(camera, celsius, *, background_c=22.0, band_um=None, error_k=0.0, rng=None, seed=0):
    rng = rng or np.random.default_rng(seed)
    celsius = np.asarray(celsius, float)
    mean = camera.mean_dn(celsius + error_k * rng.standard_normal(len(celsius)))
    return fit_signal_transfer(
        celsius + 273.15,
        mean,
        np.full(len(mean), 0.02),
        band_um=band_um,
        rng=rng,
        background_k=None if background_c is None else background_c + 273.15,
    )


@pytest.mark.parametrize("band", [(3.0, 5.0), (8.0, 12.0)])
def test_the_slope_is_that_at_the_background_wherever_the_levels_lie(band):
    """Levels 3 to 13 K above the background: a straight line would be 8 and 28 % too steep."""
    camera, levels = Camera(band_um=band), [25, 27, 30, 32, 35]
    straight = np.polyfit(levels, camera.mean_dn(levels), 1)[0]
    assert straight > 1.07 * camera.sitf_dn_per_k
    found = fit(camera, levels, band_um=band)
    assert np.median(found.sitf) == pytest.approx(camera.sitf_dn_per_k, rel=0.005)
    unknown = np.quantile(fit(camera, levels).sitf, [0.025, 0.975])
    assert unknown[0] < camera.sitf_dn_per_k < unknown[1]


def test_two_levels_of_an_unknown_band_leave_its_bend_in_the_interval():
    """From 22 to 27 C the mean slope of 3-5 um exceeds that at 22 C by 8 %, of a linear camera by
    0.
    """
    for band in ((3.0, 5.0), (8.0, 12.0), None):
        low, high = np.quantile(fit(Camera(band_um=band), [22, 27]).sitf, [0.025, 0.975])
        assert low < 20.0 < high
        assert high - low > 0.08 * 20.0


def test_an_unknown_background_lies_anywhere_between_the_levels():
    low, high = np.quantile(
        fit(Camera(band_um=(3.0, 5.0)), [17, 20, 22, 25, 27], background_c=None).sitf, [0.02, 0.98]
    )
    ends = [Response(low_um=3, high_um=5).derivative(273.15 + t) for t in (17.5, 22.0, 26.5)]
    assert low < 20.0 * ends[0] / ends[1]
    assert high > 20.0 * ends[2] / ends[1]


@pytest.mark.parametrize("levels", [[20, 25], [18, 22, 26], [17, 20, 22, 25, 28]])
@pytest.mark.parametrize("error_k", [0.005, 0.02])
def test_intervals_hold_the_truth_with_an_ordinary_black_body(levels, error_k, seed):
    """60 sessions of 95 % intervals: 57 hold on average; 50 is four standard errors below."""
    rng, held = np.random.default_rng([seed, len(levels)]), 0
    for _ in range(60):
        low, high = np.quantile(
            fit(Camera(), levels, band_um=(8, 12), error_k=error_k, rng=rng).sitf, [0.025, 0.975]
        )
        held += low <= 20.0 <= high
    assert held >= 50


def test_a_black_body_five_times_worse_than_taken_is_seen(seed):
    """Five levels that err by 0.1 K, 60 times: chi squared tells 88 % of them (53, five standard
    errors less are 40), and one in a hundred is neither seen nor inside twice its interval (five
    standard errors more are 4).
    """
    rng, seen, silent = np.random.default_rng([seed, 1]), 0, 0
    for _ in range(60):
        found = fit(Camera(), [17, 20, 22, 25, 28], band_um=(8, 12), error_k=0.1, rng=rng)
        low, middle, high = np.quantile(found.sitf, [0.025, 0.5, 0.975])
        is_seen = chdtrc(3, found.chi2) < INFRARED.false_alarm
        seen += is_seen
        silent += not is_seen and not 2.0 * low - middle < 20.0 < 2.0 * high - middle
    assert seen >= 40
    assert silent <= 4


def test_one_temperature_has_no_slope():
    with pytest.raises(BadInput, match="two temperatures or more, got 1"):
        fit(Camera(), [20, 20])
