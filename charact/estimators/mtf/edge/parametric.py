"""Edge methods that fit blur models: averaged by evidence, or one with model departures and a free
video bandwidth.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from charact.estimators.mtf.curve import FINE, crossing_frequency
from charact.estimators.mtf.edge.checks import misfit_finding, window_finding
from charact.estimators.mtf.edge.fit.edge_form import EdgeForm, halo_of
from charact.estimators.mtf.edge.fit.model_fit import EdgeFit, EdgeFitter
from charact.estimators.mtf.edge.fit.model_selection import (
    EvidenceWeightedModels,
    candidate_components,
    exceeds_model,
    fit_blur_models,
)
from charact.estimators.mtf.edge.nonlinearity import ln_bayes_factor_of, nonlinearity_bias
from charact.estimators.mtf.edge.pixels.prepare_edge import WIDEST_PX, PreparedEdge, fit_refusal
from charact.estimators.mtf.edge.pixels.profile import (
    EVEN_PER_PX,
    UNEVEN_PER_PX,
    EdgeProfile,
    refine_noise,
    with_shading,
)
from charact.estimators.mtf.edge.result import (
    edge_result_of_fit,
    measure_by_fit,
    refuse_edge,
    window_normalisation_note,
)
from charact.estimators.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.estimators.mtf.known_transfer import KnownTransfer, known_transfer
from charact.estimators.mtf.mean_frame import Region
from charact.inference import importance_sample, laplace, sample_posterior
from charact.inference.diagnostics import crowds_at_bound
from charact.method import Context, register
from charact.transfer.blur_model import BlurModel
from charact.transfer.extended import ExtendedComponent, UnresolvedGlareComponent
from labdata import Array, FrameStack, Posterior, Result

PARAMETRIC, FORWARD = "edge-parametric", "edge-forward"
# Parameters whose bounds were merely chosen; beyond those of the others lies what physics forbids
# or another form.
CHOSEN_BOUNDS = ("ln_half_frequency", "exponent")
DRAWS = 1000
# Prior standard deviations of departures. The least allows for errors of a description taken as
# known.
DEPARTURES = (0.03, 0.08, 0.2, 0.5)


@register("edge", PARAMETRIC)
def edge_parametric(stack: FrameStack, *, region: Region | None = None, context: Context) -> Result:
    """Measure the MTF across an edge by blur models averaged by their evidence.

    Parameters
    ----------
    stack
        Frames of one edge; they are averaged.
    region
        ROW, COL, HEIGHT, WIDTH that holds the edge and its plateaus; None: the whole frame.
    context
        Seed, speed and camera.

    Returns
    -------
    Result
        `mtf50`, `mtf10`, `mtf` at pinned frequencies and `edge_angle`, the curve "mtf", and the
        profile as evidence.

    Notes
    -----
    Mean of a pixel at distance d: level + step (E(d - shift) - 1/2) + slopes, E the edge spread of
    aperture x video x blur model. Step, level and slopes are marginalised in closed form.
    """
    return measure_by_fit(PARAMETRIC, _average_models, stack, region, context, quickly=True)


@register("edge", FORWARD)
def edge_forward(stack: FrameStack, *, region: Region | None = None, context: Context) -> Result:
    """Measure the MTF across an edge by one blur model with smooth departures.

    Parameters, results and model are those of `edge_parametric`; the core is exp(-ln 2 (f/f2)^n),
    and departures of modulus and phase and the video bandwidth of a described camera are free.
    """
    return measure_by_fit(FORWARD, _fit_departures, stack, region, context)


@dataclass(frozen=True, kw_only=True)
class _Draws:
    """Draws of one form's posterior, of which the first `count` enter the average."""

    form: EdgeForm
    posterior: Posterior
    count: int


