"""Signal-to-noise ratio of tube specifications: spot of 0.2 mm, 108 microlux, 10 Hz."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from charact.noise.snr.cathode_radiometry import ELECTRON_C

Array = NDArray[np.float64]

ILLUMINANCE_LUX = 108e-6
SPOT_MM = 0.2
BANDWIDTH_HZ = 10.0
SPOT_M2 = np.pi / 4.0 * (SPOT_MM * 1e-3) ** 2


def snr_from_specification(sensitivity_ua_per_lm: ArrayLike, excess_noise_factor: ArrayLike) -> Array:
    """Return the signal-to-noise ratio of a specified tube.

    Parameters
    ----------
    sensitivity_ua_per_lm
        Luminous sensitivity S of the photocathode at 2856 K, uA/lm.
    excess_noise_factor
        F^2 including undetected photoelectrons; the square of the noise factor NF.
    """
    photoelectrons = np.asarray(sensitivity_ua_per_lm) * 1e-6 / ELECTRON_C
    return _snr(photoelectrons / np.asarray(excess_noise_factor))


def snr_from_measurement(response_dn_per_lux_s: ArrayLike, pulse_gain_dn: ArrayLike, pixel_area_m2: ArrayLike) -> Array:
    """Return the signal-to-noise ratio of a measured tube and camera.

    Parameters
    ----------
    response_dn_per_lux_s
        Signal of a pixel per lux and second at the photocathode, DN.
    pulse_gain_dn
        k F^2: covariance sum of the scintillation noise over the signal, DN.
    pixel_area_m2
        Area of a pixel at the photocathode, m2.
    """
    return _snr(np.asarray(response_dn_per_lux_s) / (np.asarray(pulse_gain_dn) * np.asarray(pixel_area_m2)))


def _snr(effective_per_lux_s_m2: Array) -> Array:
    """Return the signal-to-noise ratio from the photoelectrons per lux, second and m2 over F^2."""
    return np.sqrt(effective_per_lux_s_m2 * ILLUMINANCE_LUX * SPOT_M2 / (2.0 * BANDWIDTH_HZ))
