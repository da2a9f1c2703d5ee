"""Photons of lamps arrive as Poisson does: the departure of chaotic light is known and far below any tolerance."""

import numpy as np
import pytest

from labdata.conditions import Conditions
from labdata.errors import BadInput
from simulate.iiccd import photon_statistics, true_quantities
from simulate.iiccd.camera import IntensifiedCamera


def _pixel_modes(sheet, time_s: float, width_nm: float = 300.0) -> float:
    camera = IntensifiedCamera(sheet)
    area = true_quantities.field_pixel_area_cm2(camera)
    return photon_statistics.modes(wavelength_nm=700.0, width_nm=width_nm, time_s=time_s, area_cm2=area, f_number=1.4)


@pytest.mark.parametrize("photoelectrons", [0.05, 0.5, 5.0, 50.0, 500.0])
def test_a_pixel_of_the_default_camera_counts_as_poisson(sheet, photoelectrons):
    """To one part in a billion, where moments are asked for to a thousandth."""
    camera = IntensifiedCamera(sheet)
    many = _pixel_modes(sheet, camera.gate_s(Conditions()))
    assert photon_statistics.variance_over_mean(photoelectrons, many) - 1.0 < 1e-9


def test_even_a_nanosecond_through_a_narrow_filter_is_poisson_to_a_hundredth_of_a_per_cent(sheet):
    assert photon_statistics.variance_over_mean(5.0, _pixel_modes(sheet, 1e-9, width_nm=1.0)) - 1.0 < 1e-4


def test_counts_of_few_modes_have_the_stated_variance(seed):
    """Poisson counts of an intensity that is the sum of M exponential ones."""
    rng = np.random.default_rng(seed)
    for mode_count in (1, 5, 40):
        counts = rng.poisson(3.0 * rng.gamma(mode_count, 1.0 / mode_count, 400_000)).astype(float)
        squares = (counts - 3.0) ** 2 / 3.0
        expected = photon_statistics.variance_over_mean(3.0, mode_count)
        assert abs(squares.mean() - expected) < 4.5 * squares.std() / np.sqrt(squares.size)


def test_a_mode_of_a_lamp_holds_fewer_than_a_thousandth_photon():
    """Planck's occupation at 2856 K and 700 nm, the bound that no lens or gate exceeds."""
    exponent = 6.62607015e-34 * 2.99792458e8 / (700e-9 * 1.380649e-23 * 2856.0)
    assert 1.0 / np.expm1(exponent) == pytest.approx(7.5e-4, rel=0.05)


def test_no_time_no_modes():
    with pytest.raises(BadInput, match="time_s"):
        photon_statistics.modes(wavelength_nm=700.0, width_nm=1.0, time_s=0.0, area_cm2=1e-6, f_number=1.4)
