"""Radiometry of lamps and of the eye: Planck's law and the photopic luminous efficiency."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

LUMENS_PER_WATT = 683.0

# CIE 1924 photopic luminous efficiency, every 10 nm from 380 nm.
EYE_NM = np.arange(380.0, 771.0, 10.0)
# fmt: off
EYE_SHARE = np.array([
    0.000039, 0.00012, 0.000396, 0.00121, 0.004, 0.0116, 0.023, 0.038, 0.06, 0.09098,
    0.13902, 0.20802, 0.323, 0.503, 0.71, 0.862, 0.954, 0.99495, 0.995, 0.952,
    0.87, 0.757, 0.631, 0.503, 0.381, 0.265, 0.175, 0.107, 0.061, 0.032,
    0.017, 0.00821, 0.004102, 0.002091, 0.001047, 0.00052, 0.000249, 0.00012, 0.00006, 0.00003,
])
# fmt: on


def luminous_efficiency(wavelength_nm: ArrayLike) -> NDArray[np.float64]:
    """Return V(lambda), dimensionless, linear between 10 nm steps and zero outside 380..770 nm."""
    return np.interp(np.asarray(wavelength_nm, float), EYE_NM, EYE_SHARE, left=0.0, right=0.0)


def planck(wavelength_nm: ArrayLike, temperature_k: float) -> NDArray[np.float64]:
    """Return the spectral radiance of a black body, W m-2 sr-1 nm-1.

    Notes
    -----
    2 h c^2 / l^5 / (exp(h c / (l k T)) - 1).
    """
    metre = np.asarray(wavelength_nm, float) * 1e-9
    planck_constant, light, boltzmann = 6.62607015e-34, 2.99792458e8, 1.380649e-23
    exponent = planck_constant * light / (metre * boltzmann * temperature_k)
    return 2.0 * planck_constant * light**2 / metre**5 / np.expm1(exponent) * 1e-9
