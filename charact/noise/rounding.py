"""Bias of mean and variance by rounding if the noise is smaller than the quantisation step."""

import numpy as np

# Variance of rounding, DN^2.
QUANTISATION_DN2 = 1.0 / 12.0
# Above this variance rounding adds 1/12 DN^2 within 0.001 DN^2.
EVEN_DN2 = 0.45


def rounding_sd(variance_dn2: float) -> tuple[float, float]:
    """Return the standard deviations of the rounding bias of mean, DN, and variance, DN^2.

    `variance_dn2`: variance of the values as rounded, DN^2.
    """
    analogue = max(variance_dn2 - QUANTISATION_DN2, 0.0)
    fade = float(np.exp(-2.0 * np.pi**2 * analogue)) / np.sqrt(2.0)
    return fade / np.pi, (4.0 * analogue + 1.0 / np.pi**2) * fade


def variance_range_before_rounding(variance_dn2: float) -> tuple[float, float]:
    """Return the smallest and largest variance of normal noise that has this variance after rounding, DN^2.

    `variance_dn2`: variance of the values as rounded, DN^2.

    Rounding hides most noise about a grey value, and least midway between two, where zero noise has variance 1/4.
    """
    if variance_dn2 > EVEN_DN2:
        return variance_dn2 - QUANTISATION_DN2, variance_dn2 - QUANTISATION_DN2
    return _noise_of(variance_dn2, 0.5), _noise_of(variance_dn2, 0.0)


def _noise_of(variance_dn2: float, place: float) -> float:
    """Return the variance of normal noise about a position between two grey values, given that after rounding."""
    from scipy.optimize import root_scalar

    least, most = 1e-4, 1.0
    if _variance_after_rounding(least, place) >= variance_dn2:
        return 0.0
    return root_scalar(lambda sd: _variance_after_rounding(sd, place) - variance_dn2, bracket=(least, most)).root ** 2


def _variance_after_rounding(sd: float, place: float) -> float:
    """Return the variance after rounding of normal noise about a position."""
    from scipy.stats import norm

    codes = np.arange(-8.0, 9.0)
    chance = np.diff(norm.cdf((np.append(codes - 0.5, codes[-1] + 0.5) - place) / sd))
    return float(chance @ codes**2 - (chance @ codes) ** 2)
