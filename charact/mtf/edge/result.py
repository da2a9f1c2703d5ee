"""What an edge's fit gives away: measurements, curve and evidence, from the draws of its MTF."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import charact
from charact.method import Context
from charact.mtf.curve import FINE, PINNED, REPORTED, crossing_frequency, curve_of, flag_filter_uncertainty
from charact.mtf.edge import checks as edge_checks
from charact.mtf.edge.checks import Facts, sharpening_flags, with_findings
from charact.mtf.edge.nonlinearity import (
    NO_CURVATURE_ESTIMATE,
    CurvatureEstimate,
    contrast,
    growth_of,
    notes_on_undetected_nonlinearity,
    response_flags,
)
from charact.mtf.edge.pixels.line import orientation_deg
from charact.mtf.edge.pixels.prepare_edge import PreparedEdge
from charact.mtf.edge.pixels.profile import EdgeProfile
from charact.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.mtf.mean_frame import OrientedFrame, Region
from charact.mtf.nonlinearity import ln_bayes_factor_nonlinear, noise_flags
from charact.mtf.thresholds import LIMITS
from charact.posterior import has_several_peaks
from labdata.frames import FrameStack
from labdata.measurement import (
    Curve,
    Measurement,
    Posterior,
    Provenance,
    Result,
    make_measurement,
    make_refusal,
    measurement_from_draws,
)

Array = NDArray[np.float64]

# Every so many of the fine frequencies tell between which of them a curve falls to a level.
EVERY = 6
COARSE = np.append(FINE[:-1:EVERY], FINE[-1])


@dataclass(frozen=True, kw_only=True)
class EdgeFitOutput:
    """An edge as a method fitted it.

    Parameters
    ----------
    method
        Name of the method.
    edge
        Where it is and what its pixels say.
    fitted
        The profile that was fitted.
    response
        Curvature of the camera's response that the profile asks for, and its error, dimensionless; None: a method
        without a form, to which a curved response is one more blur.
    posterior
        Draws of the parameters.
    mtf
        From frequencies, cy/px, to drawn MTFs, shape (f,) -> (draw, f).
    settings
        What the result depends on besides seed and version.
    notes
        What a reader may want to know.
    flags
        What the method itself distrusts.
    doubt
        From frequencies, cy/px, to the share of the MTF by which one standard deviation of the camera's description
        moves what the method takes for exact, shape (f,) -> (f,); None: it takes nothing so.
    """

    method: str
    edge: PreparedEdge
    fitted: edge_checks.FittedProfile
    response: CurvatureEstimate | None
    posterior: Posterior
    mtf: Callable[[Array], Array]
    settings: dict
    notes: tuple[str, ...] = ()
    flags: tuple[str, ...] = ()
    doubt: Callable[[Array], Array] | None = None


def edge_result(outcome: EdgeFitOutput, context: Context) -> Result:
    """Return measurements, curve and evidence of a fitted edge."""
    edge = outcome.edge
    # One evaluation serves the pinned frequencies, the curve and where to look for the levels.
    draws = outcome.mtf(np.concatenate([COARSE, PINNED, np.maximum(REPORTED, 1e-6)]))
    coarse, pinned, curve = np.split(draws, [COARSE.size, COARSE.size + len(PINNED)], axis=1)
    halves, tenths = (_crossings(outcome, coarse, level) for level in (0.5, 0.1))
    common = _common(outcome, halves, context)
    measurements = [
        _crossing_frequency("mtf50", 0.5, halves, outcome.posterior, common),
        _crossing_frequency("mtf10", 0.1, tenths, outcome.posterior, common),
        *(_mtf_at(f, pinned[:, index], common) for index, f in enumerate(PINNED)),
        edge_angle(edge, common),
    ]

    def crossing(level: float) -> float:
        return float(np.nanmedian(_crossings(outcome, coarse, level)))

    profile, fitted = edge.profile, outcome.fitted
    facts = Facts(
        edge=edge,
        half=float(np.nanmedian(halves)),
        response=outcome.response,
        misfit=float(np.abs(profile.value - fitted.model).max()) / max(abs(profile.step), 1e-300),
    )
    return Result(
        measurements=tuple(
            with_findings(flag_filter_uncertainty(one, outcome.doubt, crossing), facts) for one in measurements
        ),
        curves={"mtf": _curve(curve)},
        evidence={"edge-spread": _figure_data(edge.picture, edge.profile, outcome.fitted)},
    )


def _common(outcome: EdgeFitOutput, halves: Array, context: Context) -> dict[str, Any]:
    """Return what all measurements of an edge share."""
    edge, profile = outcome.edge, outcome.edge.profile
    black = {} if profile.black is None else {"black_dn": profile.black}
    provenance = Provenance(
        version=charact.__version__, seed=context.seed, settings={"quick": context.quick, **black, **outcome.settings}
    )
    return {
        "method": outcome.method,
        "flags": tuple(dict.fromkeys(_flags(outcome, halves, context))),
        "notes": (
            *edge.notes,
            *edge_checks.course_notes(edge.roughness),
            *_notes(profile, edge.used, context),
            *_response_notes(outcome, halves, context),
            *outcome.notes,
        ),
        "region": edge.where,
        "orientation_deg": orientation_deg(edge.picture, profile.angle_rad),
        "provenance": provenance,
    }


def _flags(outcome: EdgeFitOutput, halves: Array, context: Context) -> Iterator[str]:
    """Yield what picture, course, fit, noise and posterior of an edge give to distrust."""
    edge, used, half = outcome.edge, outcome.edge.used, float(np.nanmedian(halves))
    yield from edge_checks.picture_flags(used.data, context.full_scale_dn or used.full_scale_dn)
    yield from edge_checks.line_flags(edge.picture, edge.rows, edge.profile)
    yield from edge_checks.fit_flags(edge.picture, edge.profile, outcome.fitted, half if half > 0 else 0.01)
    if outcome.response:
        yield from response_flags(outcome.response, contrast(edge.profile), _relative_sd(halves))
    yield from noise_flags(growth_of(edge))
    yield from _posterior_flags(outcome.posterior, context)
    yield from outcome.flags
    yield from edge.flags
    yield from sharpening_flags(edge, half)
    untold = LIMITS.max_motion_sd * _relative_sd(halves)
    yield from edge.blur_flags(lambda moved: moved.mtf_loss(half) > untold)


def _relative_sd(halves: Array) -> float:
    known = halves[np.isfinite(halves)]
    return float(np.std(np.log(known))) if known.size else np.inf


def _curve(draws: Array) -> Curve:
    """Return the reported curve, its 95 % interval with its margin."""
    curve = curve_of(REPORTED, draws)
    assert curve.interval68 is not None and curve.interval95 is not None, "curves of draws have intervals"
    return replace(
        curve, interval95=_with_margin(curve.value, curve.interval68, curve.interval95, ACCURACY.modulus_margin)
    )


def _measurement_of(quantity: str, unit: str, draws: Array, more: tuple[float, float], **fields: Any) -> Measurement:
    """Return a measurement from draws, its 95 % interval with its margin."""
    found = measurement_from_draws(quantity, unit, draws, **fields)
    low, high = _with_margin(np.asarray(found.value), np.asarray(found.interval68), np.asarray(found.interval95), more)
    return found.with_(interval95=(float(low), float(high)))


def _with_margin(value: Array, interval68: Array, interval95: Array, more: tuple[float, float]) -> Array:
    """Return a wider 95 % interval about a value that cannot be negative, shape (2, ...)."""
    unsure = np.minimum(0.5 * (interval68[1] - interval68[0]) / np.maximum(value, 1e-12), THRESHOLDS.max_relative_sd)
    margin = np.stack([ACCURACY.interval_margin + one * unsure for one in more])
    return np.maximum(value + margin * (interval95 - value), 0.0)


def _crossings(outcome: EdgeFitOutput, coarse: Array, level: float) -> Array:
    """Return where each draw falls to a level, NaN where it never does: looked for finely where the coarse ones do."""
    below = coarse < level
    falls = below.any(axis=1)
    first = np.argmax(below[falls], axis=1)
    if not first.size:
        return np.full(len(coarse), np.nan)
    near = FINE[max(first.min() - 1, 0) * EVERY : first.max() * EVERY + 1]
    draws = crossing_frequency(near, outcome.mtf(near), level)
    return np.where(falls, draws, np.nan)


def _crossing_frequency(quantity: str, level: float, draws: Array, posterior: Posterior, common: dict) -> Measurement:
    """Return the frequency at which the MTF falls to a level; refused where it does not below 1.5 cy/px."""
    lost = float(np.mean(~np.isfinite(draws)))
    if lost > 0.02:
        reason = (
            f"the MTF must fall to {level:g} below {FINE[-1]:.1f} cy/px, and {100 * lost:.0f} % of its draws do not"
        )
        return make_refusal(quantity, "cy/px", reason, **common)
    kept = draws[np.isfinite(draws)]
    found = _measurement_of(
        quantity, "cy/px", kept, ACCURACY.frequency_margin, posterior=posterior, **_with_peaks(common, kept)
    )
    sure = found if _has_known_tails(found) else found.with_(flags=("low-signal",))
    return sure.with_(value=_mode_of(found))


def _mode_of(found: Measurement) -> float:
    """Return the most probable frequency, within the 68 % interval: under draws normal in ln f, median exp(-s^2).

    A thousandth below the median where f is known to s = 3 %, a hundredth at 10 %: errors of a frequency reach further
    up than down, and the median's are not the least. At a step of one standard deviation they are 1.34 times the
    bound of Cramer and Rao, and these 1.20 times.
    """
    assert found.value is not None and found.interval68 is not None, "draws give a value and intervals"
    low, high = found.interval68
    deviation = 0.5 * np.log(high / max(low, 1e-6)) / 0.994458
    return float(max(found.value * np.exp(-(deviation**2)), low))


def _mtf_at(frequency: float, draws: Array, common: dict) -> Measurement:
    """Return the MTF at one frequency."""
    common = _with_peaks(common, draws)
    return _measurement_of("mtf", "1", draws, ACCURACY.modulus_margin, frequency_cy_per_px=float(frequency), **common)


def _posterior_flags(posterior: Posterior, context: Context) -> tuple[str, ...]:
    """Return what of the posterior's distrust reaches what is measured: peaks count where the quantity has them."""
    known = {"several-modes", *(() if context.sensor is None else ("prior-bound",))}
    return tuple(flag for flag in posterior.flags if flag not in known)


