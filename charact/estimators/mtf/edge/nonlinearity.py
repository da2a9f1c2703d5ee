"""Nonlinear camera response: what of it an edge shows, and what it leaves uncertain."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.curve import FINE
from charact.estimators.mtf.edge.pixels.plateau_noise import ln_bayes_factor_nonlinear
from charact.estimators.mtf.edge.pixels.prepare_edge import PreparedEdge
from charact.estimators.mtf.edge.thresholds import THRESHOLDS
from charact.estimators.mtf.nonlinearity import curvatures
from charact.method import Context
from labdata.camera.description import has_tube

Array = NDArray[np.float64]

# Curvature of the response with its standard uncertainty.
CurvatureEstimate = tuple[float, float]
NO_CURVATURE_ESTIMATE: CurvatureEstimate = (0.0, 1.0)

# Rise of ln MTF50 per curvature and contrast under responses that steepen and that flatten, and its
# scatter: power laws, knees, saturation, logarithms and parabolas on simulated edges of every blur
# model.
STEEPENING, FLATTENING, EITHER_WAY = 0.18, 0.09, 0.1


def response_flags(
    response: CurvatureEstimate, contrast: float, relative_sd: float
) -> tuple[str, ...]:
    """Return `gamma` where the profile is asymmetric and may bias MTF50 by more than its standard
    uncertainty.

    A Gaussian edge through a power law above 1 stays nearly symmetric: at most its noise shows the
    response.
    """
    curved = abs(response[0]) > max(THRESHOLDS.curvature, THRESHOLDS.curvature_sd * response[1])
    return ("gamma",) if curved and max_bias_of(response, contrast) > relative_sd else ()


def nonlinearity_notes(
    edge: PreparedEdge, response: CurvatureEstimate, relative_sd: float, context: Context
) -> tuple[str, ...]:
    """Return the note on a nonlinear response that would not show and that the intervals of MTF50
    do not cover.

    A described camera's response, one measured to be linear, or one under which noise grows as
    photons' does, is taken to be linear.
    """
    linear = ln_bayes_factor_nonlinear(edge.noise_growth) < THRESHOLDS.linear_ln_bayes_factor
    if has_tube(context.camera) or context.linear or linear or not np.isfinite(relative_sd):
        return ()
    contrast = edge.profile.contrast
    bias = contrast * min(
        2.0 * STEEPENING * response[1], THRESHOLDS.max_nonlinearity_bias * contrast
    )
    if bias < THRESHOLDS.undetected_bias_sd * relative_sd:
        return ()
    return (
        "A curved response of the camera (a gamma) would not show on this edge: it may have "
        f"lifted MTF50 by up to {100.0 * bias:.1f} %, more than the errors allow for. A described "
        "camera, or its code at no light where noise is photons', would tell.",
    )


def max_bias_of(response: CurvatureEstimate, contrast: float) -> float:
    """Return the fraction by which a nonlinear response may have moved MTF50: as estimated, or as
    any may.
    """
    if response == NO_CURVATURE_ESTIMATE:
        return THRESHOLDS.max_nonlinearity_bias * contrast**2
    rise = (STEEPENING if response[0] < 0.0 else FLATTENING) + 2.0 * EITHER_WAY
    return contrast * rise * (abs(response[0]) + 2.0 * response[1])


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
