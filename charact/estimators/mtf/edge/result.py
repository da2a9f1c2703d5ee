"""Result of an edge: measurements, curve and evidence; of a fitted one from the draws of its
MTF.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np

import charact
from charact.estimators.mtf.curve import FINE, mtf_measurements, stretched, widen_by
from charact.estimators.mtf.edge.checks import (
    EdgeFinding,
    FittedProfile,
    edge_findings,
    fit_findings,
    plain,
)
from charact.estimators.mtf.edge.nonlinearity import CurvatureEstimate, response_bias
from charact.estimators.mtf.edge.pixels.prepare_edge import EdgeRefusal, PreparedEdge, prepare_edge
from charact.estimators.mtf.edge.pixels.profile import EdgeProfile
from charact.estimators.mtf.edge.pixels.rim import Rim
from charact.estimators.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.estimators.mtf.mean_frame import Region
from charact.estimators.mtf.thresholds import LIMITS
from charact.inference import has_several_peaks
from charact.method import Context
from charact.verdict import judge
from labdata import (
    Array,
    Curve,
    FrameStack,
    Measurement,
    Posterior,
    Provenance,
    Result,
    has_tube,
    make_refusal,
    measurement_from_sd,
)

EdgeFitFunction = Callable[[PreparedEdge, Context], Result]


def measure_by_fit(
    method: str,
    fit: EdgeFitFunction,
    stack: FrameStack,
    region: Region | None,
    context: Context,
    *,
    quickly: bool = False,
) -> Result:
    """Find the edge of a region and return what its fit makes of it, or the refusal.

    Parameters
    ----------
    quickly
        Whether wider bins serve where noise hides what narrow ones would show.
    """
    edge = prepare_edge(stack, region, context, quickly=quickly, fields_apart=True, closed=True)
    if isinstance(edge, EdgeRefusal):
        return refuse_edge(method, edge, context.seed)
    return fit(edge, context)


def refuse_edge(
    method: str, refusal: EdgeRefusal, seed: int | None, settings: dict | None = None
) -> Result:
    """Return the refusal of all quantities of an edge; methods without draws have no seed."""
    provenance = Provenance(version=charact.__version__, seed=seed, settings=settings or {})
    common = {
        "method": method,
        "flags": (refusal.flag,),
        "region": refusal.where,
        "provenance": provenance,
    }
    units = {"mtf50": "cy/px", "mtf10": "cy/px", "edge_angle": "deg"}
    return Result(
        measurements=tuple(
            make_refusal(name, unit, refusal.reason, **common) for name, unit in units.items()
        )
    )


def edge_result_of_fit(
    method: str,
    edge: PreparedEdge,
    fitted: FittedProfile,
    response: CurvatureEstimate,
    posterior: Posterior,
    mtf: Callable[[Array], Array],
    context: Context,
    *,
    settings: dict,
    notes: tuple[str, ...] = (),
    findings: Iterable[EdgeFinding] = (),
    doubt: Callable[[Array], Array] | None = None,
) -> Result:
    """Return measurements, curve and evidence of a fitted edge.

    Parameters
    ----------
    edge, fitted
        The edge with its profile, and the profile as fitted.
    response
        Curvature of the camera response that the profile requires, with its standard uncertainty.
    posterior
        Draws of the parameters.
    mtf
        From frequencies, cy/px, to drawn MTFs, shape (f,) -> (draw, f).
    settings
        What the result depends on besides seed and version.
    notes, findings
        The method's own.
    doubt
        Relative standard uncertainty of the MTF by what the method takes as exactly known, shape
        (f,) -> (f,); None: nothing.
    """
    profile = edge.profile
    black = {} if profile.black is None else {"black_dn": profile.black}
    provenance = Provenance(
        version=charact.__version__,
        seed=context.seed,
        settings={"quick": context.quick, **black, **settings},
    )
    shared = shared_fields(method, edge, (*_notes(edge, context), *notes), provenance)
    numbers, curve, halves = mtf_measurements(
        mtf, shared, posterior=posterior, doubt=doubt, finish=_finish
    )
    known = halves[np.isfinite(halves)]
    half = float(np.median(known)) if known.size else np.nan
    relative_sd = float(np.std(np.log(known))) if known.size else np.inf
    response_findings = [
        EdgeFinding(flag="gamma", effect=shown, undo=stretched(-bias))
        for shown, bias in filter(None, [response_bias(edge, response, context)])
    ]
    # Modes count where a quantity has them; a described camera's priors are meant to bound.
    harmless = {"several-modes", *(("prior-bound",) if has_tube(context.camera) else ())}
    all_findings = [
        *edge_findings(edge, half, context, relative_sd, LIMITS.max_motion_sd * relative_sd),
        *fit_findings(edge.picture, profile, fitted, half if half > 0 else 0.01),
        *response_findings,
        *map(plain, sorted(set(posterior.flags) - harmless)),
        *findings,
    ]
    assert curve.interval68 is not None and curve.interval95 is not None, (
        "curves of draws have intervals"
    )
    interval95 = _with_margin(
        curve.value, curve.interval68, curve.interval95, ACCURACY.modulus_margin
    )
    curve = replace(curve, interval95=interval95)
    return edge_result(edge, numbers, curve, shared, all_findings, fitted=fitted)


def shared_fields(
    method: str, edge: PreparedEdge, notes: Iterable[str], provenance: Provenance
) -> dict:
    """Return what all measurements of an edge share."""
    tilt = float(np.rad2deg(edge.profile.angle_rad))
    # Upright, the normal stands at -tilt to the columns; mirrored it is turned over, transposed
    # exchanged.
    tilt = tilt if edge.picture.mirrored else -tilt
    return {
        "method": method,
        "notes": (*edge.notes, *notes),
        "region": edge.where,
        # Direction of the edge's normal from the row direction, in [0, 180).
        "orientation_deg": None
        if isinstance(edge.rows.line, Rim)
        else (90.0 - tilt if edge.picture.transposed else tilt) % 180.0,
        "provenance": provenance,
    }


def edge_result(
    edge: PreparedEdge,
    numbers: list[Measurement],
    curve: Curve,
    shared: dict,
    findings: Iterable[EdgeFinding],
    *,
    fitted: FittedProfile | None = None,
) -> Result:
    """Return judged measurements, the edge's tilt among them, the curve and the profile."""
    profile, findings = edge.profile, tuple(dict.fromkeys(findings))
    rows, spread = np.flatnonzero(np.isfinite(edge.rows.offset)), edge.rows.offset_sd
    if fitted is not None:
        spread *= np.sqrt(max(profile.correlated_noise.correlation_factor, 1.0))
    error = (
        spread / np.sqrt(max(float(np.sum((rows - rows.mean()) ** 2)), 1.0))
        if rows.size > 2
        else 45.0
    )
    error = float(np.rad2deg(error / edge.picture.pitch_ratio))
    angle = measurement_from_sd(
        "edge_angle", "deg", abs(float(np.rad2deg(profile.angle_rad))), error, **shared
    )
    shown = {
        "figure": "edge-spread",
        "distance_px": profile.distance.tolist(),
        "value_dn": profile.value.tolist(),
        "sd_dn": np.sqrt(np.diag(profile.covariance)).tolist(),
        "step_dn": profile.step if fitted is None else float(fitted.amplitude[0]),
    }
    if fitted is not None:
        angle = angle.with_(notes=())
        residual = profile.value - fitted.model
        shown |= {
            "model_dn": fitted.model.tolist(),
            "residual_dn": residual.tolist(),
            "chi_squared": fitted.chi2,
            "degrees_of_freedom": fitted.free,
            "orientation_deg": shared["orientation_deg"],
        }
    measurements = (*numbers, *([] if isinstance(edge.rows.line, Rim) else [angle]))
    if findings:
        modulus = _modulus_at_fine(curve)
        measurements = tuple(
            judge(
                m,
                [
                    finding.finding_of(m, modulus)
                    for finding in findings
                    # What has a bound concerns the MTF, not the tilt.
                    if m is not angle or finding.undo is None
                ],
            )
            for m in measurements
        )
        curve = widen_by(findings, curve, FINE, modulus)
    return Result(measurements=measurements, curves={"mtf": curve}, evidence={"edge-spread": shown})