def _with_peaks(common: dict, draws: Array) -> dict:
    """Return what measurements share, flagged where the draws of this one have several peaks."""
    if not has_several_peaks(draws[:, None]):
        return common
    return {**common, "flags": (*common["flags"], "several-modes")}


def _has_known_tails(found: Measurement) -> bool:
    """Tell whether the 68 % interval of a measurement is narrow enough for its tails to be known."""
    assert found.value is not None and found.interval68 is not None, "draws give a value and intervals"
    low, high = found.interval68
    return high - low < 2.0 * THRESHOLDS.max_relative_sd * found.value


def edge_angle(edge: PreparedEdge, common: dict) -> Measurement:
    """Return the tilt of the edge to the grid axis nearest to it, degrees, from the scatter of its rows."""
    rows = np.flatnonzero(np.isfinite(edge.rows.offset))
    spread = edge.rows.offset_sd * np.sqrt(max(edge.profile.grain.covariance_over_variance, 1.0))
    error = spread / np.sqrt(max(float(np.sum((rows - rows.mean()) ** 2)), 1.0)) if rows.size > 2 else 45.0
    error = float(np.rad2deg(error / edge.picture.pitch_ratio))
    value = abs(float(np.rad2deg(edge.profile.angle_rad)))
    halves = [(value - k * error, value + k * error) for k in (0.994458, 1.959964)]
    return make_measurement("edge_angle", "deg", value, *halves, **{**common, "notes": ()})


