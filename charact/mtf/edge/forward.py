"""The forward method for edges: the whole profile fitted with the noise that is in it, and the posterior of its MTF."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.method import Context, register
from charact.mtf.edge import checks as edge_checks
from charact.mtf.edge.forward_fit import EdgeFit, curvature, fit, refit
from charact.mtf.edge.nonlinearity import marginalise_nonlinearity
from charact.mtf.edge.photon_transfer import edge_ln_bayes_factor_nonlinear
from charact.mtf.edge.pixels.prepare_edge import (
    WIDEST_PX,
    EdgeRefusal,
    PreparedEdge,
    blur_refusal,
    edge_refusal,
    prepare_edge,
)
from charact.mtf.edge.pixels.profile import refine_noise, with_shading
from charact.mtf.edge.result import EdgeFitOutput, edge_refusals, edge_result, window_normalisation_note
from charact.mtf.known_transfer import halo_of, known_transfer
from charact.mtf.mean_frame import Region
from charact.posterior import importance_sample, sample_posterior
from labdata.frames import FrameStack
from labdata.measurement import Posterior, Result

Array = NDArray[np.float64]

QUANTITIES = ("mtf50", "mtf10", "mtf", "edge_angle")
# Effective draws by importance where a posterior is wanted quickly, and draws to begin with.
QUICK_ENOUGH, QUICK_FIRST = 500.0, 1000
# With a halo single walkers linger in its tail for some thousand steps.
MAX_STEPS = 8000
METHOD = "edge-forward"


@register(
    "edge",
    METHOD,
    quantities=QUANTITIES,
    scope=(
        "Straight edges tilted 1 to 45 degrees in any direction, step over 1 standard deviation of the pixel noise, "
        "30 rows and more; noise may depend on the signal and be correlated. Broken by motion between fields, "
        "clipping, windows narrower than the blur, and a curved response: on a Gaussian edge of high contrast a gamma "
        "of 0.45 to 2.2 moves MTF50 by -3 to +15 % and is told only where tails or the plateaus' noise show it; at "
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
    if first.chi2 / first.free < edge_checks.MISFIT:
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
        return importance_sample(model.log_probability, **asked, enough=QUICK_ENOUGH, first_draws=QUICK_FIRST)
    return sample_posterior(model.log_probability, **asked, max_steps=MAX_STEPS)