def _modulus_at_fine(curve: Curve) -> Array:
    """Return a curve at `FINE`, beyond its end as a power of the frequency."""
    frequency, value = curve.frequency_cy_per_px, np.maximum(curve.value, 1e-6)
    before = int(np.searchsorted(frequency, 0.8 * frequency[-1]))
    power = min(np.log(value[-1] / value[before]) / np.log(frequency[-1] / frequency[before]), 0.0)
    beyond = np.maximum(FINE / frequency[-1], 1.0) ** power
    return np.interp(FINE, frequency, value) * beyond


def _finish(measurement: Measurement, draws: Array) -> Measurement:
    """Return a measurement with the margin of its 95 % interval, and flags of several modes or
    unreliable tails.

    A frequency is the most probable one under draws that are normal in ln f, the median times
    exp(-s^2), within the 68 % interval: errors of a frequency reach further up than down.
    """
    findings = [plain("several-modes")] if has_several_peaks(draws[:, None]) else []
    if measurement.value is None or measurement.interval68 is None:
        return measurement
    is_frequency = measurement.quantity != "mtf"
    margin = ACCURACY.frequency_margin if is_frequency else ACCURACY.modulus_margin
    intervals = np.asarray(measurement.interval68), np.asarray(measurement.interval95)
    low95, high95 = _with_margin(np.asarray(measurement.value), *intervals, margin)
    value, (low, high) = measurement.value, measurement.interval68
    if is_frequency:
        deviation = 0.5 * np.log(high / max(low, 1e-6)) / 0.994458
        if not high - low < 2.0 * THRESHOLDS.max_relative_sd * value:
            effect = f"the 68 % interval is {50.0 * (high - low) / value:.0f} % wide to either side"
            findings.append(
                EdgeFinding(flag="low-signal", effect=effect + ": its limits are uncertain")
            )
        value = float(max(value * np.exp(-(deviation**2)), low))
    finished = replace(measurement, value=value, interval95=(float(low95), float(high95)))
    return judge(finished, [finding.finding_of(finished, draws) for finding in findings])


