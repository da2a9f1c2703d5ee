"""The forward method for edges: the whole profile fitted with the noise that is in it, and the posterior of its MTF."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.method import Context, register
from charact.mtf.blur_models.one_dimensional import ExtendedComponent
from charact.mtf.edge.checks import FittedProfile
from charact.mtf.edge.fit.esf_from_mtf import nodes
from charact.mtf.edge.forward_model import KNOTS, PARAMETERS, EdgeModel
from charact.mtf.edge.nonlinearity import (
    CurvatureEstimate,
    edge_ln_bayes_factor_nonlinear,
    marginalise_nonlinearity,
    response_curvature,
)
from charact.mtf.edge.pixels.prepare_edge import (
    WIDEST_PX,
    EdgeRefusal,
    PreparedEdge,
    blur_refusal,
    edge_refusal,
    prepare_edge,
)
from charact.mtf.edge.pixels.profile import EVEN_PER_PX, UNEVEN_PER_PX, EdgeProfile, refine_noise, with_shading
from charact.mtf.edge.result import EdgeFitOutput, edge_refusals, edge_result, window_normalisation_note
from charact.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.mtf.known_transfer import KnownTransfer, halo_of, known_transfer
from charact.mtf.mean_frame import Region
from charact.posterior import find_maximum, importance_sample, sample_posterior
from labdata.frames import FrameStack
from labdata.measurement import Posterior, Result

Array = NDArray[np.float64]

# The least allows for what a description has wrong though it is taken as known, such as a video bandwidth.
DEPARTURES = (0.03, 0.08, 0.2, 0.5)


@dataclass(frozen=True, kw_only=True)
class EdgeFit:
    """The most probable transfer of a profile.

    Parameters
    ----------
    model
        The model chosen.
    point, covariance
        Peak of its posterior and the inverse of the curvature there.
    log_evidence
        ln of the evidence by Laplace's approximation.
    chi2, free
        Chi squared at the peak, and the bins less the parameters that the data fix.
    chi2_without
        Chi squared without an edge.
    slope_sd_per_px
        Prior of the illumination's slopes, share of the step per px.
    """

    model: EdgeModel
    point: Array
    covariance: Array
    log_evidence: float
    chi2: float
    free: int
    chi2_without: float
    slope_sd_per_px: float

    @cached_property
    def fitted(self) -> FittedProfile:
        """The profile at the peak."""
        model, amplitude = self.model.evidence.profile(self.model.transfer_at_nodes(self.point[None])[0])
        return FittedProfile(model=model, amplitude=amplitude, chi2=self.chi2, free=self.free)


def fit(profile: EdgeProfile, known: KnownTransfer, *, halo: ExtendedComponent | None, halo_certain: bool) -> EdgeFit:
    """Fit a profile without and with a halo, under even and under uneven light, and return the most probable.

    Parameters
    ----------
    known
        Known part of the transfer.
    halo
        Prior of a halo; None: the window is too narrow for one.
    halo_certain
        Whether the camera is known to have one.
    """
    kinds: list[ExtendedComponent | None] = [halo] if halo is not None and halo_certain else [None]
    if halo is not None and not halo_certain:
        kinds.append(halo)
    found: list[EdgeFit] = []
    for kind in kinds:
        for slope in (EVEN_PER_PX, UNEVEN_PER_PX):
            found.append(_fit(profile, known, kind, slope, found[-1] if found else None))
    return max(found, key=lambda one: one.log_evidence)


def refit(profile: EdgeProfile, found: EdgeFit) -> EdgeFit:
    """Fit the same kind of model again, from where it was, to a profile whose noise is known better."""
    evidence = profile.evidence(found.model.grid, found.slope_sd_per_px)
    model = replace(found.model, evidence=evidence)
    return _optimise(model, found.point, found.slope_sd_per_px)


def _fit(
    profile: EdgeProfile,
    known: KnownTransfer,
    halo: ExtendedComponent | None,
    slope_sd_per_px: float,
    near: EdgeFit | None,
) -> EdgeFit:
    """Fit one kind of model, at each size of departure unless another fit has chosen it, and return the best."""
    grid = nodes(fine=halo is not None)
    evidence = profile.evidence(grid, slope_sd_per_px)

    def model(scale: float, departure: float) -> EdgeModel:
        return EdgeModel(grid=grid, known=known, evidence=evidence, scale=scale, departure_sd=departure, halo=halo)

    starts = _starts(model(0.2, DEPARTURES[0]), near)
    scale = float(np.exp(starts[0][1])) if near is None else near.model.scale
    first = DEPARTURES[1] if near is None else near.model.departure_sd
    found = [_optimise(model(scale, first), start, slope_sd_per_px) for start in starts]
    best = max(found, key=lambda one: one.log_evidence)
    others = [sd for sd in DEPARTURES if sd != first] if near is None else []
    found += [_optimise(model(scale, sd), best.point, slope_sd_per_px) for sd in others]
    return max(found, key=lambda one: one.log_evidence)


def _optimise(model: EdgeModel, start: Array, slope_sd_per_px: float) -> EdgeFit:
    """Return the fit at the peak above a start.

    Nearly noiseless data make narrow ridges: the first steps maximise a tempered posterior.
    """
    for power in (ACCURACY.tempered_power, 1e2 * ACCURACY.tempered_power):
        if model.evidence.marginal.power > 30.0 * power:
            share = power / model.evidence.marginal.power
            start, _ = find_maximum(lambda theta, share=share: model.log_tempered(theta, share), start, model.bounds)
    return _fit_with_evidence(model, *find_maximum(model.log_probability, start, model.bounds), slope_sd_per_px)


def _starts(model: EdgeModel, near: EdgeFit | None) -> list[Array]:
    """Return starting points: the most probable of a grid, for a halo one of small and one of large diameter."""
    if near is not None and near.model.halo == model.halo:
        return [near.point]
    frequencies = np.exp(np.linspace(np.log(0.01), np.log(1.5), 40))
    exponents: tuple[float, ...] = (1.2, 2.0)
    if near is not None:
        frequencies, exponents = np.exp(near.point[1]) * np.array([0.95, 1.05, 1.15]), (near.point[2], 2.0)
    points = [model.start(float(f), float(n)) for f in frequencies for n in exponents]
    if model.halo is None:
        return [_best_of(model, np.array(points))]
    count = len(model.halo.parameters)
    low, high = np.array([bound for _, bound in model.halo.parameters.values()]).T
    places = np.stack(np.meshgrid(*[np.linspace(0.1, 0.9, 4)] * count, indexing="ij"), axis=-1).reshape(-1, count)
    starts = []
    for part in (places[:, 1] < 0.5, places[:, 1] > 0.5):
        tails = low + places[part] * (high - low) * np.array([0.6, *[1.0] * (count - 1)])
        cores = [(point[:PARAMETERS], point[PARAMETERS + count :]) for point in points]
        both = [np.concatenate([core, tail, rest]) for core, rest in cores for tail in tails]
        starts.append(_best_of(model, np.array(both)))
    return starts


def _best_of(model: EdgeModel, points: Array) -> Array:
    """Return the most probable of some points."""
    return points[int(np.argmax(model.log_probability(points)))]


def _fit_with_evidence(model: EdgeModel, point: Array, covariance: Array, slope_sd_per_px: float) -> EdgeFit:
    """Return a fit with its evidence."""
    height = float(model.log_probability(point[None])[0])
    volume = 0.5 * float(np.linalg.slogdet(2.0 * np.pi * covariance)[1]) + np.log(
        _fraction_inside(model, point, covariance)
    )
    _, chi2 = model.evidence.marginal.amplitude(model.transfer_at_nodes(point[None]))
    return EdgeFit(
        model=model,
        point=point,
        covariance=covariance,
        log_evidence=height + volume + model.evidence.log_nuisance,
        chi2=float(chi2[0]),
        free=max(model.evidence.free - 6, 1),
        chi2_without=model.evidence.marginal.power,
        slope_sd_per_px=slope_sd_per_px,
    )


def _fraction_inside(model: EdgeModel, point: Array, covariance: Array) -> float:
    """Return the share of the Gaussian at the peak that lies inside the bounds: the rest is no evidence."""
    values, vectors = np.linalg.eigh(covariance)
    normal = np.random.default_rng(0).standard_normal((2000, point.size))
    draws = point + (normal * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    bounds = model.bounds
    return max(float(np.mean(np.all((draws >= bounds[:, 0]) & (draws <= bounds[:, 1]), axis=1))), 1e-3)


def curvature(found: EdgeFit, profile: EdgeProfile) -> CurvatureEstimate:
    """Return the curvature of the response that the profile asks for, and its error.

    Every parameter of the blur but its phases, which stay at the camera's known filter, may move by five of its
    posterior deviations.
    """
    model, evidence = found.model, found.model.evidence
    centre = found.point.copy()
    centre[3 + KNOTS.size : PARAMETERS] = 0.0
    free = np.concatenate([np.arange(3 + KNOTS.size), np.arange(PARAMETERS, centre.size)])
    step = 0.1 * np.sqrt(np.diag(found.covariance))[free]
    moved = np.concatenate([centre + np.eye(centre.size)[free] * step[:, None] * sign for sign in (1.0, -1.0)])
    moved = np.clip(moved, model.bounds[:, 0], model.bounds[:, 1])
    spreads = model.transfer_at_nodes(np.concatenate([centre[None], moved])) @ evidence.spread.T
    tangents = (spreads[1 : 1 + free.size] - spreads[1 + free.size :]) / 2.0 * (5.0 / 0.1)
    return response_curvature(
        profile, evidence.precision_root, spreads[0], tangents, evidence.nuisance, evidence.nuisance_sd
    )


QUANTITIES = ("mtf50", "mtf10", "mtf", "edge_angle")
METHOD = "edge-forward"


@register(
    "edge",
    METHOD,
    quantities=QUANTITIES,
    scope=(
        "Straight edges tilted 1 to 45 degrees in any direction, step over 1 standard deviation of the pixel noise, "
        "30 rows and more; noise may depend on the signal and be correlated. Broken by motion between fields, "
        "clipping, windows narrower than the blur, and a curved response: on a Gaussian edge of high contrast a gamma "
        "of 0.45 to 2.2 moves MTF50 by -3 to +15 % and is detected only from tails or the plateaus' noise; at "
        "low contrast it does no harm."
    ),
)
def edge_forward(stack: FrameStack, *, region: Region | None = None, context: Context) -> Result:
    """Measure the MTF across an edge by fitting its profile.

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
    Mean of a pixel at distance d: level + step (E(d) - 1/2) + slopes, E the edge spread of
    aperture x video x exp(-ln 2 (f/f2)^n) x departure x halo. Levels, step and slopes are marginalised in closed form.
    """
    edge = prepare_edge(stack, region, context, fields_apart=True)
    if isinstance(edge, EdgeRefusal):
        return edge_refusals(METHOD, edge.reason, edge.where, context)
    found = _fit_edge(edge, context)
    if isinstance(found, str):
        return edge_refusals(METHOD, found, edge.where, context)
    model = found.fit.model
    response = curvature(found.fit, found.edge.profile)
    odds = edge_ln_bayes_factor_nonlinear(found.edge, context)
    posterior = marginalise_nonlinearity(
        _posterior(found.fit, context), response, found.edge.profile, odds, context.seed
    )
    outcome = EdgeFitOutput(
        method=METHOD,
        edge=found.edge,
        fitted=found.fit.fitted,
        response=response,
        posterior=posterior,
        mtf=lambda frequency: model.mtf(posterior.draws, frequency),
        settings={"widest_px": WIDEST_PX},
        notes=(window_normalisation_note(found.edge.profile),) if model.halo is None else (),
    )
    return edge_result(outcome, context)


@dataclass(frozen=True, kw_only=True)
class _FittedEdge:
    """An edge found and fitted."""

    edge: PreparedEdge
    fit: EdgeFit


def _fit_edge(edge: PreparedEdge, context: Context) -> _FittedEdge | str:
    """Fit the edge, its noise estimated anew after a first fit; a sentence where there is none."""
    profile = with_shading(edge.profile, edge.profile.value)
    known = known_transfer(edge.picture, profile.angle_rad, context)
    halo, certain = halo_of(edge.picture, profile.gathered.half_width_px, context)
    first = fit(profile, known, halo=halo, halo_certain=certain)
    if first.chi2 / first.free < THRESHOLDS.max_reduced_chi2:
        profile = refine_noise(profile, edge.picture, first.fitted.model)
        first = refit(profile, first)
    reason = edge_refusal(first.chi2, first.chi2_without, first.free) or blur_refusal(
        profile, float(np.exp(first.point[1]))
    )
    if reason:
        return reason
    return _FittedEdge(edge=replace(edge, profile=profile), fit=first)


def _posterior(fit: EdgeFit, context: Context) -> Posterior:
    """Draw from the posterior, quickly by importance alone."""
    model = fit.model
    asked = {
        "names": model.names,
        "units": model.units,
        "start": fit.point,
        "covariance": fit.covariance,
        "seed": context.seed,
        "bounds": model.bounds,
    }
    if context.quick:
        return importance_sample(
            model.log_probability, **asked, enough=ACCURACY.forward_ess, first_draws=ACCURACY.forward_first_draws
        )
    return sample_posterior(model.log_probability, **asked, max_steps=ACCURACY.forward_steps)