def _result(
    method: str,
    fitter: EdgeFitter,
    edge: PreparedEdge,
    best: EdgeFit,
    drawn: Sequence[_Draws],
    known: KnownTransfer,
    context: Context,
    **method_fields: Any,
) -> Result:
    """Return what both methods make of draws, a nonlinear response marginalised."""
    if fitter.profile is not edge.profile:
        edge = replace(edge, profile=fitter.profile)
    response, odds = fitter.response_curvature(best), ln_bayes_factor_of(edge, context)
    parts = []
    for draws_of_form in drawn:
        draws = draws_of_form.posterior.draws.copy()
        draws[:, 1] -= nonlinearity_bias(
            response, edge.profile.contrast, odds, context.seed, len(draws)
        )
        parts.append(
            (draws_of_form.form, draws_of_form.count, replace(draws_of_form.posterior, draws=draws))
        )

    def mtf(frequency: Array) -> Array:
        moduli = [
            form.modulus(posterior.draws[:count], frequency) for form, count, posterior in parts
        ]
        return np.abs(known(frequency)) * np.abs(np.concatenate(moduli))

    return edge_result_of_fit(
        method, edge, fitter.fitted(best), response, parts[0][2], mtf, context, **method_fields
    )


def _average_models(edge: PreparedEdge, context: Context) -> Result:
    """Fit blur models and average them by their evidence."""
    known = known_transfer(edge.picture, edge.profile.angle_rad, context)
    fitter, fits = fit_edge_models(edge, known, context)
    best = fits[0].fit
    half = float(np.exp(best.point[1]))
    refused = fit_refusal(edge, best.chi2, fitter.maps.level_power(), best.free, half)
    if refused:
        return refuse_edge(PARAMETRIC, refused, context.seed)
    drawn = _draw_models(fitter, fits, context, parabolic=context.quick)
    if context.quick and _is_uncertain(drawn[0], known):
        drawn = _draw_models(fitter, fits, context, parabolic=False)
    names = dict.fromkeys(model.fit.family.name for model in fits)
    weights = {
        name: round(sum(model.weight for model in fits if model.fit.family.name == name), 4)
        for name in names
    }
    parts = ", ".join(f"{name} {100 * weight:.0f} %" for name, weight in weights.items())
    exceeds = (
        sum(model.weight for model in fits if _exceeds_window(model.fit))
        > THRESHOLDS.unresolved_glare_weight
    )
    fitted = fitter.fitted(best)
    findings = [misfit_finding(fitter.profile, fitted)] if exceeds_model(fitter, best) else []
    findings += [window_finding(fitter.profile)] if exceeds else []
    return _result(
        PARAMETRIC,
        fitter,
        edge,
        best,
        drawn,
        known,
        context,
        settings={"forms": weights},
        notes=(
            f"Form of the point spread by evidence: {parts}.",
            window_normalisation_note(fitter.profile),
        ),
        findings=findings,
        doubt=known.doubt,
    )


def fit_edge_models(
    edge: PreparedEdge, known: KnownTransfer, context: Context
) -> tuple[EdgeFitter, list[EvidenceWeightedModels]]:
    """Fit blur models to an edge, first as if its plateaus were even, then with the shading that is
    left over, if any.

    Returns
    -------
    fitter, fits
        The fitter of the profile, and the models that count, the most probable first.
    """
    components = candidate_components(
        context, edge.profile.gathered.half_width_px, transposed=edge.picture.transposed
    )
    fitter = EdgeFitter(edge.profile, known)
    fits = fit_blur_models(fitter, components)
    shaded = with_shading(fitter.profile, fitter.profile.value - fitter.fitted(fits[0].fit).model)
    if shaded.shading_sd > 0:
        fitter = EdgeFitter(shaded, known)
        fits = fit_blur_models(fitter, components)
    return fitter, fits


def _draw_models(
    fitter: EdgeFitter, fits: list[EvidenceWeightedModels], context: Context, *, parabolic: bool
) -> list[_Draws]:
    """Return draws of every model, from the curvature where a parabola serves."""
    total, scale = sum(model.weight for model in fits), fits[0].fit.noise_scale
    wanted = ACCURACY.quick_draws if parabolic else DRAWS
    out = []
    for number, model in enumerate(fits):
        fit, count = model.fit, max(1, round(wanted * model.weight / total))
        # Of all but the most probable model only the draws that count are needed.
        draws = count if context.quick and number else wanted
        asked = {"seed": context.seed + number, "draws": draws}
        if parabolic and np.exp(fit.point[1]) < THRESHOLDS.sharp_half_frequency:
            posterior = _laplace_draws(fit, scale, asked)
        else:
            effort = max(draws / DRAWS, ACCURACY.min_effort)
            quick = {
                "enough": ACCURACY.quick_ess * effort,
                "first_draws": round(ACCURACY.quick_first_draws * effort),
            }
            posterior = _sample(fitter, fit, scale, context, asked, quick, ACCURACY.chain_steps)
        chosen = np.array([name in CHOSEN_BOUNDS for name in fit.form.parameters])
        leaning = crowds_at_bound(posterior.draws, fit.form.bounds)[chosen].any()
        flags = tuple(flag for flag in posterior.flags if flag != "prior-bound" or leaning)
        out.append(_Draws(form=fit.form, posterior=replace(posterior, flags=flags), count=count))
    return out