def _notes(profile: EdgeProfile, used: FrameStack, context: Context) -> tuple[str, ...]:
    """Return what a reader may want to know and what lowers no trust."""
    grain, notes = profile.grain.covariance_over_variance, list(used.notes)
    if grain > 1.3 or grain < 0.8:
        notes.append(f"Noise is correlated between pixels (sum of correlations {grain:.1f}) and treated as such.")
    if context.sensor is None and context.pitch_ratio == 1.0:
        notes.append("Pixels taken as square.")
    if profile.shading_sd > 0:
        notes.append(f"The plateaus undulate by {profile.shading_sd:.2g} DN, which widens the intervals.")
    return tuple(notes)


def _response_notes(outcome: EdgeFitOutput, halves: Array, context: Context) -> tuple[str, ...]:
    """Return notes on a response that may be curved unseen, beyond what the errors of MTF50 cover.

    A described camera's response, or one under which noise grows as photons' does, is taken to be straight.
    """
    known = halves[np.isfinite(halves)]
    straight = ln_bayes_factor_nonlinear(growth_of(outcome.edge)) < THRESHOLDS.linear_ln_bayes_factor
    if context.sensor is not None or straight or not known.size:
        return ()
    return notes_on_undetected_nonlinearity(
        outcome.response or NO_CURVATURE_ESTIMATE, contrast(outcome.edge.profile), float(np.std(np.log(known)))
    )


def window_normalisation_note(profile: EdgeProfile) -> str:
    """Return the note on a frame too small to show a halo."""
    half = profile.gathered.half_width_px
    return f"Normalised to the light within {half:.0f} px of the edge; a wider halo would not be seen."


def _figure_data(picture: OrientedFrame, profile: EdgeProfile, fitted: edge_checks.FittedProfile) -> dict:
    """Return the profile, the model and what is left, as numbers for a figure."""
    return {
        "figure": "edge-spread",
        "distance_px": profile.distance.tolist(),
        "value_dn": profile.value.tolist(),
        "sd_dn": np.sqrt(np.diag(profile.covariance)).tolist(),
        "model_dn": fitted.model.tolist(),
        "residual_dn": (profile.value - fitted.model).tolist(),
        "step_dn": float(fitted.amplitude[0]),
        "chi_squared": fitted.chi2,
        "degrees_of_freedom": fitted.free,
        "orientation_deg": orientation_deg(picture, profile.angle_rad),
    }


def edge_refusals(method: str, reason: str, where: Region, context: Context) -> Result:
    """Return the refusal of all that an edge gives."""
    flags = ("no-target",) if reason.startswith("no target") else ("window-too-small",)
    provenance = Provenance(version=charact.__version__, seed=context.seed)
    common = {"method": method, "flags": flags, "region": where, "provenance": provenance}
    units = {"mtf50": "cy/px", "mtf10": "cy/px", "edge_angle": "deg"}
    return Result(measurements=tuple(make_refusal(name, unit, reason, **common) for name, unit in units.items()))
