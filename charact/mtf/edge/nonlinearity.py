"""A camera's response that is not straight: what of it an edge shows, and what it leaves in doubt."""

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

# Curvature of the response and what it is found with.
CurvatureEstimate = tuple[float, float]
NO_CURVATURE_ESTIMATE: CurvatureEstimate = (0.0, 1.0)

# By how much MTF50 is found too high for each curvature of one and each contrast of one, in ln, under responses that
# steepen and that flatten, and how far it may be from that: power laws, knees, saturation, logarithms and parabolas on
# edges of every form. Dark sides a fiftieth to two thirds as bright as bright ones make as much for their contrast.
STEEPENING, FLATTENING, EITHER_WAY = 0.18, 0.09, 0.1


def response_flags(response: CurvatureEstimate, contrast: float, deviation: float) -> tuple[str, ...]:
    """Return `gamma` where the profile looks curved and that may move MTF50 by more than its standard error.

    The edge is asymmetric beyond the camera's known filter. A Gaussian edge through a power law above 1 stays
    nearly symmetric and shows it in its noise at most.

    Parameters
    ----------
    response
        Curvature of the response and its error.
    contrast
        Of both sides of the edge.
    deviation
        Standard deviation of MTF50, as a share of it.
    """
    curved = abs(response[0]) > max(THRESHOLDS.curvature, THRESHOLDS.curvature_sd * response[1])
    return ("gamma",) if curved and max_bias_of(response, contrast) > deviation else ()


def notes_on_undetected_nonlinearity(response: CurvatureEstimate, contrast: float, deviation: float) -> tuple[str, ...]:
    """Return the note on a curved response that the profile cannot show, where the errors do not cover it.

    Parameters
    ----------
    response
        Curvature of the response and its error.
    contrast
        Of both sides of the edge.
    deviation
        Standard deviation of MTF50, as a share of it.
    """
    lifted = contrast * min(2.0 * STEEPENING * response[1], THRESHOLDS.max_nonlinearity_bias * contrast)
    if lifted < THRESHOLDS.undetected_bias_sd * deviation:
        return ()
    return (
        "A curved response of the camera (a gamma) would not show on this edge: it may have lifted MTF50 by up to "
        f"{100.0 * lifted:.1f} %, more than the errors allow for. A described camera, or its code at no light where "
        "noise is photons', would tell.",
    )


def max_bias_of(response: CurvatureEstimate | None, contrast: float) -> float:
    """Return the share by which a curved response may have moved MTF50: as the profile asks for, or as any may."""
    most = THRESHOLDS.max_nonlinearity_bias * contrast**2
    if response is None or response == NO_CURVATURE_ESTIMATE:
        return most
    share = (STEEPENING if response[0] < 0.0 else FLATTENING) + 2.0 * EITHER_WAY
    return contrast * share * (abs(response[0]) + 2.0 * response[1])


def marginalise_nonlinearity(
    posterior: Posterior, response: CurvatureEstimate, profile: EdgeProfile, noise_ln_odds: float, seed: int
) -> Posterior:
    """Return draws of a blur with what a response that may be curved leaves in doubt.

    Parameters
    ----------
    posterior
        Draws of the blur's parameters, the second one ln of a frequency that scales the form.
    response
        Curvature of the response and its error, as the profile asks for them; below 0 it steepens.
    profile
        The edge's, whose contrast counts.
    noise_ln_odds
        Ln of how much likelier the noise is under a curved response.
    seed
        Of what is drawn besides.

    Notes
    -----
    Of the share that a curved response has, each draw takes back what a curvature, drawn from what prior and profile
    leave of it, has done to its frequency. That is nothing to a tenth of the curvature at low contrast, for the blur
    may itself be asymmetric.
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
    """Return draws of what a response that may be curved adds to ln of every frequency, 0 where it is straight."""
    rng = np.random.default_rng([seed, 61])
    curvature = curvatures(response, contrast, noise_ln_odds, rng, count)
    share = np.where(curvature < 0.0, STEEPENING, FLATTENING) + EITHER_WAY * rng.standard_normal(count)
    return -contrast * share * curvature


def remove_nonlinearity(mtf: Callable[[Array], Array], lifted: Array) -> Callable[[Array], Array]:
    """Return drawn MTFs less what has been added to ln of their frequencies, shape (f,) -> (draw, f).

    Parameters
    ----------
    mtf
        From frequencies, cy/px, to drawn MTFs.
    lifted
        Shape (draw,); most of them 0.
    """
    moved = np.flatnonzero(lifted)
    finely = mtf(FINE)[moved]

    def corrected(frequency: Array) -> Array:
        draws = mtf(frequency)
        for place, curve in zip(moved, finely, strict=True):
            draws[place] = np.interp(frequency * np.exp(lifted[place]), FINE, curve)
        return draws

    return corrected


def response_curvature(
    profile: EdgeProfile, precision_root: Array, spread: Array, tangents: Array, shapes: Array, shape_sd: Array
) -> tuple[float, float]:
    """Return the curvature of the response that a profile asks for if its blur is symmetric, with its error.

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
        Levels and slopes at the bins, shape (bin, shape), and the deviations of their priors, DN.

    Notes
    -----
    A response y = u + c u (1 - u) of the edge spread u; a power law of exponent g over levels a to b has about
    c = -g (g - 1) m^(g - 2) (b - a)^2 / 2 / (b^g - a^g), m their middle. An asymmetric blur looks the same on one edge;
    either way the modulus of the transform is not what it would be at low contrast. First order in c and in every
    parameter of a symmetric blur.
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
    black = edge.profile.black
    found = edge.plateau_noise and covariance_ratio(edge.plateau_noise, black)
    if found:
        return found
    if (
        len(edge.used.data) == 1
        or edge.plateau_noise is None
        or not max(one.variance for one in edge.plateau_noise) > 0
    ):
        return _single_frame_growth(edge)
    return variance_ratio(edge.plateau_noise, black)


def edge_ln_bayes_factor_nonlinear(edge: PreparedEdge, context: Context) -> float:
    """Return ln of how much likelier the noise is under a curved response; a described camera's is straight: -inf."""
    return ln_bayes_factor_nonlinear(growth_of(edge)) if context.sensor is None else -np.inf


def _single_frame_growth(edge: PreparedEdge) -> PlateauNoiseRatio:
    """Return how the variance of a single frame's pixels grows."""
    profile = edge.profile
    grain = profile.grain
    pixels = 0.5 * np.count_nonzero(profile.gathered.used) / max(grain.covariance_over_variance, 1.0)
    photons = None
    if profile.black is not None and profile.dark > profile.black:
        bright_dn = profile.bright - profile.black
        if bright_dn < THRESHOLDS.photon_noise_snr * np.sqrt(grain.bright_variance):
            photons = bright_dn / (profile.dark - profile.black)
    return PlateauNoiseRatio(
        ratio=grain.bright_variance / grain.dark_variance,
        # A variance of n pixels scatters by the root of 2/n, a ratio of two by that of 4/n.
        scatter=float(np.sqrt(4.0 / max(pixels, 1.0))),
        photon_ratio=photons,
    )
