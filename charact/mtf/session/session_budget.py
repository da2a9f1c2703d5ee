"""MTF budget of a session from its curves along rows and columns, for the report and as notes.

The curves are those of the joint fit, or of a point source if the session has one target. The noise of flats adds the
post-gain MTF.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.mtf.curve import REPORTED, quantiles
from charact.mtf.session.constraints import FREQUENCIES, ConstraintSource, sources
from charact.mtf.session.mtf_budget import CurvesWithCovariance, MeasuredCurve, MtfBudget, fit_mtf_budget
from charact.mtf.session.stage_transfers import AFTER_GAIN, Direction
from charact.mtf.session.thresholds import THRESHOLDS
from labdata.measurement import Curve, Measurement, Result

Array = NDArray[np.float64]

EVIDENCE = "stage budget"
# Frequencies at which the stages are shown, cycles per column pitch in both directions.
SHOWN = np.maximum(REPORTED, 1e-6)
DIRECTIONS: tuple[Direction, ...] = ("horizontal", "vertical")
AFTER = ("mtf_post_gain", "mtf_post_gain_vertical")


@dataclass(frozen=True, kw_only=True)
class SystemCurves:
    """Curves of the whole camera along rows and columns, and the measurements that vouch for them.

    Parameters
    ----------
    curves
        Along rows and along columns, drawn together, frequencies in cycles per column pitch.
    supporting_measurements
        Measurements of MTF50 that the curves belong to.
    halo
        Whether the curves are normalised to all light, that of the halo included.
    """

    curves: tuple[Curve, Curve]
    supporting_measurements: tuple[Measurement, ...]
    halo: bool


def add_mtf_budget(result: Result, kinds: Mapping[str, str], *, context: Context) -> Result:
    """Return the result of a session with its stage budget, as evidence and as notes on the MTF50 that it explains.

    Parameters
    ----------
    result
        All measurements and curves of one session, those of the joint fit among them.
    kinds
        Kind of each stack ("edge", "bars", "point") by its label.
    context
        The camera, seed and speed.

    Returns
    -------
    Result
        The same where the camera is not described as an intensifier, or no sound curves along both rows and columns
        are drawn.

    Notes
    -----
    Curves along rows and columns come of the same draws and are taken together, so that what they share counts once.
    To their covariance that of forms is added, FORM_SD^2 exp(-|f - f'|/0.08) along each direction: a joint MTF of two
    or three parameters is no cascade of stages.
    """
    whole = None if context.sensor is None else system_curves(result, kinds)
    if context.sensor is None or whole is None:
        return result
    after = _after_gain(result)
    measured = [_with_covariance(whole.curves, context)]
    if after is not None:
        measured.append(_with_covariance(after, context, after_gain=True))
    budget = fit_mtf_budget(
        measured, context.sensor, interlaced=context.interlaced, seed=context.seed, quick=context.quick, halo=whole.halo
    )
    sentences = (*_stage_losses(budget, whole, context), *budget.statement)
    return _add_notes(result, whole.supporting_measurements[0], sentences) + Result(
        evidence={EVIDENCE: _figure_data(budget, whole, after, sentences, context)}
    )


def system_curves(result: Result, kinds: Mapping[str, str]) -> SystemCurves | None:
    """Return the joint fit's curves along rows and columns, else a sound point's; None where there are neither."""
    joint = [result.curves.get(name) for name in ("mtf_joint", "mtf_joint_vertical")]
    if None not in joint:
        return _system_curves(joint, result.find("mtf50", method="joint"), result.evidence["joint MTF"]["counts_halo"])
    points = [source for source in sources(result, kinds) if source.kind == "point" and len(source.curves) == 2]
    return _point_curves(points[0], result) if points else None


def _point_curves(source: ConstraintSource, result: Result) -> SystemCurves | None:
    """A point's own curves: of a described camera its method counts the halo."""
    own = [m for m in result.find("mtf50", stack=source.of.stack) if m.region == source.of.region]
    return _system_curves([curve for curve, _ in source.curves], own, halo=True)


def _system_curves(curves: Sequence[Curve | None], vouching: Sequence[Measurement], halo: bool) -> SystemCurves | None:
    across, down = curves
    if across is None or down is None or across.draws is None or down.draws is None:
        return None
    if len(across.draws) != len(down.draws) or not vouching or any(m.value is None for m in vouching):
        return None
    return SystemCurves(curves=(across, down), supporting_measurements=tuple(vouching), halo=halo)


def _after_gain(result: Result) -> tuple[Curve, Curve] | None:
    """The curves of the flats' noise where both are sound, vertical ones in cycles per row pitch as they come."""
    found = result.find("post_gain_mtf50")
    across, down = (result.curves.get(name) for name in AFTER)
    if not found or any(m.status != "ok" for m in found) or across is None or down is None:
        return None
    drawn = across.draws is not None and down.draws is not None and len(across.draws) == len(down.draws)
    return (across, down) if drawn else None


def _with_covariance(
    curves: tuple[Curve, Curve], context: Context, *, after_gain: bool = False
) -> CurvesWithCovariance:
    """Return curves along rows and columns with the errors that their draws share."""
    parts, drawn = [], []
    for curve, direction in zip(curves, DIRECTIONS, strict=True):
        assert curve.draws is not None
        per_pitch = _per_pitch(direction, context)
        # Curves of the whole camera count column pitches in both directions, those after the gain each its own.
        own = FREQUENCIES * per_pitch if after_gain else FREQUENCIES
        used = (own <= curve.frequency_cy_per_px[-1]) & (
            np.interp(own, curve.frequency_cy_per_px, curve.value) > THRESHOLDS.min_mtf
        )
        drawn.append(_at(own[used], curve))
        parts.append(MeasuredCurve.of_draws(direction, FREQUENCIES[used] * per_pitch, drawn[-1], after_gain=after_gain))
    covariance = np.cov(np.concatenate(drawn, axis=1).T)
    first = len(parts[0].value)
    for part, own in zip(parts, (slice(None, first), slice(first, None)), strict=True):
        apart = np.abs(part.frequency_cy_per_px[:, None] - part.frequency_cy_per_px)
        covariance[own, own] += THRESHOLDS.cascade_sd**2 * np.exp(-apart / THRESHOLDS.cascade_correlation_cy_per_px)
    return CurvesWithCovariance(curves=tuple(parts), covariance=covariance)


def _per_pitch(direction: Direction, context: Context) -> float:
    """Pitches of the direction's own pixels in which a column pitch is counted: cycles per row pitch are more."""
    return context.pitch_ratio if direction == "vertical" else 1.0


def _at(frequency: Array, curve: Curve) -> Array:
    """Values of a curve's draws at frequencies, shape (draw, frequency)."""
    assert curve.draws is not None
    return np.stack([np.interp(frequency, curve.frequency_cy_per_px, draw) for draw in curve.draws])


def _stage_losses(budget: MtfBudget, whole: SystemCurves, context: Context) -> list[str]:
    """What each stage leaves of the MTF where the whole is one half, along rows and along columns."""
    out = []
    for curve, direction, lines in zip(whole.curves, DIRECTIONS, ("rows", "columns"), strict=True):
        half = float(np.interp(0.5, curve.value[::-1], curve.frequency_cy_per_px[::-1]))
        own = np.array([half * _per_pitch(direction, context)])
        left = {stage: float(np.median(budget.mtf(stage, own, direction))) for stage in budget.stages}
        measured = ", ".join(f"{stage} {value:.2f}" for stage, value in left.items() if value < 0.9995)
        out.append(f"along {lines} at {half:.3f} cycles per column pitch the stages leave {measured}")
    return out


def _add_notes(result: Result, explained: Measurement, sentences: Sequence[str]) -> Result:
    notes = tuple(f"Stages: {sentence}." for sentence in sentences)
    measurements = tuple(m.with_(notes=(*m.notes, *notes)) if m is explained else m for m in result.measurements)
    return Result(measurements=measurements, curves=result.curves, evidence=result.evidence)


def _figure_data(
    budget: MtfBudget,
    whole: SystemCurves,
    after: tuple[Curve, Curve] | None,
    sentences: Sequence[str],
    context: Context,
) -> dict[str, Any]:
    draws = budget.posterior.draws
    misfit = budget.chance < THRESHOLDS.budget_p_value
    return {
        "figure": "stage-budget",
        "status": "suspect" if misfit or budget.posterior.flags else "ok",
        "flags": sorted({*budget.posterior.flags, *(["model-misfit"] if misfit else [])}),
        "chance": budget.chance,
        "the_curves_say": "; ".join(sentences),
        "statement": list(sentences),
        "identified": list(budget.identified),
        "products": [list(group) for group in budget.products],
        "known": list(budget.known),
        "parameters": {
            name: [float(value) for value in quantiles(draws[:, i], (0.5, 0.025, 0.975))]
            for i, name in enumerate(budget.posterior.names)
        },
        **{
            direction: _panel(budget, direction, whole.curves[i], None if after is None else after[i], context)
            for i, direction in enumerate(DIRECTIONS)
        },
    }


def _panel(
    budget: MtfBudget, direction: Direction, curve: Curve, after: Curve | None, context: Context
) -> dict[str, Any]:
    """One direction: stages, their product and the measured curves, with 95 % intervals."""
    assert context.sensor is not None
    own = SHOWN * _per_pitch(direction, context)
    mm = float(context.sensor.ccd.pitch_x_um) * 1e-3 * float(context.sensor.taper.demagnification)
    panel = {
        "frequency_cy_per_column": SHOWN.tolist(),
        "cathode_lp_per_mm": (SHOWN / mm).tolist(),
        "stages": {stage: _band(budget.mtf(stage, own, direction)) for stage in budget.stages},
        "product": _band(budget.product(budget.stages, own, direction)),
        "measured": _band(_at(SHOWN, curve)),
    }
    if after is not None:
        panel["product_after_gain"] = _band(budget.product(AFTER_GAIN, own, direction))
        # Beyond its last frequency a curve holds nothing; null is a gap in what is drawn.
        known = np.where(own <= after.frequency_cy_per_px[-1], 1.0, np.nan)
        panel["measured_after_gain"] = _band(_at(own, after) * known)
    return panel


def _band(draws: Array) -> dict[str, list[float]]:
    """Median and 95 % interval of draws at every frequency."""
    middle, low, high = quantiles(draws, (0.5, 0.025, 0.975))
    return {"value": middle.tolist(), "low95": low.tolist(), "high95": high.tolist()}
