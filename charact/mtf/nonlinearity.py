"""Nonlinear camera response: prior, posterior draws and the photon-transfer check.

The response is y = u + c u (1 - u), u from 0 to 1. A power law of exponent g has c of about (1 - g) times the contrast.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from charact.mtf.plateau_noise import Sides
from charact.mtf.thresholds import ACCURACY, LIMITS

Array = NDArray[np.float64]

# Prior probability of a nonlinear response, and the standard deviation of its curvature at a contrast of one.
CURVED, CURVED_SD = 0.25, 0.65


# Prior probability that noise is read-out noise, and the standard deviation of 1 - 1/g for exponents g.
READ_OUT, BENDING = 0.5, 0.4
# Limit of the noise's ln Bayes factor: frames may have been processed.
MAX_LN_BAYES_FACTOR = np.log(10.0)


def usable_black_level(black_dn: float | None, dark_dn: float, bright_dn: float) -> float | None:
    """Return the black level, DN; None if it is unknown or lies well above the dark side."""
    if black_dn is None or black_dn > dark_dn + LIMITS.max_below_black * (bright_dn - dark_dn):
        return None
    return black_dn


def contrast_of(dark_dn: float, bright_dn: float, black_dn: float | None) -> float:
    """Return the contrast of two levels above black, or above 0 DN where the black level is unknown.

    A black level is rarely below 0 DN, and a higher one makes the contrast larger.
    """
    black = min(0.0, dark_dn) if black_dn is None else black_dn
    return float(
        np.clip((bright_dn - dark_dn) / max(bright_dn + dark_dn - 2.0 * black, 1e-300), LIMITS.min_contrast, 1.0)
    )


def curvatures(
    response: tuple[float, float],
    contrast: float,
    noise_ln_odds: float,
    rng: np.random.Generator,
    count: int,
    *,
    curved: float | None = None,
) -> Array:
    """Return posterior draws of the curvature of the camera response, 0 where it is linear.

    Parameters
    ----------
    response
        Estimated curvature and its standard uncertainty, dimensionless; a negative curvature steepens the response.
    contrast
        Contrast of the levels.
    noise_ln_odds
        Ln Bayes factor of the noise for a nonlinear against a linear response.
    rng
        Random generator.
    count
        Number of draws.
    curved
        Prior probability of a nonlinear response; None: `CURVED`.

    Notes
    -----
    The Bayes factor against a linear response is a Savage-Dickey ratio; the prior of the curvature is normal with mean
    0.
    """
    found, error, prior_sd = response[0], max(response[1], 1e-9), CURVED_SD * contrast
    apart = np.hypot(error, prior_sd)
    fraction = CURVED if curved is None else curved
    ln_odds = np.log(fraction / (1.0 - fraction) * error / apart) + 0.5 * ((found / error) ** 2 - (found / apart) ** 2)
    ln_odds += noise_ln_odds
    bends = rng.random(count) < 1.0 / (1.0 + np.exp(-np.clip(ln_odds, -50.0, 50.0)))
    drawn = found * (prior_sd / apart) ** 2 + error * prior_sd / apart * rng.standard_normal(count)
    return np.where(bends, drawn, 0.0)


@dataclass(frozen=True, kw_only=True)
class PlateauNoiseRatio:
    """Ratio of the noise on the bright side of a target to that on the dark side.

    Parameters
    ----------
    ratio, scatter
        Ratio of the variances, or of the covariances of neighbours, and its relative standard uncertainty,
        dimensionless.
    photon_ratio
        Ratio of the signals, which photon noise has under a linear response; None: the black level is unknown.
    of_light
        Whether the ratio is that of covariances. Light pulses correlate neighbours, read-out noise does not.
    """

    ratio: float
    scatter: float
    photon_ratio: float | None
    of_light: bool = False


def covariance_ratio(sides: Sides, black_dn: float | None) -> PlateauNoiseRatio | None:
    """Return the ratio of the neighbours' covariances; None if they are too small or the black level is unknown."""
    photons = _photons(sides, black_dn)
    if photons is None or black_dn is None:
        return None
    dark, bright = sides
    if min(one.covariance / max(one.covariance_sd, 1e-300) for one in sides) < LIMITS.min_covariance_sd:
        return None
    scatter = [one.covariance_sd / one.covariance for one in sides]
    return PlateauNoiseRatio(
        ratio=bright.covariance / dark.covariance,
        scatter=float(np.linalg.norm([*scatter, ACCURACY.black_sd_dn / (dark.level - black_dn)])),
        photon_ratio=photons,
        of_light=True,
    )


