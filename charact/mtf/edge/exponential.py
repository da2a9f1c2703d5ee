"""The quick method for edges: one form, exp(-(f/fc)^n), fitted to the profile by Gauss-Newton."""

import numpy as np

from charact.method import Context, register
from charact.mtf.edge.fit.family_fit import FamilyFitter
from charact.mtf.edge.fit.forms import departs, stands_alone, wides
from charact.mtf.edge.noise import bending_ln_odds
from charact.mtf.edge.pixels.find import NoEdge, find_edge, no_edge, too_blurred
from charact.mtf.edge.pixels.uneven_light import EVEN_PER_PX
from charact.mtf.edge.response import bent
from charact.mtf.edge.result import Outcome, nothing, result_of, within_note
from charact.mtf.forms.families import Family
from charact.mtf.optics import known_of
from charact.mtf.region import Region
from charact.posterior import laplace
from labdata.frames import FrameStack
from labdata.measurement import Result

METHOD = "edge-exponential"
DRAWS = 300


@register(
    "edge",
    METHOD,
    quantities=("mtf50", "mtf10", "mtf", "edge_angle"),
    scope=(
        "Straight edges tilted 1 to 45 degrees in any direction, step over 1 standard deviation of the pixel noise, "
        "30 rows and more, blurred by a lens or a tube (exp(-(f/fc)^n), a Gaussian at n = 2) without halo or glare, in "
        "even light. Any other blur is flagged where the data show it."
    ),
)
def edge_exponential(stack: FrameStack, *, region: Region | None = None, context: Context) -> Result:
    """Measure the MTF across an edge by the form of tubes and lenses alone.

    Parameters
    ----------
    stack
        Frames of one edge; they are averaged.
    region
        ROW, COL, HEIGHT, WIDTH that holds the edge and its plateaus; None: the whole frame.
    context
        Seed and camera; intervals come from the curvature at the peak, whether quick or not.

    Returns
    -------
    Result
        `mtf50`, `mtf10`, `mtf` at pinned frequencies and `edge_angle`, the curve "mtf", and the profile as evidence.

    Notes
    -----
    Mean of a pixel at distance d: level + step (E(d - shift) - 1/2) + slopes, E the edge spread of aperture x video x
    exp(-ln 2 (f/f2)^n).
    """
    edge = find_edge(stack, region, context, quickly=True, fields_apart=True)
    if isinstance(edge, NoEdge):
        return nothing(METHOD, edge.reason, edge.where, context)
    known = known_of(edge.picture, edge.profile.angle_rad, context)
    fitter, form = FamilyFitter(edge.profile, known), Family(core="exponential")
    fit = fitter.fit(form, np.concatenate([[0.0], form.start(fitter.guess())]), EVEN_PER_PX)
    reason = no_edge(fit.chi2, fitter.power, fit.free) or too_blurred(edge.profile, float(np.exp(fit.point[1])))
    if reason:
        return nothing(METHOD, reason, edge.where, context)
    posterior = laplace(
        lambda theta: np.zeros(len(theta)),
        names=("edge_shift_px", *form.parameters),
        units=("px", *(unit for unit, _ in form.parameters.values())),
        start=fit.point,
        covariance=fit.covariance * fit.noise_scale,
        seed=context.seed,
        bounds=fitter.bounds(form),
        draws=DRAWS,
    )
    wide = wides(context, edge.profile.gathered.half_width_px, transposed=edge.picture.transposed)
    doubtful = departs(fitter, fit) or not stands_alone(fitter, fit, wide)
    response = fitter.response_curvature(fit)
    posterior = bent(posterior, response, edge.profile, bending_ln_odds(edge, context), context.seed)
    outcome = Outcome(
        method=METHOD,
        edge=edge,
        fitted=fitter.fitted(fit),
        response=response,
        posterior=posterior,
        mtf=lambda frequency: np.abs(known(frequency)) * form.modulus(posterior.draws[:, 1:], frequency),
        settings={"form": form.name},
        notes=(within_note(edge.profile),),
        flags=("model-misfit",) if doubtful else (),
        doubt=known.doubt,
    )
    return result_of(outcome, context)
