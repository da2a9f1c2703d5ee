"""Bias of mean and variance by rounding if the noise is smaller than the quantisation step."""

import numpy as np

# Variance of rounding, DN^2.
QUANTISATION_DN2 = 1.0 / 12.0
# Above this variance rounding adds 1/12 DN^2 within 0.001 DN^2.
EVEN_DN2 = 0.45
# Below this variance rounding is not independent noise: at the 0.24 DN^2 of EMVA 1288, 6.6, the noise is wrong by up to
# 7 %, here by 1.5 %.
QUANTISED_DN2 = 0.32


def flags_of_rounding(variance_dn2: float) -> tuple[str, ...]:
    """Return the flag of noise smaller than the quantisation step."""
    return ("quantised",) if variance_dn2 < QUANTISED_DN2 else ()


def rounding_sd(variance_dn2: float) -> tuple[float, float]:
    """Return the standard deviations of the rounding bias of mean, DN, and variance, DN^2."""
    analogue = max(variance_dn2 - QUANTISATION_DN2, 0.0)
    fade = float(np.exp(-2.0 * np.pi**2 * analogue)) / np.sqrt(2.0)
    return fade / np.pi, (4.0 * analogue + 1.0 / np.pi**2) * fade


def variance_range_before_rounding(variance_dn2: float) -> tuple[float, float]:
    """Return the smallest and largest variance of normal noise that has this variance after rounding, DN^2.

    Rounding hides most noise about a grey value, and least midway between two, where zero noise has variance 1/4.
    """
    if variance_dn2 > EVEN_DN2:
        return variance_dn2 - QUANTISATION_DN2, variance_dn2 - QUANTISATION_DN2
    return _variance_before_rounding(variance_dn2, 0.5), _variance_before_rounding(variance_dn2, 0.0)


def _variance_before_rounding(variance_dn2: float, place: float) -> float:
    """Return the variance of normal noise about a position between two grey values, given that after rounding."""
    from scipy.optimize import root_scalar
    from scipy.special import ndtr

    codes = np.arange(-8.0, 9.0)

    def excess(sd: float) -> float:
        chance = np.diff(ndtr((np.append(codes - 0.5, codes[-1] + 0.5) - place) / sd))
        return float(chance @ codes**2 - (chance @ codes) ** 2) - variance_dn2

    return 0.0 if excess(1e-4) >= 0.0 else root_scalar(excess, bracket=(1e-4, 1.0)).root ** 2
