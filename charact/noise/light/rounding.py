"""What the digitiser's steps do to mean and variance where the noise is too small to hide them.

Rounding noise of standard deviation s to whole numbers shifts its mean by up to exp(-2 pi^2 s^2) / pi steps and its
variance by up to (4 s^2 + 1 / pi^2) exp(-2 pi^2 s^2), as the level lies between two codes (the first terms of the
Fourier series of the characteristic function; Widrow & Kollar, Quantization Noise, 2008). Where it lies nobody knows.
"""

import numpy as np

from charact.noise.gain.standard import QUANTISATION_DN2


def rounding_sd(variance_dn2: float) -> tuple[float, float]:
    """Return the standard deviations of the shifts of mean, DN, and variance, DN^2, for any place between two codes.

    Parameters
    ----------
    variance_dn2
        Variance of the values as rounded, DN^2.
    """
    analogue = max(variance_dn2 - QUANTISATION_DN2, 0.0)
    fade = float(np.exp(-2.0 * np.pi**2 * analogue)) / np.sqrt(2.0)
    return fade / np.pi, (4.0 * analogue + 1.0 / np.pi**2) * fade
