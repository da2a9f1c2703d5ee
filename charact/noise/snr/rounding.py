"""What the digitiser's steps do to mean and variance where the noise is too small to hide them.

Rounding noise of standard deviation s to whole numbers shifts its mean by up to exp(-2 pi^2 s^2) / pi steps and its
variance by up to (4 s^2 + 1 / pi^2) exp(-2 pi^2 s^2), as the level lies between two codes (the first terms of the
Fourier series of the characteristic function; Widrow & Kollar, Quantization Noise, 2008). Where it lies nobody knows.
"""

import numpy as np

# Variance of a digitiser's rounding, DN^2.
QUANTISATION_DN2 = 1.0 / 12.0
# Above this variance rounding adds the same to any noise, within a thousandth of a squared step.
EVEN_DN2 = 0.45


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


def unrounded_variance_range(variance_dn2: float) -> tuple[float, float]:
    """Return the least and the largest variance of normal noise that rounding may leave with this variance, DN^2.

    Parameters
    ----------
    variance_dn2
        Variance of the values as rounded, DN^2.

    Notes
    -----
    At the middle of a code rounding hides the most, between two codes the least: there no noise at all has 1/4.
    """
    if variance_dn2 > EVEN_DN2:
        return variance_dn2 - QUANTISATION_DN2, variance_dn2 - QUANTISATION_DN2
    return _noise_of(variance_dn2, 0.5), _noise_of(variance_dn2, 0.0)


def _noise_of(variance_dn2: float, place: float) -> float:
    """Variance of normal noise about a place between two codes whose rounded values vary so much."""
    from scipy.optimize import root_scalar

    least, most = 1e-4, 1.0
    if _rounded_variance(least, place) >= variance_dn2:
        return 0.0
    return root_scalar(lambda sd: _rounded_variance(sd, place) - variance_dn2, bracket=(least, most)).root ** 2


def _rounded_variance(sd: float, place: float) -> float:
    """Variance of normal noise of a standard deviation about a place, rounded to whole numbers."""
    from scipy.stats import norm

    codes = np.arange(-8.0, 9.0)
    chance = np.diff(norm.cdf((np.append(codes - 0.5, codes[-1] + 0.5) - place) / sd))
    return float(chance @ codes**2 - (chance @ codes) ** 2)