def _names(form: EdgeForm) -> dict:
    """Return names, units and bounds of a form's parameters as samplers take them."""
    units = tuple(unit for unit, _ in form.parameters.values())
    return {"names": tuple(form.parameters), "units": units, "bounds": form.bounds}


def _laplace_draws(fit: EdgeFit, noise_scale: float, asked: dict) -> Posterior:
    """Return Gaussian draws whose errors are even in the width of the blur, 1/f2, not in ln f2.

    Posteriors along these ridges are skewed that way: the data constrain a wider blur better than a
    sharper one.
    """
    posterior = laplace(
        lambda theta: np.zeros(len(theta)),
        start=fit.point,
        covariance=fit.covariance * noise_scale,
        **_names(fit.form),
        **asked,
    )
    draws = posterior.draws.copy()
    draws[:, 1] = fit.point[1] - np.log1p(
        -np.minimum(draws[:, 1] - fit.point[1], ACCURACY.max_ln_error)
    )
    return replace(posterior, draws=draws)


def _sample(
    fitter: EdgeFitter,
    fit: EdgeFit,
    noise_scale: float,
    context: Context,
    asked: dict,
    quick: dict,
    steps: int,
) -> Posterior:
    """Draw from a form's posterior by importance, if not quick by Markov chain where that is not
    enough.
    """
    known = fitter.log_probability(fit.form, fit.slope_sd_per_px)
    asked = {
        **_names(fit.form),
        **asked,
        "start": fit.point,
        "covariance": fit.covariance * noise_scale,
    }
    if context.quick:
        return importance_sample(lambda theta: known(theta) / noise_scale, **asked, **quick)
    return sample_posterior(lambda theta: known(theta) / noise_scale, **asked, max_steps=steps)


def _is_uncertain(drawn: _Draws, known: KnownTransfer) -> bool:
    """Tell whether MTF50 is so uncertain that parabolas about the optimum do not tell its tails."""
    modulus = drawn.form.modulus(drawn.posterior.draws[: ACCURACY.skew_draws], FINE)
    half = crossing_frequency(FINE, np.abs(known(FINE)) * modulus, 0.5)
    half = half[np.isfinite(half)]
    return half.size > 0 and bool(
        THRESHOLDS.skewed_sd < np.std(np.log(half)) < THRESHOLDS.uninformative_sd
    )


def _exceeds_window(fit: EdgeFit) -> bool:
    """Tell whether a fit's extended component is unresolved glare, or as wide as it may be."""
    component = fit.family.wide
    if component is None or isinstance(component, UnresolvedGlareComponent):
        return component is not None
    low, high = fit.family.bounds[-component.after_size]
    return bool(fit.point[-component.after_size] > high - THRESHOLDS.widest_sizes * (high - low))


def _fit_departures(edge: PreparedEdge, context: Context) -> Result:
    """Fit one blur model with departures; its noise is estimated anew after a first fit."""
    known = known_transfer(edge.picture, edge.profile.angle_rad, context)
    profile = with_shading(edge.profile, edge.profile.value)
    halo, certain = halo_of(edge.picture, profile.gathered.half_width_px, context)
    fitter, best = _best_departures(profile, known, halo, certain=certain)
    if best.chi2 / best.free < THRESHOLDS.max_reduced_chi2:
        profile = refine_noise(profile, edge.picture, fitter.fitted(best).model)
        fitter = EdgeFitter(profile, known, fine=best.family.wide is not None)
        best = fitter.fit_departures(best.form, best.point, best.slope_sd_per_px)
    without, half = fitter.chi2_without_edge(best.slope_sd_per_px), float(np.exp(best.point[1]))
    refused = fit_refusal(edge, best.chi2, without, best.free, half)
    if refused:
        return refuse_edge(FORWARD, refused, context.seed)
    quick = {"enough": ACCURACY.forward_ess, "first_draws": ACCURACY.forward_first_draws}
    posterior = _sample(
        fitter, best, 1.0, context, {"seed": context.seed}, quick, ACCURACY.forward_steps
    )
    drawn = [_Draws(form=best.form, posterior=posterior, count=len(posterior.draws))]
    notes = (window_normalisation_note(profile),) if best.family.wide is None else ()
    settings = {"widest_px": WIDEST_PX}
    return _result(
        FORWARD, fitter, edge, best, drawn, known, context, settings=settings, notes=notes
    )


