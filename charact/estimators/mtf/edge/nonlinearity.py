"""Nonlinear camera response: what of it an edge shows, and what it leaves uncertain."""

from collections.abc import Callable

import numpy as np

from charact.estimators.mtf.curve import FINE
from charact.estimators.mtf.edge.pixels.plateau_noise import NoiseGrowth
from charact.estimators.mtf.edge.pixels.prepare_edge import PreparedEdge
from charact.estimators.mtf.edge.thresholds import THRESHOLDS
from charact.estimators.mtf.nonlinearity import BENDING, MAX_LN_BAYES_FACTOR, curvatures
from charact.method import Context
from labdata import Array
from labdata.camera.description import has_tube

# Curvature of the response with its standard uncertainty.
CurvatureEstimate = tuple[float, float]
NO_CURVATURE_ESTIMATE: CurvatureEstimate = (0.0, 1.0)

# Rise of ln MTF50 per curvature and contrast under responses that steepen and that flatten, and its
# scatter: power laws, knees, saturation, logarithms and parabolas on simulated edges of every blur
# model.
STEEPENING, FLATTENING, EITHER_WAY = 0.18, 0.09, 0.1
# Prior probability that noise is read-out noise.
READ_OUT = 0.5


def response_bias(
    edge: PreparedEdge, response: CurvatureEstimate, relative_sd: float, context: Context
) -> tuple[str, float, int] | None:
    """Return what a nonlinear camera response may do to MTF50: what shows it, the largest relative
    bias, and its sign; None: nothing.

    The profile of an edge shows a curvature c where it is asymmetric, of standard uncertainty s. It
    biases ln MTF50 by at most contrast x rise x (|c| + 2 s). A Gaussian edge through a power law
    above 1 stays nearly symmetric, which lifts MTF50 by up to 2 s x rise unseen; at contrast one by
    no more than any power law does. The response of a described camera, one measured to be linear,
    or one under which noise grows as photons' does, is taken to be linear.
    """
    (curvature, error), contrast = response, edge.profile.contrast
    if context.linear:
        return None
    if abs(curvature) > max(THRESHOLDS.curvature, THRESHOLDS.curvature_sd * error):
        rise = (STEEPENING if curvature < 0.0 else FLATTENING) + 2.0 * EITHER_WAY
        shown = "the profile is asymmetric as by a nonlinear camera response"
        return shown, contrast * rise * (abs(curvature) + 2.0 * error), 0
    linear = ln_bayes_factor_nonlinear(edge.noise_growth) < THRESHOLDS.linear_ln_bayes_factor
    bias = contrast * min(2.0 * STEEPENING * error, THRESHOLDS.max_nonlinearity_bias * contrast)
    # What is smaller is part of the interval: the response is marginalised.
    if (
        has_tube(context.camera)
        or linear
        or not bias >= THRESHOLDS.undetected_bias_sd * relative_sd
    ):
        return None
    return "a nonlinear camera response (a gamma) would not show on this edge", bias, 1


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


def remove_nonlinearity(mtf: Callable[[Array], Array], bias: Array) -> Callable[[Array], Array]:
    """Return drawn MTFs, shape (f,) -> (draw, f), less a bias of ln of their frequencies, shape
    (draw,).
    """
    biased = np.flatnonzero(bias)
    finely = mtf(FINE)[biased]

    def corrected(frequency: Array) -> Array:
        draws = mtf(frequency)
        for index, curve in zip(biased, finely, strict=True):
            draws[index] = np.interp(frequency * np.exp(bias[index]), FINE, curve)
        return draws

    return corrected


def ln_bayes_factor_of(edge: PreparedEdge, context: Context) -> float:
    """Return the ln Bayes factor of the noise for a nonlinear response; -inf if it is linear by
    description or test.
    """
    unknown = not has_tube(context.camera) and not context.linear
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
