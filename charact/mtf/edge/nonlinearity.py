"""Nonlinear camera response: what of it an edge shows, and what it leaves uncertain."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.mtf.curve import FINE
from charact.mtf.edge.pixels.prepare_edge import PreparedEdge
from charact.mtf.edge.pixels.profile import EdgeProfile
from charact.mtf.edge.thresholds import THRESHOLDS
from charact.mtf.nonlinearity import (
    PlateauNoiseRatio,
    contrast_of,
    covariance_ratio,
    curvatures,
    ln_bayes_factor_nonlinear,
    variance_ratio,
)
from labdata.measurement import Posterior

Array = NDArray[np.float64]

# Curvature of the response with its standard uncertainty.
CurvatureEstimate = tuple[float, float]
NO_CURVATURE_ESTIMATE: CurvatureEstimate = (0.0, 1.0)

# Rise of ln MTF50 per curvature and contrast under responses that steepen and that flatten, and its scatter: power
# laws, knees, saturation, logarithms and parabolas on simulated edges of every blur model.
STEEPENING, FLATTENING, EITHER_WAY = 0.18, 0.09, 0.1


def response_flags(response: CurvatureEstimate, contrast: float, relative_sd: float) -> tuple[str, ...]:
    """Return `gamma` where the profile is asymmetric and may bias MTF50 by more than its standard uncertainty.

    A Gaussian edge through a power law above 1 stays nearly symmetric: at most its noise shows the response.
    """
    curved = abs(response[0]) > max(THRESHOLDS.curvature, THRESHOLDS.curvature_sd * response[1])
    return ("gamma",) if curved and max_bias_of(response, contrast) > relative_sd else ()


def nonlinearity_notes(
    edge: PreparedEdge, response: CurvatureEstimate | None, relative_sd: float, context: Context
) -> tuple[str, ...]:
    """Return the note on a nonlinear response that would not show and that the intervals of MTF50 do not cover.

    A described camera's response, or one under which noise grows as photons' does, is taken to be linear.
    """
    linear = ln_bayes_factor_nonlinear(growth_of(edge)) < THRESHOLDS.linear_ln_bayes_factor
    if context.sensor is not None or linear or not np.isfinite(relative_sd):
        return ()
    own = contrast(edge.profile)
    error = (response or NO_CURVATURE_ESTIMATE)[1]
    bias = own * min(2.0 * STEEPENING * error, THRESHOLDS.max_nonlinearity_bias * own)
    if bias < THRESHOLDS.undetected_bias_sd * relative_sd:
        return ()
    return (
        "A curved response of the camera (a gamma) would not show on this edge: it may have lifted MTF50 by up to "
        f"{100.0 * bias:.1f} %, more than the errors allow for. A described camera, or its code at no light where "
        "noise is photons', would tell.",
    )


def max_bias_of(response: CurvatureEstimate | None, contrast: float) -> float:
    """Return the fraction by which a nonlinear response may have moved MTF50: as estimated, or as any may."""
    if response is None or response == NO_CURVATURE_ESTIMATE:
        return THRESHOLDS.max_nonlinearity_bias * contrast**2
    share = (STEEPENING if response[0] < 0.0 else FLATTENING) + 2.0 * EITHER_WAY
    return contrast * share * (abs(response[0]) + 2.0 * response[1])


def marginalise_nonlinearity(
    posterior: Posterior, response: CurvatureEstimate, profile: EdgeProfile, noise_ln_odds: float, seed: int
) -> Posterior:
    """Return draws of a blur with the uncertainty by a response that may be nonlinear.

    Parameters
    ----------
    posterior
        Draws of the blur's parameters, the second one ln of a frequency that scales the form.
    response
        Curvature of the response with its standard uncertainty; below 0 it steepens.
    profile
        The edge's, whose contrast counts.
    noise_ln_odds
        Ln Bayes factor of the noise for a nonlinear response.
    seed
        Seed of the curvatures.
    """
    draws = posterior.draws.copy()
    draws[:, 1] -= nonlinearity_bias(response, contrast(profile), noise_ln_odds, seed, len(draws))
    return replace(posterior, draws=draws)


def contrast(profile: EdgeProfile) -> float:
    """Return the contrast of an edge's sides."""
    return contrast_of(profile.dark, profile.bright, profile.black)


