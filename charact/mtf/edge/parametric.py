"""Parametric edge method: blur models fitted to the profile and averaged by their evidence."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.method import Context, register
from charact.mtf.blur_models.one_dimensional import BlurModel, UnresolvedGlareComponent
from charact.mtf.curve import FINE, crossing_frequency
from charact.mtf.edge.fit.model_fit import BlurModelFit, BlurModelFitter
from charact.mtf.edge.fit.model_selection import (
    EvidenceWeightedModels,
    candidate_components,
    exceeds_model,
    fit_blur_models,
)
from charact.mtf.edge.nonlinearity import edge_ln_bayes_factor_nonlinear, marginalise_nonlinearity
from charact.mtf.edge.pixels.prepare_edge import EdgeRefusal, PreparedEdge, blur_refusal, edge_refusal, prepare_edge
from charact.mtf.edge.pixels.profile import with_shading
from charact.mtf.edge.result import EdgeFitOutput, edge_refusals, edge_result, window_normalisation_note
from charact.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.mtf.known_transfer import KnownTransfer, known_transfer
from charact.mtf.mean_frame import Region
from charact.posterior import importance_sample, laplace, sample_posterior
from charact.posterior.diagnostics import crowds_at_bound
from labdata.frames import FrameStack
from labdata.measurement import Posterior, Result

Array = NDArray[np.float64]
# A form, draws of its posterior and how many of them count.
ModelDraws = tuple[BlurModel, Posterior, int]

METHOD = "edge-parametric"
# Parameters whose bounds were merely chosen. Beyond those of the others lies what nature forbids or another form.
CHOSEN_BOUNDS = ("ln_half_frequency", "exponent")
DRAWS = 1000


@register(
    "edge",
    METHOD,
    quantities=("mtf50", "mtf10", "mtf", "edge_angle"),
    scope=(
        "Straight edges tilted 1 to 45 degrees in any direction, step over 1 standard deviation of the pixel noise, "
        "30 rows and more, blurred as lenses and tubes blur: Gaussian, exp(-(f/fc)^n) or Moffat, with halo or glare; "
        "noise may depend on the signal and be correlated. Any other blur is flagged where the data show it; a curved "
        "response, motion between fields, clipping and windows narrower than the blur break it."
    ),
)
def edge_parametric(stack: FrameStack, *, region: Region | None = None, context: Context) -> Result:
    """Measure the MTF across an edge by forms of the point spread.

    Parameters
    ----------
    stack
        Frames of one edge; they are averaged.
    region
        ROW, COL, HEIGHT, WIDTH that holds the edge and its plateaus; None: the whole frame.
    context
        Seed, whether the whole posterior or a quick answer is wanted, and the camera.

    Returns
    -------
    Result
        `mtf50`, `mtf10`, `mtf` at pinned frequencies and `edge_angle`, the curve "mtf", and the profile as evidence.

    Notes
    -----
    Mean of a pixel at distance d: level + step (E(d - shift) - 1/2) + slopes, E the edge spread of aperture x video x
    form. The draws are those of every form in proportion to its evidence.
    """
    edge = prepare_edge(stack, region, context, quickly=True, fields_apart=True)
    if isinstance(edge, EdgeRefusal):
        return edge_refusals(METHOD, edge.reason, edge.where, context)
    known = known_transfer(edge.picture, edge.profile.angle_rad, context)
    fitter, fits = fit_edge_models(edge, known, context)
    edge, profile, best = replace(edge, profile=fitter.profile), fitter.profile, fits[0].fit
    reason = edge_refusal(best.chi2, fitter.power, best.free) or blur_refusal(profile, float(np.exp(best.point[1])))
    if reason:
        return edge_refusals(METHOD, reason, edge.where, context)
    drawn = _draw_models(fitter, fits, context, parabolic=context.quick)
    if context.quick and _is_uncertain(drawn[0], known):
        drawn = _draw_models(fitter, fits, context, parabolic=False)
    response = fitter.response_curvature(best)
    odds = edge_ln_bayes_factor_nonlinear(edge, context)
    drawn = [
        (form, marginalise_nonlinearity(posterior, response, profile, odds, context.seed), count)
        for form, posterior, count in drawn
    ]
    outcome = EdgeFitOutput(
        method=METHOD,
        edge=edge,
        fitted=fitter.fitted(best),
        response=response,
        posterior=drawn[0][1],
        mtf=lambda frequency: (
            np.abs(known(frequency))
            * np.abs(np.concatenate([form.modulus(one.draws[:count, 1:], frequency) for form, one, count in drawn]))
        ),
        settings={"forms": _shares(fits)},
        notes=(_forms_note(fits), window_normalisation_note(profile)),
        flags=_flags(fitter, fits),
        doubt=known.doubt,
    )
    return edge_result(outcome, context)


def fit_edge_models(
    edge: PreparedEdge, known: KnownTransfer, context: Context
) -> tuple[BlurModelFitter, list[EvidenceWeightedModels]]:
    """Fit an edge, first as if its plateaus were even, then with the shading that the forms leave over, if any.

    Returns
    -------
    fitter, fits
        What fits forms to the edge's profile, and the forms that come near, the most probable first: the point
        estimate is the first one's.
    """
    wide = candidate_components(context, edge.profile.gathered.half_width_px, transposed=edge.picture.transposed)
    fitter = BlurModelFitter(edge.profile, known)
    fits = fit_blur_models(fitter, wide)
    shaded = with_shading(fitter.profile, fitter.profile.value - fitter.model_of(fits[0].fit))
    if shaded.shading_sd > 0:
        fitter = BlurModelFitter(shaded, known)
        fits = fit_blur_models(fitter, wide)
    return fitter, fits


def _draw_models(
    fitter: BlurModelFitter, fits: list[EvidenceWeightedModels], context: Context, *, parabolic: bool
) -> list[ModelDraws]:
    """Return draws of every form and how many of them count."""
    total = sum(one.share for one in fits)
    wanted = ACCURACY.quick_draws if parabolic else DRAWS
    out = []
    for number, one in enumerate(fits):
        count = max(1, round(wanted * one.share / total))
        # Of all but the most probable form only the draws that count are looked at.
        draws = count if context.quick and number else wanted
        posterior = _posterior(fitter, one.fit, fits[0].fit.noise_scale, context, number, draws, parabolic=parabolic)
        out.append((one.fit.family, posterior, count))
    return out


def _is_uncertain(drawn: ModelDraws, known: KnownTransfer) -> bool:
    """Tell whether MTF50 is so uncertain under a form that parabolas about the peaks do not tell its tails."""
    form, posterior, _ = drawn
    half = crossing_frequency(
        FINE, np.abs(known(FINE)) * form.modulus(posterior.draws[: ACCURACY.skew_draws, 1:], FINE), 0.5
    )
    half = half[np.isfinite(half)]
    return half.size > 0 and bool(THRESHOLDS.skewed_sd < np.std(np.log(half)) < THRESHOLDS.uninformative_sd)


def _posterior(
    fitter: BlurModelFitter,
    fit: BlurModelFit,
    noise_scale: float,
    context: Context,
    number: int,
    draws: int,
    *,
    parabolic: bool,
) -> Posterior:
    """Draw from one form's posterior: by importance or Markov chain, or from the curvature where a parabola serves."""
    asked = {
        "names": ("edge_shift_px", *fit.family.parameters),
        "units": ("px", *(unit for unit, _ in fit.family.parameters.values())),
        "start": fit.point,
        "covariance": fit.covariance * noise_scale,
        "seed": context.seed + number,
        "bounds": fitter.bounds(fit.family),
        "draws": draws,
    }
    if parabolic and np.exp(fit.point[1]) < THRESHOLDS.sharp_half_frequency:
        posterior = laplace(lambda theta: np.zeros(len(theta)), **asked)
        posterior = replace(posterior, draws=_symmetrise_in_width(posterior.draws, float(fit.point[1])))
    else:
        known = fitter.log_probability(fit.family, fit.slope_sd_per_px)
        posterior = _sample(lambda theta: known(theta) / noise_scale, asked, context)
    if "prior-bound" not in posterior.flags:
        return posterior
    chosen = np.array([False, *(name in CHOSEN_BOUNDS for name in fit.family.parameters)])
    leaning = crowds_at_bound(posterior.draws, asked["bounds"])[chosen].any()
    flags = tuple(flag for flag in posterior.flags if flag != "prior-bound" or leaning)
    return replace(posterior, flags=flags)


