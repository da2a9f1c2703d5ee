"""Photoelectrons per pixel from illuminance and time, or from photons of one wavelength.

Illuminance refers to a lamp at 2856 K, as does the luminous sensitivity of a tube. The sensitivity scales the table of
quantum efficiencies.
"""

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from labdata.camera_description import Parameter
from labdata.sensor import Photocathode

Array = NDArray[np.float64]
ELECTRON_C = 1.602176634e-19
# h c in J nm, and h c / k in nm K.
PHOTON_J_NM, SECOND_RADIATION_NM_K = 1.986445857e-16, 1.438776877e7
LUMENS_PER_WATT = 683.002
LAMP_K = 2856.0


def photoelectrons_per_lux_s(context: Context, rng: np.random.Generator, count: int) -> Array:
    """Return draws of the photoelectrons per pixel, lux and second of gate, shape (count,)."""
    sensor = context.sensor
    assert sensor is not None
    sensitivity = lognormal_draws(sensor.photocathode.luminous_sensitivity_ua_per_lm, rng, count)
    return sensitivity * 1e-6 / ELECTRON_C * pixel_area_m2(context, rng, count)


def pixel_area_m2(context: Context, rng: np.random.Generator, count: int) -> Array:
    """Return draws of the pixel area at the photocathode, shape (count,), m2; two rows for a field."""
    sensor = context.sensor
    assert sensor is not None
    demagnification = lognormal_draws(sensor.taper.demagnification, rng, count)
    rows = 2.0 if context.interlaced else 1.0
    return float(sensor.ccd.pitch_x_um) * float(sensor.ccd.pitch_y_um) * demagnification**2 * rows * 1e-12


def photoelectrons_per_photon(context: Context, wavelength_nm: float, rng: np.random.Generator, count: int) -> Array:
    """Return draws of the photocathode's quantum efficiency at a wavelength, shape (count,)."""
    assert context.sensor is not None
    cathode = context.sensor.photocathode
    table = np.interp(wavelength_nm, cathode.wavelength_nm, cathode.relative_quantum_efficiency, left=0.0, right=0.0)
    sensitivity = lognormal_draws(cathode.luminous_sensitivity_ua_per_lm, rng, count)
    return np.minimum(sensitivity / luminous_sensitivity_ua_per_lm(cathode) * table, 1.0)


def luminous_sensitivity_ua_per_lm(cathode: Photocathode) -> float:
    """Return the luminous sensitivity of the table of quantum efficiencies, uA/lm at 2856 K.

    S = int QE (e lambda / h c) P dlambda / (683 int V P dlambda), P Planck's law. V is taken as the Gaussian
    1.019 exp(-285.4 (lambda - 0.559)^2), lambda in um, which gives the lumens of this lamp within a percent.
    """
    wavelength = np.arange(360.0, 1101.0, 1.0)
    radiant = wavelength**-5.0 / np.expm1(SECOND_RADIATION_NM_K / (wavelength * LAMP_K))
    eye = 1.019 * np.exp(-285.4 * (wavelength * 1e-3 - 0.559) ** 2)
    efficiency = np.interp(wavelength, cathode.wavelength_nm, cathode.relative_quantum_efficiency, left=0.0, right=0.0)
    current = ELECTRON_C / PHOTON_J_NM * np.sum(efficiency * wavelength * radiant)
    return float(1e6 * current / (LUMENS_PER_WATT * np.sum(eye * radiant)))


def lognormal_draws(parameter: Parameter, rng: np.random.Generator, count: int) -> Array:
    """Return lognormal draws of a parameter with its 95 % bounds; constant without bounds."""
    if parameter.low is None or parameter.high is None or parameter.low <= 0:
        return np.full(count, float(parameter))
    side = rng.standard_normal(count)
    up, down = np.log(parameter.high / parameter.value) / 1.96, np.log(parameter.value / parameter.low) / 1.96
    return parameter.value * np.exp(np.where(side > 0, side * up, side * down))