def nonlinearity_bias(
    response: CurvatureEstimate, contrast: float, noise_ln_odds: float, seed: int, count: int
) -> Array:
    """Return draws of what the response adds to ln of every frequency, 0 where it is linear, shape (count,)."""
    rng = np.random.default_rng([seed, 61])
    curvature = curvatures(response, contrast, noise_ln_odds, rng, count)
    share = np.where(curvature < 0.0, STEEPENING, FLATTENING) + EITHER_WAY * rng.standard_normal(count)
    return -contrast * share * curvature


def remove_nonlinearity(mtf: Callable[[Array], Array], bias: Array) -> Callable[[Array], Array]:
    """Return drawn MTFs, shape (f,) -> (draw, f), less a bias of ln of their frequencies, shape (draw,)."""
    moved = np.flatnonzero(bias)
    finely = mtf(FINE)[moved]

    def corrected(frequency: Array) -> Array:
        draws = mtf(frequency)
        for index, curve in zip(moved, finely, strict=True):
            draws[index] = np.interp(frequency * np.exp(bias[index]), FINE, curve)
        return draws

    return corrected


def response_curvature(
    profile: EdgeProfile, precision_root: Array, spread: Array, tangents: Array, shapes: Array, shape_sd: Array
) -> CurvatureEstimate:
    """Return the curvature of the response that a profile requires if its blur is symmetric, with its uncertainty.

    Parameters
    ----------
    profile
        The measured profile.
    precision_root
        Inverse root of the covariance of its bins.
    spread
        Fitted edge spread less one half at the bins, shape (bin,).
    tangents
        Its change as each parameter of the blur moves by the most it may, shape (parameter, bin).
    shapes, shape_sd
        Levels and slopes at the bins, shape (bin, shape), and the standard deviations of their priors, DN.

    Notes
    -----
    A response y = u + c u (1 - u) of the edge spread u; a power law of exponent g over levels a to b has about
    c = -g (g - 1) m^(g - 2) (b - a)^2 / 2 / (b^g - a^g), m their middle. First order in c and in every parameter of a
    symmetric blur; an asymmetric blur looks the same on one edge.
    """
    level = np.clip(spread + 0.5, 0.0, 1.0)
    design = np.concatenate(
        [spread[:, None], (level * (1.0 - level))[:, None], tangents.T * abs(profile.step), shapes], axis=1
    )
    white = precision_root @ design
    prior = np.zeros(design.shape[1])
    prior[2 : 2 + len(tangents)] = 1.0
    prior[2 + len(tangents) :] = 1.0 / np.maximum(shape_sd, 1e-300) ** 2
    scale = np.sqrt(np.maximum(np.sum(white**2, axis=0) + prior, 1e-300))
    normal = (white.T @ white + np.diag(prior)) / np.outer(scale, scale)
    inverse = np.linalg.pinv(normal, rcond=1e-13, hermitian=True) / np.outer(scale, scale)
    found = inverse @ (white.T @ (precision_root @ profile.value))
    return float(found[1] / found[0]), float(np.sqrt(max(inverse[1, 1], 0.0)) / abs(found[0]))


def growth_of(edge: PreparedEdge) -> PlateauNoiseRatio:
    """Return how the noise of an edge grows with the light, from frame to frame where there are several that differ."""
    black, profile, grain = edge.profile.black, edge.profile, edge.profile.grain
    sides = edge.plateau_noise
    found = sides and covariance_ratio(sides, black)
    if found:
        return found
    if len(edge.used.data) > 1 and sides is not None and max(one.variance for one in sides) > 0:
        return variance_ratio(sides, black)
    pixels = 0.5 * np.count_nonzero(profile.gathered.used) / max(grain.covariance_over_variance, 1.0)
    photons = None
    if black is not None and profile.dark > black:
        bright_dn = profile.bright - black
        if bright_dn < THRESHOLDS.photon_noise_snr * np.sqrt(grain.bright_variance):
            photons = bright_dn / (profile.dark - black)
    return PlateauNoiseRatio(
        ratio=grain.bright_variance / grain.dark_variance,
        # A variance of n pixels scatters by the root of 2/n, a ratio of two by that of 4/n.
        scatter=float(np.sqrt(4.0 / max(pixels, 1.0))),
        photon_ratio=photons,
    )


def edge_ln_bayes_factor_nonlinear(edge: PreparedEdge, context: Context) -> float:
    """Return the ln Bayes factor of the noise for a nonlinear response; -inf for a described camera: it is linear."""
    return ln_bayes_factor_nonlinear(growth_of(edge)) if context.sensor is None else -np.inf
