"""What noise says of a response: that of light grows from a target's dark to its bright side as the light itself."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from charact.mtf.plateau_noise import Sides

# By how much the variance of two levels may fall towards the light, or rise beyond what photons make of it, and by how
# many standard errors besides: processed pictures fall, pixels are unequal and blacks not quite so.
FALLING, RISING = (1.15, 5.7), (1.1, 4.0)
# How often noise is all read-out's, and the deviation of 1 - 1/g for responses of exponent g.
READ_OUT, BENDING = 0.5, 0.4
# Standard errors of what neighbours share from which on light made it, and how well black is known, DN.
SHARED_SD, BLACK_SD_DN = 8.0, 0.2
# Most that noise may count for or against a curved response, ln: a picture may have been processed otherwise.
MAX_LN_BAYES_FACTOR = np.log(10.0)


@dataclass(frozen=True, kw_only=True)
class PlateauNoiseRatio:
    """How noise grows from the dark to the bright side of a target.

    Parameters
    ----------
    ratio, scatter
        Bright over dark, and its relative standard error, dimensionless: of the variance, or of what neighbours share.
    photon_ratio
        The same ratio for photons' noise under a straight response; None: black is not known, or of a single frame
        pixels so quiet that their unequal gain is seen.
    of_light
        Whether it is what neighbours share: pulses of light tie them, read-out does not.
    """

    ratio: float
    scatter: float
    photon_ratio: float | None
    of_light: bool = False


def covariance_ratio(sides: Sides, black_dn: float | None) -> PlateauNoiseRatio | None:
    """Return how what neighbours share grows; None where they share too little, or black is not known."""
    photons = _photons(sides, black_dn)
    if photons is None or black_dn is None:
        return None
    dark, bright = sides
    if min(one.covariance / max(one.covariance_sd, 1e-300) for one in sides) < SHARED_SD:
        return None
    scatter = [one.covariance_sd / one.covariance for one in sides]
    return PlateauNoiseRatio(
        ratio=bright.covariance / dark.covariance,
        scatter=float(np.linalg.norm([*scatter, BLACK_SD_DN / (dark.level - black_dn)])),
        photon_ratio=photons,
        of_light=True,
    )


def variance_ratio(sides: Sides, black_dn: float | None) -> PlateauNoiseRatio:
    """Return how the variance of a pixel grows."""
    dark, bright = sides
    return PlateauNoiseRatio(
        ratio=bright.variance / max(dark.variance, 1e-300),
        scatter=float(np.hypot(dark.scatter, bright.scatter)),
        photon_ratio=_photons(sides, black_dn),
    )


def _photons(sides: Sides, black_dn: float | None) -> float | None:
    """Return the ratio of the light of both sides; None: black is not known, or lies above the dark side."""
    if black_dn is None:
        return None
    dark, bright = (one.level - black_dn for one in sides)
    return bright / dark if dark > 0 and bright > dark else None


def noise_flags(growth: PlateauNoiseRatio) -> tuple[str, ...]:
    """Return `gamma` where the noise of the plateaus cannot be that of light under a straight response.

    Notes
    -----
    Noise that falls towards the light is flattened. Photons' variance grows at most as the level over black: more says
    that the response steepens. What neighbours share grows as the level, neither more nor less.
    """
    beyond = RISING[0] + RISING[1] * growth.scatter
    rising = growth.photon_ratio is not None and growth.ratio > growth.photon_ratio * beyond
    if growth.of_light and growth.photon_ratio is not None:
        falling = growth.ratio * beyond < growth.photon_ratio
    else:
        falling = growth.ratio * (FALLING[0] + FALLING[1] * growth.scatter) < 1.0
    return ("gamma",) if falling or rising else ()


def ln_bayes_factor_nonlinear(growth: PlateauNoiseRatio) -> float:
    """Return ln of how much likelier a growth of the noise is under a curved response than under a straight one.

    Notes
    -----
    Half of all noise is read-out's, which comes after the response and tells nothing; what neighbours share is none of
    it. Of the other, photons have any share: under a straight response ln of the ratio is anywhere from 0 to ln r, r
    that of the light; of what neighbours share it is ln r. A power law of exponent g over levels that it makes r apart
    moves it by 2 (1 - 1/g) ln r.
    """
    # A side without any noise, such as one that is clipped throughout, says nothing of the response.
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
    """Return the density of what lies anywhere between 0 and a most, found with a normal error."""
    return float(ndtr(found / sd) - ndtr((found - most) / sd)) / most
