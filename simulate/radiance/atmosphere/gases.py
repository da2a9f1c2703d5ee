"""Absorption by water vapour, ozone and oxygen, in bands of some 10 nm."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulate.radiance.tables import table

PACKAGE = "simulate.radiance.atmosphere"
# A column of sea-level air as long as this holds what lies above a square metre, km.
MIXED_SCALE_HEIGHT_KM = 8.43


def _coefficient(wavelength_nm: ArrayLike, name: str) -> NDArray[np.float64]:
    gases = table(PACKAGE, "gases")
    return np.interp(np.atleast_1d(np.asarray(wavelength_nm, float)), gases["wavelength_nm"], gases[name])


def water_transmittance(wavelength_nm: ArrayLike, precipitable_cm: ArrayLike) -> NDArray[np.float64]:
    """Return what water vapour lets through, shape (band, path).

    Parameters
    ----------
    wavelength_nm
        Wavelengths, shape (band,), nm.
    precipitable_cm
        Water on each path, as a layer of liquid, shape (path,), cm.

    Notes
    -----
    exp(-0.2385 x / (1 + 20.07 x)^0.45), x = a w (Bird and Riordan 1984, eq. 2-8).
    """
    amount = _coefficient(wavelength_nm, "water_vapour_per_cm")[:, None] * np.atleast_1d(precipitable_cm)
    return np.exp(-0.2385 * amount / (1.0 + 20.07 * amount) ** 0.45)


def uniform_gas_transmittance(wavelength_nm: ArrayLike, airmass: ArrayLike) -> NDArray[np.float64]:
    """Return what oxygen and carbon dioxide let through, shape (band, path), for pressure-corrected air masses.

    Notes
    -----
    exp(-1.41 x / (1 + 118.3 x)^0.45), x = a m (Bird and Riordan 1984, eq. 2-11, the constant of its program).
    """
    amount = _coefficient(wavelength_nm, "mixed_gases")[:, None] * np.atleast_1d(airmass)
    return np.exp(-1.41 * amount / (1.0 + 118.3 * amount) ** 0.45)


def ozone_transmittance(wavelength_nm: ArrayLike, ozone_atm_cm: ArrayLike) -> NDArray[np.float64]:
    """Return what ozone lets through, shape (band, path), for ozone on each path, atm cm."""
    return np.exp(-_coefficient(wavelength_nm, "ozone_per_atm_cm")[:, None] * np.atleast_1d(ozone_atm_cm))


def vapour_density_g_m3(temperature_c: float, relative_humidity: float) -> float:
    """Return the mass of water vapour in air, g m-3.

    Notes
    -----
    Saturation pressure 6.112 exp(17.62 t / (243.12 + t)) hPa (Magnus, WMO Guide 8), ideal gas.
    """
    pressure_pa = 611.2 * np.exp(17.62 * temperature_c / (243.12 + temperature_c)) * relative_humidity
    return float(1e3 * pressure_pa / (461.5 * (temperature_c + 273.15)))