def _symmetrise_in_width(draws: Array, ln_half_frequency: float) -> Array:
    """Return Gaussian draws whose errors are even in the width of the blur, 1/f2, where they were in ln f2.

    Chains along these ridges are skewed that way: the data constrain a wider blur better than a sharper one.
    """
    away = np.minimum(draws[:, 1] - ln_half_frequency, ACCURACY.max_ln_error)
    return np.concatenate([draws[:, :1], (ln_half_frequency - np.log1p(-away))[:, None], draws[:, 2:]], axis=1)


def _sample(log_probability: Callable[[Array], Array], asked: dict[str, Any], context: Context) -> Posterior:
    """Draw by importance, and where that is not enough by Markov chain; where an answer is wanted quickly from less."""
    if context.quick:
        # A form of which few draws are wanted needs few to choose from.
        share = max(asked["draws"] / DRAWS, ACCURACY.min_effort)
        return importance_sample(
            log_probability,
            **asked,
            enough=ACCURACY.quick_ess * share,
            first_draws=round(ACCURACY.quick_first_draws * share),
        )
    return sample_posterior(log_probability, **asked, max_steps=ACCURACY.chain_steps)


def _flags(fitter: BlurModelFitter, fits: list[EvidenceWeightedModels]) -> tuple[str, ...]:
    departed, veiled = exceeds_model(fitter, fits[0].fit), _has_unresolved_glare(fits)
    return (*(("model-misfit",) if departed else ()), *(("window-too-small",) if veiled else ()))


def _has_unresolved_glare(fits: list[EvidenceWeightedModels]) -> bool:
    """Tell whether most of the evidence is for light wider than the window, whose share the window cannot tell."""
    return sum(one.share for one in fits if _exceeds_window(one.fit)) > THRESHOLDS.unresolved_glare_weight


def _exceeds_window(fit: BlurModelFit) -> bool:
    """Tell whether a fit's light beyond the core is a veil, or as wide as its form may be."""
    wide = fit.family.wide
    if wide is None or isinstance(wide, UnresolvedGlareComponent):
        return wide is not None
    low, high = fit.family.bounds[-wide.after_size]
    return bool(fit.point[-wide.after_size] > high - THRESHOLDS.widest_sizes * (high - low))


def _shares(fits: list[EvidenceWeightedModels]) -> dict[str, float]:
    """Return the share of the evidence of each form, in even and in uneven light together."""
    names = dict.fromkeys(one.fit.family.name for one in fits)
    return {name: round(sum(one.share for one in fits if one.fit.family.name == name), 4) for name in names}


def _forms_note(fits: list[EvidenceWeightedModels]) -> str:
    parts = ", ".join(f"{name} {100 * share:.0f} %" for name, share in _shares(fits).items())
    return f"Form of the point spread by evidence: {parts}."