def variance_ratio(sides: Sides, black_dn: float | None) -> PlateauNoiseRatio:
    """Return the ratio of the pixels' variances."""
    dark, bright = sides
    return PlateauNoiseRatio(
        ratio=bright.variance / max(dark.variance, 1e-300),
        scatter=float(np.hypot(dark.scatter, bright.scatter)),
        photon_ratio=_photons(sides, black_dn),
    )


def _photons(sides: Sides, black_dn: float | None) -> float | None:
    """Return the ratio of the signals of both sides; None if the black level is unknown or not below the dark side."""
    if black_dn is None:
        return None
    dark, bright = (one.level - black_dn for one in sides)
    return bright / dark if dark > 0 and bright > dark else None


def noise_flags(growth: PlateauNoiseRatio) -> tuple[str, ...]:
    """Return `gamma` where the plateau noise contradicts a linear response.

    Notes
    -----
    Variance that falls with the signal indicates a compressive response. Under a linear response it grows at most in
    proportion to the signal above black; the covariance of neighbours grows in proportion to it.
    """
    beyond = LIMITS.rising_variance[0] + LIMITS.rising_variance[1] * growth.scatter
    rising = growth.photon_ratio is not None and growth.ratio > growth.photon_ratio * beyond
    if growth.of_light and growth.photon_ratio is not None:
        falling = growth.ratio * beyond < growth.photon_ratio
    else:
        falling = growth.ratio * (LIMITS.falling_variance[0] + LIMITS.falling_variance[1] * growth.scatter) < 1.0
    return ("gamma",) if falling or rising else ()


def ln_bayes_factor_nonlinear(growth: PlateauNoiseRatio) -> float:
    """Return the ln Bayes factor of a nonlinear against a linear response for the noise ratio.

    Notes
    -----
    The variance is read-out noise with probability `READ_OUT`; that gives no information. Otherwise photons contribute
    any fraction: under a linear response the ln ratio is uniform from 0 to ln r, r the ratio of the signals. For
    covariances it is ln r. A power law of exponent g changes the ln ratio by 2 (1 - 1/g) ln r.
    """
    # A side without noise, such as a clipped one, gives no information about the response.
    if growth.photon_ratio is None or not growth.photon_ratio > 1.0 or not growth.ratio > 0.0:
        return 0.0
    found, most, error = np.log(growth.ratio), np.log(growth.photon_ratio), growth.scatter
    apart = error, float(np.hypot(error, 2.0 * BENDING * most))
    if growth.of_light:
        straight, curved = (_normal(found - most, sd) for sd in apart)
    else:
        read_out = READ_OUT * _normal(found, error)
        straight, curved = (read_out + (1.0 - READ_OUT) * _evenly_to(most, found, sd) for sd in apart)
    ratio = np.log(np.maximum(curved, 1e-300)) - np.log(np.maximum(straight, 1e-300))
    return float(np.clip(ratio, -MAX_LN_BAYES_FACTOR, MAX_LN_BAYES_FACTOR))


def _normal(away: float, sd: float) -> float:
    return float(np.exp(-0.5 * (away / sd) ** 2) / (np.sqrt(2.0 * np.pi) * sd))


def _evenly_to(most: float, found: float, sd: float) -> float:
    """Return the density of a value uniform from 0 to `most`, measured with a normal error."""
    return float(ndtr(found / sd) - ndtr((found - most) / sd)) / most
