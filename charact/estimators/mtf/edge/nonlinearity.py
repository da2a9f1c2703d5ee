"""Nonlinear camera response: what of it an edge shows, and what it leaves uncertain."""

import numpy as np

from charact.estimators.mtf.edge.pixels.plateau_noise import NoiseGrowth
from charact.estimators.mtf.edge.pixels.prepare_edge import PreparedEdge
from charact.estimators.mtf.edge.thresholds import THRESHOLDS
from charact.estimators.mtf.nonlinearity import BENDING, MAX_LN_BAYES_FACTOR, curvatures
from charact.method import Context
from labdata import Array
from labdata.camera.description import has_tube

# Curvature of the response with its standard uncertainty.
CurvatureEstimate = tuple[float, float]

# Rise of ln MTF50 per curvature and contrast under responses that steepen and that flatten, and its
# scatter: power laws, knees, saturation, logarithms and parabolas on simulated edges of every blur
# model.
STEEPENING, FLATTENING, EITHER_WAY = 0.18, 0.09, 0.1
# Largest code of pictures that are encoded for displays as a rule, DN.
ENCODED_DN = 255
# Prior probability that noise is read-out noise.
READ_OUT = 0.5


def noise_growth_sign(edge: PreparedEdge) -> int:
    """Return what the noise of both sides says of the response: 1 where it grows as under a linear
    one, -1 where it falls towards the light as under a compressive one, 0 where it says nothing.

    Notes
    -----
    Photons under a power law y = L^(1/g) have var y ~ y^(2 - g): y for a linear response, nearly
    none for a gamma of 2.2. Read-out noise lowers the power under any response.
    """
    growth, profile, stack = edge.noise_growth, edge.profile, edge.picture.stack
    least = min(profile.side_variances) * len(stack.data)
    if (stack.holds_codes and least < THRESHOLDS.quantisation_noise_dn**2) or not growth.ratio > 0:
        return 0
    contrast = min(profile.contrast, THRESHOLDS.max_noise_contrast)
    ln_light, ln_ratio = np.log((1.0 + contrast) / (1.0 - contrast)), np.log(growth.ratio)
    if ln_ratio - 2.0 * growth.scatter > THRESHOLDS.linear_noise_power * ln_light:
        return 1
    return -1 if ln_ratio < -THRESHOLDS.falling_noise_sd * growth.scatter else 0


def response_bias(
    edge: PreparedEdge, response: CurvatureEstimate, context: Context
) -> tuple[str, float] | None:
    """Return what a nonlinear camera response may do to MTF50: what shows it and the largest
    relative bias; None: nothing.

    Asymmetry alone is no response: coma, motion and defocus have it too. A response is possible
    where the noise falls towards the light, or says nothing and the profile is asymmetric as by a
    compressive one or its few codes are those of encoded pictures. An exponent of up to 2.2 then
    biases MTF50 by up to `max_nonlinearity_bias` times the squared contrast. An asymmetric spread
    moves by up to that times the contrast itself, or contrast x rise x (c + 2 s) where a curvature
    c of standard uncertainty s is seen.
    """
    grows, profile = noise_growth_sign(edge), edge.profile
    if context.linear or has_tube(context.camera) or grows > 0:
        return None
    (curvature, error), stack = response, edge.picture.stack
    first_order = THRESHOLDS.max_nonlinearity_bias * profile.contrast
    largest, significant = first_order * profile.contrast, THRESHOLDS.curvature_sd * error
    if (abs(curvature) if grows < 0 else curvature) > max(THRESHOLDS.curvature, significant):
        rise = profile.contrast * (FLATTENING + 2.0 * EITHER_WAY) * (abs(curvature) + 2.0 * error)
        shown = "the profile is asymmetric as by a nonlinear response, and no noise grows with it"
        return shown, float(np.clip(rise, largest, first_order))
    if grows < 0:
        return "noise falls towards the light as under a nonlinear response", largest
    if stack.holds_codes and stack.data.max() <= ENCODED_DN:
        return "codes of 8 bits without noise of light may be encoded (a gamma)", largest
    return None


def nonlinearity_bias(
    response: CurvatureEstimate, contrast: float, noise_ln_odds: float, seed: int, count: int
) -> Array:
    """Return draws of what a response that may be nonlinear adds to ln of every frequency, shape
    (count,).

    0 where it is linear; `noise_ln_odds`: ln Bayes factor of the noise for a nonlinear response.
    """
    rng = np.random.default_rng([seed, 61])
    curvature = curvatures(response, contrast, noise_ln_odds, rng, count)
    rise = np.where(curvature < 0.0, STEEPENING, FLATTENING) + EITHER_WAY * rng.standard_normal(
        count
    )
    return -contrast * rise * curvature


def ln_bayes_factor_of(edge: PreparedEdge, context: Context) -> float:
    """Return the ln Bayes factor of the noise for a nonlinear response; -inf if it is linear by
    description, test or noise.
    """
    unknown = not has_tube(context.camera) and not context.linear and noise_growth_sign(edge) < 1
    return ln_bayes_factor_nonlinear(edge.noise_growth) if unknown else -np.inf


def ln_bayes_factor_nonlinear(growth: NoiseGrowth) -> float:
    """Return the ln Bayes factor of a nonlinear against a linear response for the noise ratio.

    Notes
    -----
    The variance is read-out noise with probability `READ_OUT`; that gives no information. Otherwise
    photons contribute any fraction: under a linear response the ln ratio is uniform from 0 to ln r,
    r the ratio of the signals. For covariances it is ln r. A power law of exponent g changes the ln
    ratio by 2 (1 - 1/g) ln r.
    """
    from scipy.special import ndtr

    # A side without noise, such as a clipped one, gives no information about the response.
    if growth.photon_ratio is None or not growth.photon_ratio > 1.0 or not growth.ratio > 0.0:
        return 0.0
    ln_ratio, ln_photon_ratio, error = (
        np.log(growth.ratio),
        np.log(growth.photon_ratio),
        growth.scatter,
    )
    sds = np.array([error, np.hypot(error, 2.0 * BENDING * ln_photon_ratio)])

    def normal(deviation: float, sd: Array) -> Array:
        return np.exp(-0.5 * (deviation / sd) ** 2) / (np.sqrt(2.0 * np.pi) * sd)

    if growth.of_light:
        density = normal(ln_ratio - ln_photon_ratio, sds)
    else:
        uniform = (
            ndtr(ln_ratio / sds) - ndtr((ln_ratio - ln_photon_ratio) / sds)
        ) / ln_photon_ratio
        density = READ_OUT * normal(ln_ratio, sds[:1]) + (1.0 - READ_OUT) * uniform
    linear, curved = np.log(np.maximum(density, 1e-300))
    return float(np.clip(curved - linear, -MAX_LN_BAYES_FACTOR, MAX_LN_BAYES_FACTOR))
