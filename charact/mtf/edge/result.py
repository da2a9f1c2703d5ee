"""Result of a fitted edge: measurements, curve and evidence from the draws of its MTF."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import charact
from charact.method import Context
from charact.mtf.curve import mtf_measurements
from charact.mtf.edge.checks import (
    Facts,
    FittedProfile,
    course_notes,
    edge_flags,
    findings_of,
    fit_flags,
)
from charact.mtf.edge.nonlinearity import CurvatureEstimate, contrast, nonlinearity_notes, response_flags
from charact.mtf.edge.pixels.line import orientation_deg
from charact.mtf.edge.pixels.prepare_edge import EdgeRefusal, PreparedEdge, prepare_edge
from charact.mtf.edge.pixels.profile import EdgeProfile
from charact.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.mtf.known_transfer import KnownTransfer, known_transfer
from charact.mtf.mean_frame import Region
from charact.mtf.thresholds import LIMITS
from charact.posterior import has_several_peaks
from labdata.frames import FrameStack
from labdata.measurement import Measurement, Posterior, Provenance, Result, make_refusal, measurement_from_sd

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class EdgeFitOutput:
    """An edge as a method fitted it.

    Parameters
    ----------
    method
        Name of the method.
    edge
        The edge with its profile.
    fitted
        The profile as fitted.
    response
        Curvature of the camera response that the profile requires, with its standard uncertainty.
    posterior
        Draws of the parameters.
    mtf
        From frequencies, cy/px, to drawn MTFs, shape (f,) -> (draw, f).
    settings
        What the result depends on besides seed and version.
    notes, flags
        The method's own.
    doubt
        Relative standard uncertainty of the MTF by what the method takes as exactly known, shape (f,) -> (f,);
        None: nothing.
    """

    method: str
    edge: PreparedEdge
    fitted: FittedProfile
    response: CurvatureEstimate
    posterior: Posterior
    mtf: Callable[[Array], Array]
    settings: dict
    notes: tuple[str, ...] = ()
    flags: tuple[str, ...] = ()
    doubt: Callable[[Array], Array] | None = None


EdgeFitFunction = Callable[[PreparedEdge, KnownTransfer, Context], EdgeFitOutput | EdgeRefusal]


def measure_by_fit(
    method: str,
    fit: EdgeFitFunction,
    stack: FrameStack,
    region: Region | None,
    context: Context,
    *,
    quickly: bool = False,
) -> Result:
    """Find the edge of a region, fit it, and return measurements, curve and evidence.

    Parameters
    ----------
    method, fit
        The method's name, and its fit of a prepared edge.
    stack, region, context
        As every method gets them.
    quickly
        Whether wider bins serve where noise hides what narrow ones would show.
    """
    edge = prepare_edge(stack, region, context, quickly=quickly, fields_apart=True)
    if isinstance(edge, PreparedEdge):
        found = fit(edge, known_transfer(edge.picture, edge.profile.angle_rad, context), context)
        if isinstance(found, EdgeFitOutput):
            return _result(found, context)
        edge = found
    return refuse_edge(method, edge, Provenance(version=charact.__version__, seed=context.seed))


def refuse_edge(method: str, refusal: EdgeRefusal, provenance: Provenance) -> Result:
    """Return the refusal of all quantities of an edge."""
    common = {"method": method, "flags": (refusal.flag,), "region": refusal.where, "provenance": provenance}
    units = {"mtf50": "cy/px", "mtf10": "cy/px", "edge_angle": "deg"}
    return Result(
        measurements=tuple(make_refusal(name, unit, refusal.reason, **common) for name, unit in units.items())
    )


def _result(outcome: EdgeFitOutput, context: Context) -> Result:
    edge, profile, fitted = outcome.edge, outcome.edge.profile, outcome.fitted

    def common(halves: Array) -> dict:
        """Return what all measurements share, which depends on MTF50."""
        known = halves[np.isfinite(halves)]
        relative_sd = float(np.std(np.log(known))) if known.size else np.inf
        black = {} if profile.black is None else {"black_dn": profile.black}
        settings = {"quick": context.quick, **black, **outcome.settings}
        return {
            "method": outcome.method,
            "flags": tuple(dict.fromkeys(_flags(outcome, halves, relative_sd, context))),
            "notes": (
                *edge.notes,
                *course_notes(edge),
                *_notes(edge, context),
                *nonlinearity_notes(edge, outcome.response, relative_sd, context),
                *outcome.notes,
            ),
            "region": edge.where,
            "orientation_deg": orientation_deg(edge.picture, profile.angle_rad),
            "provenance": Provenance(version=charact.__version__, seed=context.seed, settings=settings),
        }

    numbers, curve, halves, shared = mtf_measurements(
        outcome.mtf, common, posterior=outcome.posterior, doubt=outcome.doubt, finish=_finish
    )
    assert curve.interval68 is not None and curve.interval95 is not None, "curves of draws have intervals"
    wide = _with_margin(curve.value, curve.interval68, curve.interval95, ACCURACY.modulus_margin)
    facts = Facts(
        edge=edge,
        half=float(np.nanmedian(halves)) if np.isfinite(halves).any() else np.nan,
        response=outcome.response,
        misfit=float(np.abs(profile.value - fitted.model).max()) / max(abs(profile.step), 1e-300),
    )
    measurements = [*numbers, edge_angle(edge, profile.grain.covariance_over_variance, {**shared, "notes": ()})]
    return Result(
        measurements=tuple(one.with_(findings=findings_of(one.flags, facts)) for one in measurements),
        curves={"mtf": replace(curve, interval95=wide)},
        evidence={"edge-spread": figure_data(edge, fitted)},
    )


def _flags(outcome: EdgeFitOutput, halves: Array, relative_sd: float, context: Context) -> Iterator[str]:
    """Yield the flags of frame, edge, fit, noise and posterior."""
    edge = outcome.edge
    half = float(np.nanmedian(halves)) if np.isfinite(halves).any() else np.nan
    yield from edge_flags(edge, half, context, lambda moved: moved.mtf_loss(half) > LIMITS.max_motion_sd * relative_sd)
    yield from fit_flags(edge.picture, edge.profile, outcome.fitted, half if half > 0 else 0.01)
    yield from response_flags(outcome.response, contrast(edge.profile), relative_sd)
    # Modes count where a quantity has them; a described camera's priors are meant to bound.
    known = {"several-modes", *(() if context.sensor is None else ("prior-bound",))}
    yield from (flag for flag in outcome.posterior.flags if flag not in known)
    yield from outcome.flags


def _finish(found: Measurement, draws: Array) -> Measurement:
    """Return a measurement with the margin of its 95 % interval, and flags of several modes or unreliable tails.

    A frequency is the most probable one under draws that are normal in ln f, the median times exp(-s^2), within the
    68 % interval: errors of a frequency reach further up than down.
    """
    several = has_several_peaks(draws[:, None])
    flags = (*found.flags, "several-modes") if several else found.flags
    if found.value is None or found.interval68 is None:
        return found
    is_frequency = found.quantity != "mtf"
    margin = ACCURACY.frequency_margin if is_frequency else ACCURACY.modulus_margin
    intervals = np.asarray(found.interval68), np.asarray(found.interval95)
    low95, high95 = _with_margin(np.asarray(found.value), *intervals, margin)
    value, (low, high) = found.value, found.interval68
    if is_frequency:
        deviation = 0.5 * np.log(high / max(low, 1e-6)) / 0.994458
        if not high - low < 2.0 * THRESHOLDS.max_relative_sd * value:
            flags = (*flags, "low-signal")
        value = float(max(value * np.exp(-(deviation**2)), low))
    return replace(found, value=value, interval95=(float(low95), float(high95))).with_(flags=flags)


def _with_margin(value: Array, interval68: Array, interval95: Array, more: tuple[float, float]) -> Array:
    """Return a wider 95 % interval about a value that cannot be negative, shape (2, ...)."""
    unsure = np.minimum(0.5 * (interval68[1] - interval68[0]) / np.maximum(value, 1e-12), THRESHOLDS.max_relative_sd)
    margin = np.stack([ACCURACY.interval_margin + one * unsure for one in more])
    return np.maximum(value + margin * (interval95 - value), 0.0)


def edge_angle(edge: PreparedEdge, correlation_sum: float, common: dict) -> Measurement:
    """Return the tilt of the edge to the grid axis nearest to it, deg, from the scatter of its rows."""
    rows = np.flatnonzero(np.isfinite(edge.rows.offset))
    spread = edge.rows.offset_sd * np.sqrt(max(correlation_sum, 1.0))
    error = spread / np.sqrt(max(float(np.sum((rows - rows.mean()) ** 2)), 1.0)) if rows.size > 2 else 45.0
    error = float(np.rad2deg(error / edge.picture.pitch_ratio))
    return measurement_from_sd("edge_angle", "deg", abs(float(np.rad2deg(edge.profile.angle_rad))), error, **common)


def _notes(edge: PreparedEdge, context: Context) -> Iterator[str]:
    """Yield notes that are no reason for distrust."""
    profile = edge.profile
    yield from edge.used.notes
    grain = profile.grain.covariance_over_variance
    if grain > 1.3 or grain < 0.8:
        yield f"Noise is correlated between pixels (sum of correlations {grain:.1f}) and treated as such."
    if context.sensor is None and context.pitch_ratio == 1.0:
        yield "Pixels taken as square."
    if profile.shading_sd > 0:
        yield f"The plateaus undulate by {profile.shading_sd:.2g} DN, which widens the intervals."


def window_normalisation_note(profile: EdgeProfile) -> str:
    """Return the note on a frame too small to show a halo."""
    half = profile.gathered.half_width_px
    return f"Normalised to the light within {half:.0f} px of the edge; a wider halo would not be seen."


def figure_data(edge: PreparedEdge, fitted: FittedProfile | None = None) -> dict:
    """Return the profile and, if it was fitted, model and residuals, as numbers for a figure."""
    profile = edge.profile
    shown = {
        "figure": "edge-spread",
        "distance_px": profile.distance.tolist(),
        "value_dn": profile.value.tolist(),
        "sd_dn": np.sqrt(np.diag(profile.covariance)).tolist(),
        "step_dn": profile.step if fitted is None else float(fitted.amplitude[0]),
    }
    if fitted is None:
        return shown
    return {
        **shown,
        "model_dn": fitted.model.tolist(),
        "residual_dn": (profile.value - fitted.model).tolist(),
        "chi_squared": fitted.chi2,
        "degrees_of_freedom": fitted.free,
        "orientation_deg": orientation_deg(edge.picture, profile.angle_rad),
    }
