"""Photons of lamps arrive as Poisson does: the departure of chaotic light is known and far below
any tolerance.
"""

import numpy as np
import pytest

from labdata import BadInput, Conditions
from simulate.camera import CameraModel

LIGHT_M_PER_S = 2.99792458e8


def modes(
    *, wavelength_nm: float, width_nm: float, time_s: float, area_cm2: float, f_number: float
) -> float:
    """Return in how many modes of the light field a detector counts, dimensionless, at least 1.

    Parameters
    ----------
    wavelength_nm, width_nm
        Centre and width of the spectrum, nm.
    time_s
        Time over which it counts, s.
    area_cm2
        Area over which it counts, cm2.
    f_number
        Of the cone in which the light arrives.

    Notes
    -----
    M = (t dnu)(A/A_c) of chaotic light: coherence time 1/dnu, dnu = c dl/l^2, coherence area A_c =
    l^2/Omega, Omega = pi/(4 N^2) (Goodman, Statistical Optics, 6.1 and 9.2).
    """
    for name, value in (
        ("wavelength_nm", wavelength_nm),
        ("width_nm", width_nm),
        ("time_s", time_s),
    ):
        if not value > 0.0:
            raise BadInput(f"{name} must be positive, got {value:g}")
    wavelength_m = wavelength_nm * 1e-9
    width_hz = LIGHT_M_PER_S * width_nm * 1e-9 / wavelength_m**2
    coherence_m2 = wavelength_m**2 / (np.pi / (4.0 * f_number**2))
    return max(float(time_s * width_hz), 1.0) * max(float(area_cm2 * 1e-4 / coherence_m2), 1.0)


def variance_over_mean(photoelectrons: float, mode_count: float) -> float:
    """Return the variance of a count of photoelectrons over its mean, dimensionless: 1 + n/M, 1 for
    Poisson.

    Notes
    -----
    Chaotic light in M modes gives negative binomial counts (Mandel, Proc. Phys. Soc. 74, 233,
    1959). A single mode of a lamp of 2856 K at 700 nm holds 8e-4 photons, so n/M stays below that
    whatever the lens, the level and the gate: Poisson arrivals are exact to a thousandth at worst,
    and far better of any scene that is dimmer than its lamp.
    """
    return 1.0 + photoelectrons / mode_count


def _pixel_modes(sheet, time_s: float, width_nm: float = 300.0) -> float:
    camera = CameraModel(sheet)
    area = camera.field_pixel_area_cm2
    return modes(wavelength_nm=700.0, width_nm=width_nm, time_s=time_s, area_cm2=area, f_number=1.4)


@pytest.mark.parametrize("photoelectrons", [0.05, 0.5, 5.0, 50.0, 500.0])
def test_a_pixel_of_the_default_camera_counts_as_poisson(sheet, photoelectrons):
    """To one part in a billion, where moments are asked for to a thousandth."""
    camera = CameraModel(sheet)
    many = _pixel_modes(sheet, camera.open_s(Conditions()))
    assert variance_over_mean(photoelectrons, many) - 1.0 < 1e-9


def test_even_a_nanosecond_through_a_narrow_filter_is_poisson_to_a_hundredth_of_a_per_cent(sheet):
    assert variance_over_mean(5.0, _pixel_modes(sheet, 1e-9, width_nm=1.0)) - 1.0 < 1e-4


def test_counts_of_few_modes_have_the_stated_variance(seed):
    """Poisson counts of an intensity that is the sum of M exponential ones."""
    rng = np.random.default_rng(seed)
    for mode_count in (1, 5, 40):
        counts = rng.poisson(3.0 * rng.gamma(mode_count, 1.0 / mode_count, 400_000)).astype(float)
        squares = (counts - 3.0) ** 2 / 3.0
        expected = variance_over_mean(3.0, mode_count)
        assert abs(squares.mean() - expected) < 4.5 * squares.std() / np.sqrt(squares.size)


def test_a_mode_of_a_lamp_holds_fewer_than_a_thousandth_photon():
    """Planck's occupation at 2856 K and 700 nm, the bound that no lens or gate exceeds."""
    exponent = 6.62607015e-34 * 2.99792458e8 / (700e-9 * 1.380649e-23 * 2856.0)
    assert 1.0 / np.expm1(exponent) == pytest.approx(7.5e-4, rel=0.05)


def test_no_time_no_modes():
    with pytest.raises(BadInput, match="time_s"):
        modes(wavelength_nm=700.0, width_nm=1.0, time_s=0.0, area_cm2=1e-6, f_number=1.4)
