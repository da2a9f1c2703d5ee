"""Nonlinear camera response: prior and posterior draws.

The response is y = u + c u (1 - u), u from 0 to 1. A power law of exponent g has c of about (1 - g)
times the contrast.
"""

import numpy as np

from charact.estimators.mtf.thresholds import LIMITS
from labdata import Array

# Prior probability of a nonlinear response, and the standard deviation of its curvature at a
# contrast of one.
CURVED, CURVED_SD = 0.25, 0.65
# Standard deviation of 1 - 1/g for exponents g.
BENDING = 0.4
# Limit of the noise's ln Bayes factor: frames may have been processed.
MAX_LN_BAYES_FACTOR = np.log(10.0)


def contrast_of(dark_dn: float, bright_dn: float, black_dn: float | None) -> float:
    """Return the contrast of two levels above black, or above 0 DN where the black level is
    unknown.

    A black level is rarely below 0 DN, and a higher one makes the contrast larger.
    """
    black = min(0.0, dark_dn) if black_dn is None else black_dn
    return float(
        np.clip(
            (bright_dn - dark_dn) / max(bright_dn + dark_dn - 2.0 * black, 1e-300),
            LIMITS.min_contrast,
            1.0,
        )
    )


def curvatures(
    response: tuple[float, float],
    contrast: float,
    noise_ln_odds: float,
    rng: np.random.Generator,
    count: int,
    *,
    curved: float = CURVED,
) -> Array:
    """Return posterior draws of the curvature of the camera response, 0 where it is linear.

    Parameters
    ----------
    response
        Estimated curvature and its standard uncertainty; a negative curvature steepens the
        response.
    noise_ln_odds
        Ln Bayes factor of the noise for a nonlinear against a linear response.
    curved
        Prior probability of a nonlinear response.

    Notes
    -----
    The Bayes factor against a linear response is a Savage-Dickey ratio; the prior of the curvature
    is normal with mean 0.
    """
    estimated, error, prior_sd = response[0], max(response[1], 1e-9), CURVED_SD * contrast
    total_sd = np.hypot(error, prior_sd)
    ln_odds = np.log(curved / (1.0 - curved) * error / total_sd) + 0.5 * (
        (estimated / error) ** 2 - (estimated / total_sd) ** 2
    )
    ln_odds += noise_ln_odds
    bends = rng.random(count) < 1.0 / (1.0 + np.exp(-np.clip(ln_odds, -50.0, 50.0)))
    drawn = estimated * (
        prior_sd / total_sd
    ) ** 2 + error * prior_sd / total_sd * rng.standard_normal(count)
    return np.where(bends, drawn, 0.0)