def _with_margin(
    value: Array, interval68: Array, interval95: Array, more: tuple[float, float]
) -> Array:
    """Return a wider 95 % interval about a value that cannot be negative, shape (2, ...)."""
    unsure = np.minimum(
        0.5 * (interval68[1] - interval68[0]) / np.maximum(value, 1e-12), THRESHOLDS.max_relative_sd
    )
    margin = np.stack([ACCURACY.interval_margin + factor * unsure for factor in more])
    return np.maximum(value + margin * (interval95 - value), 0.0)


def _notes(edge: PreparedEdge, context: Context) -> Iterator[str]:
    """Yield notes that are no reason for distrust."""
    profile = edge.profile
    yield from edge.picture.stack.frames.notes
    correlation_sum = profile.correlated_noise.correlation_factor
    if not 0.8 <= correlation_sum <= 1.3:
        yield (
            f"Noise is correlated between pixels (sum of correlations {correlation_sum:.1f}); "
            "accounted for."
        )
    if not has_tube(context.camera) and context.pitch_ratio == 1.0:
        yield "Square pixels assumed."
    if profile.shading_sd > 0:
        yield f"The plateaus undulate by {profile.shading_sd:.2g} DN, which widens the intervals."


def window_normalisation_note(profile: EdgeProfile) -> str:
    """Return the note on a frame too small to show a halo."""
    half = profile.gathered.half_width_px
    return (
        f"Normalised to the light within {half:.0f} px of the edge; a wider halo would not be seen."
    )
