"""The model-free method for edges: a line spread of any shape, as smooth as the data ask for, and no parametric tail.

The line spread in front of the pixel is a Gaussian process: smooth over a length, confined to a width and more or less
symmetric, all of which the data choose by their evidence. The profile is linear in it, so that everything is in closed
form and nothing has to be climbed.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from charact.method import Context, register
from charact.mtf.blur_models.one_dimensional import BlurModel
from charact.mtf.edge import checks as edge_checks
from charact.mtf.edge.fit.model_fit import BlurModelFitter
from charact.mtf.edge.line_spread import LineSpreads, Transfers
from charact.mtf.edge.nonlinearity import NO_CURVATURE_ESTIMATE, contrast, nonlinearity_bias, remove_nonlinearity
from charact.mtf.edge.photon_transfer import edge_ln_bayes_factor_nonlinear
from charact.mtf.edge.pixels.illumination_gradient import EVEN_PER_PX, UNEVEN_PER_PX
from charact.mtf.edge.pixels.prepare_edge import EdgeRefusal, PreparedEdge, blur_refusal, edge_refusal, prepare_edge
from charact.mtf.edge.pixels.profile import with_shading
from charact.mtf.edge.result import EdgeFitOutput, edge_refusals, edge_result, window_normalisation_note
from charact.mtf.known_transfer import KnownTransfer, known_transfer
from charact.mtf.mean_frame import Region
from labdata.frames import FrameStack
from labdata.measurement import Result

Array = NDArray[np.float64]

METHOD = "edge-free"
# Light that slopes looks like a long tail: both are weighed.
SLOPES_PER_PX = (EVEN_PER_PX, UNEVEN_PER_PX)


@register(
    "edge",
    METHOD,
    quantities=("mtf50", "mtf10", "mtf", "edge_angle"),
    scope=(
        "Straight edges tilted 1 to 45 degrees in any direction, step over 5 standard deviations of the pixel noise, "
        "60 rows and more, a line spread of any smooth shape that ends inside the region. Normalises to the light "
        "inside the region: what tails and halo carry beyond it is not seen. Noise costs it up to half as much again "
        "as a method that knows the form."
    ),
)
def edge_free(stack: FrameStack, *, region: Region | None = None, context: Context) -> Result:
    """Measure the MTF across an edge without a form of the point spread.

    Parameters
    ----------
    stack
        Frames of one edge; they are averaged.
    region
        ROW, COL, HEIGHT, WIDTH that holds the edge and its plateaus; None: the whole frame.
    context
        Seed and camera.

    Returns
    -------
    Result
        `mtf50`, `mtf10`, `mtf` at pinned frequencies and `edge_angle`, the curve "mtf", and the profile as evidence.

    Notes
    -----
    Prior covariance of the line spread at distances d and d': s^2 w(d) w(d') exp(-(d - d')^2 / (2 l^2)) with the
    envelope w(d) = 1/(1 + (d/a)^2) or exp(-sqrt(1 + (d/a)^2)), its odd part made smaller by a factor; envelope, a, l
    and factor on a grid by marginal likelihood, in even light and in light that slopes, s by the step. Regularised line
    spread with the regularisation chosen by evidence (MacKay, Neural Computation 4, 1992, 415). Light beyond the region
    is taken to lie anywhere between none and twice what the outer half of the region holds.
    """
    edge = prepare_edge(stack, region, context, fields_apart=True)
    if isinstance(edge, EdgeRefusal):
        return edge_refusals(METHOD, edge.reason, edge.where, context)
    known = known_transfer(edge.picture, edge.profile.angle_rad, context)
    edge, spreads = _fit_edge(edge, known)
    best = spreads.settings[0]
    reason = edge_refusal(best.chi2, spreads.power, spreads.free)
    if reason:
        return edge_refusals(METHOD, reason, edge.where, context)
    posterior = spreads.posterior(context.seed)
    transfers = Transfers(places=spreads.places, draws=posterior.draws, known=known, seed=context.seed)
    half = np.argmax(transfers.mtf(np.linspace(0.005, 1.5, 300)).mean(axis=0) < 0.5) * 0.005 + 0.005
    reason = blur_refusal(edge.profile, float(half))
    if reason:
        return edge_refusals(METHOD, reason, edge.where, context)
    odds = edge_ln_bayes_factor_nonlinear(edge, context)
    lifted = nonlinearity_bias(NO_CURVATURE_ESTIMATE, contrast(edge.profile), odds, context.seed, len(posterior.draws))
    outcome = EdgeFitOutput(
        method=METHOD,
        edge=edge,
        fitted=edge_checks.FittedProfile(
            model=best.model, amplitude=best.amplitude, chi2=best.chi2, free=spreads.free - best.used_freedom
        ),
        response=spreads.response_curvature(posterior.draws),
        posterior=posterior,
        mtf=remove_nonlinearity(transfers.mtf, lifted),
        settings={"width_px": round(best.width_px, 3), "tail": best.tail, "smooth_over_px": round(best.smooth_px, 3)},
        notes=(window_normalisation_note(edge.profile),),
        doubt=known.doubt,
    )
    return edge_result(outcome, context)


def _fit_edge(edge: PreparedEdge, known: KnownTransfer) -> tuple[PreparedEdge, LineSpreads]:
    """Fit an edge, first as if its plateaus were even, then with the shading that is left over, if any."""
    profile = edge.profile
    fitter = BlurModelFitter(profile, known)
    family = BlurModel(core="gaussian")
    shift_px = float(fitter.fit(family, np.array([0.0, np.log(fitter.guess())]), EVEN_PER_PX).point[0])
    spreads = LineSpreads(profile, known, SLOPES_PER_PX, shift_px)
    shaded = with_shading(profile, profile.value - spreads.settings[0].model)
    if shaded.shading_sd > 0:
        spreads = LineSpreads(shaded, known, SLOPES_PER_PX, shift_px)
    return replace(edge, profile=shaded), spreads
