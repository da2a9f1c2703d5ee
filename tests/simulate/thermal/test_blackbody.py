"""Band radiances of a black body against a table of six digits, and the laws that tie them
together.
"""

import numpy as np
import pytest

from simulate.radiance import (
    STEFAN_BOLTZMANN,
    band_photon_radiance,
    band_radiance,
    band_radiance_slope,
)

# Temperature, band, radiance, derivative, photon radiance: by quadrature and by series, CODATA
# 2018.
TABLE = (
    (273.15, (3.0, 5.0), 0.644266, 0.0278635, 1.45943e19),
    (273.15, (8.0, 12.0), 23.8219, 0.465701, 1.20516e21),
    (273.15, (8.0, 14.0), 35.1520, 0.637354, 1.94537e21),
    (300.0, (3.0, 5.0), 1.86596, 0.0676983, 4.18311e19),
    (300.0, (3.4, 4.1), 0.331898, 0.0138860, 6.40040e18),
    (300.0, (7.5, 13.5), 55.4916, 0.882489, 2.91534e21),
    (300.0, (8.0, 12.0), 38.5004, 0.629704, 1.93596e21),
    (300.0, (8.0, 14.0), 54.9335, 0.837821, 3.00884e21),
    (310.0, (3.0, 5.0), 2.65284, 0.0905267, 5.92467e19),
    (310.0, (8.0, 12.0), 45.1149, 0.693357, 2.26403e21),
    (310.0, (8.0, 14.0), 63.6944, 0.914474, 3.47678e21),
)


@pytest.mark.parametrize(("kelvin", "band", "radiance", "slope", "photons"), TABLE)
def test_band_radiances_have_the_digits_of_the_table(kelvin, band, radiance, slope, photons):
    for found, exact in (
        (band_radiance(*band, kelvin), radiance),
        (band_radiance_slope(*band, kelvin), slope),
        (band_photon_radiance(*band, kelvin), photons),
    ):
        # Half a unit of the sixth digit, and for numbers whose last digit is a zero no more.
        assert float(found) == pytest.approx(exact, rel=5.1e-6 / float(f"{exact:.9e}"[:8]))


def test_all_bands_together_are_the_law_of_stefan_and_boltzmann():
    edges = np.geomspace(2.0, 90.0, 40)
    total = band_radiance(edges[:-1], edges[1:], 300.0).sum()
    assert total == pytest.approx(band_radiance(2.0, 90.0, 300.0), rel=1e-12)
    # Textbook tables of the fraction below 27,000 um K.
    assert total == pytest.approx(0.9937 * STEFAN_BOLTZMANN * 300.0**4 / np.pi, rel=2e-4)


def test_the_slope_is_that_of_the_radiance():
    kelvin = np.array([180.0, 250.0, 300.0, 600.0, 1500.0])
    step = 1e-3
    difference = (
        band_radiance(8.0, 12.0, kelvin + step) - band_radiance(8.0, 12.0, kelvin - step)
    ) / (2.0 * step)
    assert band_radiance_slope(8.0, 12.0, kelvin) == pytest.approx(difference, rel=1e-7)
