"""Band radiance of a black body, its derivative with temperature, and its inverse: for temperatures and imagers."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

# CODATA 2018: W m-2 K-4; J s; m/s; J/K.
STEFAN_BOLTZMANN = 5.670374419e-8
PLANCK, LIGHT, BOLTZMANN = 6.62607015e-34, 2.99792458e8, 1.380649e-23
# Terms of the series: exp(-n x) is below 1e-9 of the first one after these, for x of 0.5 (14 um at 2000 K) and more.
TERMS = 40

Array = NDArray[np.float64]


def band_radiance(low_um: ArrayLike, high_um: ArrayLike, temperature_k: ArrayLike) -> Array:
    r"""Return the radiance of a black body between two wavelengths, W m-2 sr-1.

    Parameters
    ----------
    low_um, high_um
        Ends of the band, um; any shapes that broadcast with the temperature's.
    temperature_k
        Temperature, K, above 0.

    Notes
    -----
    .. math:: L = \frac{2 k^4 T^4}{h^3 c^2} \sum_n e^{-nx} (x^3/n + 3x^2/n^2 + 6x/n^3 + 6/n^4),
        \quad x = \frac{hc}{\lambda k T}

    from the low end minus from the high end (Chang and Rhee, Int. Comm. Heat Mass Transfer 11, 451, 1984). `TERMS`
    terms are exact to 1e-8 for wavelength times temperature below 28,000 um K.
    """
    kelvin = np.asarray(temperature_k, float)
    scale = 2.0 * BOLTZMANN**4 / (PLANCK**3 * LIGHT**2) * kelvin**4
    return scale * (_series(_exponent(high_um, kelvin), 3) - _series(_exponent(low_um, kelvin), 3))


def band_photon_radiance(low_um: ArrayLike, high_um: ArrayLike, temperature_k: ArrayLike) -> Array:
    """Return the photon radiance of a black body between two wavelengths, s-1 m-2 sr-1, as `band_radiance`."""
    kelvin = np.asarray(temperature_k, float)
    scale = 2.0 * BOLTZMANN**3 / (PLANCK**3 * LIGHT**2) * kelvin**3
    return scale * (_series(_exponent(high_um, kelvin), 2) - _series(_exponent(low_um, kelvin), 2))


def band_radiance_slope(low_um: ArrayLike, high_um: ArrayLike, temperature_k: ArrayLike) -> Array:
    r"""Return the derivative of `band_radiance` with temperature, W m-2 sr-1 K-1.

    Notes
    -----
    .. math:: T \frac{dL}{dT} = 4 L + \left[\frac{2 k^4 T^4}{h^3 c^2} \frac{x^4}{e^x - 1}\right]_{low}^{high}
    """
    kelvin = np.asarray(temperature_k, float)
    scale = 2.0 * BOLTZMANN**4 / (PLANCK**3 * LIGHT**2) * kelvin**4
    low, high = (-(x**4) * np.exp(-x) / np.expm1(-x) for x in (_exponent(end, kelvin) for end in (low_um, high_um)))
    return (4.0 * band_radiance(low_um, high_um, kelvin) + scale * (high - low)) / kelvin


def brightness_temperature(low_um: float, high_um: float, radiance: ArrayLike) -> Array:
    """Return the temperature of the black body of a band radiance (W m-2 sr-1, above 0), K.

    Notes
    -----
    Newton's method on ln L against 1/T, which is nearly straight; relative error below 1e-12.
    """
    wanted = np.log(np.asarray(radiance, float))
    inverse = np.full(wanted.shape, 1.0 / 300.0)
    for _ in range(30):
        kelvin = 1.0 / inverse
        found = band_radiance(low_um, high_um, kelvin)
        slope = -band_radiance_slope(low_um, high_um, kelvin) * kelvin**2 / found
        # At most by a half at a time: the first guess may be far away.
        inverse *= np.clip(1.0 + (wanted - np.log(found)) / slope / inverse, 0.5, 2.0)
    return 1.0 / inverse


def _exponent(wavelength_um: ArrayLike, kelvin: Array) -> Array:
    """h c / (wavelength k T)."""
    return PLANCK * LIGHT / (np.asarray(wavelength_um, float) * 1e-6 * BOLTZMANN * kelvin)


def _series(x: Array, power: int) -> Array:
    """Integral of t^power / (e^t - 1) from x to infinity, of power 2 or 3."""
    n = np.arange(1.0, TERMS + 1.0).reshape(-1, *(1,) * x.ndim)
    poly = x**2 / n + 2.0 * x / n**2 + 2.0 / n**3
    if power == 3:
        poly = x**3 / n + 3.0 / n * poly
    return np.sum(np.exp(-n * x) * poly, axis=0)