def _best_departures(
    profile: EdgeProfile, known: KnownTransfer, halo: ExtendedComponent | None, *, certain: bool
) -> tuple[EdgeFitter, EdgeFit]:
    """Fit without and with a halo, under even and uneven light, and return the most probable fit
    with its fitter.
    """
    kinds = (
        [halo] if halo is not None and certain else [None, *([halo] if halo is not None else [])]
    )
    fits: list[tuple[EdgeFitter, EdgeFit]] = []
    for kind in kinds:
        fitter = EdgeFitter(profile, known, fine=kind is not None)
        for slope in (EVEN_PER_PX, UNEVEN_PER_PX):
            former = fits[-1][1] if fits else None
            fits.append((fitter, _fit_one_kind(fitter, known, kind, slope, former)))
    return max(fits, key=lambda pair: pair[1].log_evidence)


def _fit_one_kind(
    fitter: EdgeFitter,
    known: KnownTransfer,
    halo: ExtendedComponent | None,
    slope_sd: float,
    former: EdgeFit | None,
) -> EdgeFit:
    """Fit one kind of model, at each size of departure unless another fit has chosen it, and return
    the best.
    """
    family = BlurModel(core="exponential", wide=halo)

    def form(scale: float, departure_sd: float) -> EdgeForm:
        return EdgeForm(family=family, departure_sd=departure_sd, scale=scale, known=known)

    starts = _starts(fitter, form(0.2, DEPARTURES[0]), slope_sd, former)
    scale = float(np.exp(starts[0][1])) if former is None else former.form.scale
    first = DEPARTURES[1] if former is None else former.form.departure_sd
    fits = [fitter.fit_departures(form(scale, first), start, slope_sd) for start in starts]
    best = max(fits, key=lambda fit: fit.log_evidence)
    further_sds = [sd for sd in DEPARTURES if sd != first] if former is None else []
    fits += [fitter.fit_departures(form(scale, sd), best.point, slope_sd) for sd in further_sds]
    return max(fits, key=lambda fit: fit.log_evidence)


def _starts(
    fitter: EdgeFitter, form: EdgeForm, slope_sd: float, former: EdgeFit | None
) -> list[Array]:
    """Return starting points: the most probable of a grid, for a halo one of small and one of large
    diameter.
    """
    if former is not None and former.family == form.family:
        return [former.point]
    frequencies, exponents = np.exp(np.linspace(np.log(0.01), np.log(1.5), 40)), (1.2, 2.0)
    if former is not None:
        frequencies, exponents = (
            np.exp(former.point[1]) * np.array([0.95, 1.05, 1.15]),
            (former.point[2], 2.0),
        )
    cores = np.array([(np.log(f), n) for f in frequencies for n in exponents])
    grids = [cores]
    if form.family.wide is not None:
        low, high = form.family.bounds[2:].T
        fractions = np.stack(
            np.meshgrid(*[np.linspace(0.1, 0.9, 4)] * low.size, indexing="ij"), axis=-1
        )
        fractions = fractions.reshape(-1, low.size)
        tails = low + fractions * (high - low) * np.array([0.6, *[1.0] * (low.size - 1)])
        grids = [
            np.concatenate(
                [np.repeat(cores, len(part), axis=0), np.tile(part, (len(cores), 1))], axis=1
            )
            for part in (tails[fractions[:, 1] < 0.5], tails[fractions[:, 1] > 0.5])
        ]
    log_probability = fitter.log_probability(form, slope_sd)
    expanded = [form.expand(grid) for grid in grids]
    return [points[int(np.argmax(log_probability(points)))] for points in expanded]
