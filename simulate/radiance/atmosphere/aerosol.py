"""Scattering by haze: how far one sees fixes how much, and how it falls with wavelength."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Contrast of 2 % is the least that shows: ln 50.
KOSCHMIEDER = 3.912
REFERENCE_NM = 550.0


def visibility_extinction_per_km(visibility_km: float) -> float:
    """Return the extinction at 550 nm, per km, 3.912/V (Koschmieder)."""
    return KOSCHMIEDER / visibility_km


def kruse_exponent(visibility_km: float) -> float:
    """Return q of extinction proportional to wavelength^-q (Kruse): 1.6 beyond 50 km, 1.3 beyond 6, 0.585 V^(1/3)."""
    if visibility_km > 50.0:
        return 1.6
    return 1.3 if visibility_km > 6.0 else 0.585 * visibility_km ** (1.0 / 3.0)


def kruse_per_km(wavelength_nm: ArrayLike, visibility_km: float) -> NDArray[np.float64]:
    """Return 3.912/V (wavelength/550 nm)^-q, per km."""
    relative = np.asarray(wavelength_nm, float) / REFERENCE_NM
    return visibility_extinction_per_km(visibility_km) * relative ** -kruse_exponent(visibility_km)


def scattering_albedo(wavelength_nm: ArrayLike) -> NDArray[np.float64]:
    """Return the share of haze's extinction that is scattering, dimensionless.

    Notes
    -----
    0.945 exp(-0.095 ln(l/400 nm)^2), rural haze (Bird and Riordan 1984, eq. 3-16).
    """
    return 0.945 * np.exp(-0.095 * np.square(np.log(np.asarray(wavelength_nm, float) / 400.0)))
