"""The signal-to-noise ratio that tubes are specified by: a spot of 0.2 mm at 108 microlux through 10 Hz.

The photoelectrons of a spot of area A under E lux, S E A / e a second, seen through a noise bandwidth df, have the
ratio sqrt(S E A / (2 e df)) / NF, with the noise factor NF = sqrt(F^2). A camera needs neither S nor F: the signal that
it gives per lux, second and area over k F^2, the noise that it gives per signal, is S / (e F^2), whatever the gain.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from charact.noise.snr.cathode_radiometry import ELECTRON_C

Array = NDArray[np.float64]

ILLUMINANCE_LUX = 108e-6
SPOT_MM = 0.2
BANDWIDTH_HZ = 10.0
SPOT_M2 = np.pi / 4.0 * (SPOT_MM * 1e-3) ** 2


def snr_from_specification(sensitivity_ua_per_lm: ArrayLike, excess_noise_factor: ArrayLike) -> Array:
    """Return the ratio of a tube.

    Parameters
    ----------
    sensitivity_ua_per_lm
        Luminous sensitivity S of the photocathode at 2856 K, uA/lm.
    excess_noise_factor
        F^2 of what follows, undetected photoelectrons counted; the square of the noise factor NF.
    """
    photoelectrons = np.asarray(sensitivity_ua_per_lm) * 1e-6 / ELECTRON_C
    return _snr(photoelectrons / np.asarray(excess_noise_factor))


def snr_from_measurement(response_dn_per_lux_s: ArrayLike, pulse_gain_dn: ArrayLike, pixel_area_m2: ArrayLike) -> Array:
    """Return the ratio as a camera sees it.

    Parameters
    ----------
    response_dn_per_lux_s
        Signal of a pixel per lux at the photocathode and second, DN.
    pulse_gain_dn
        k F^2: the covariance sum of the pulses' noise over the signal, DN.
    pixel_area_m2
        Area of a pixel at the photocathode, m2.
    """
    return _snr(np.asarray(response_dn_per_lux_s) / (np.asarray(pulse_gain_dn) * np.asarray(pixel_area_m2)))


def _snr(effective_per_lux_s_m2: Array) -> Array:
    """The ratio from the photoelectrons per lux, second and m2 over F^2."""
    return np.sqrt(effective_per_lux_s_m2 * ILLUMINANCE_LUX * SPOT_M2 / (2.0 * BANDWIDTH_HZ))
