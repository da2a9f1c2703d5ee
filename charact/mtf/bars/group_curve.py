"""One MTF curve through several bar groups of a camera."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

import charact
from charact.method import Context
from charact.method.stopwatch import with_timing
from charact.mtf.bars.group_curve_model import GroupCurveModel
from charact.mtf.curve import REPORTED, crossing_frequency, curve_of
from charact.posterior import find_maximum, importance_sample, sample
from labdata.errors import BadInput
from labdata.measurement import Curve, Measurement, Posterior, Provenance, Result, make_refusal, measurement_from_draws

Array = NDArray[np.float64]

METHOD = "bars-joint"
# The method whose readings are free of harmonics and of phase.
GROUPS_BY = "bars-forward"
# Half of a 68 % interval in standard deviations.
HALF68_SD = 0.994458
# Chance below which the groups do not tell of one member of the family, and directions that have one MTF, degrees.
MISFIT_LEVEL, SAME_DIRECTION_DEG = 0.001, 15.0
# Bars within this of the rows' or columns' direction tell of it, degrees.
NEAR_DEG = 30.0
# Two frequencies nearer than this factor are one, measured twice.
MIN_FREQUENCY_RATIO = 1.1
# Frequencies at which one half is looked for, the share of draws that may not fall to it, and how far beyond the
# groups, as a factor of the frequency, the form is trusted.
FINE, MAX_LOST, TRUSTED_RATIO = np.arange(0.002, 1.2, 0.002), 0.02, 1.5


@dataclass(frozen=True, kw_only=True)
class Group:
    """Measurement of one bar group.

    Parameters
    ----------
    frequency
        Cycles per pixel.
    mtf, sd
        MTF there, pixel included, and its standard uncertainty.
    angle_rad
        Direction across the bars.
    """

    frequency: float
    mtf: float
    sd: float
    angle_rad: float


def group_of(measurement: Measurement) -> Group:
    """Return the group of a measurement of "mtf" at a bar frequency.

    Raises
    ------
    BadInput
        If it has no value, interval or frequency.
    """
    value, interval, frequency = measurement.value, measurement.interval68, measurement.frequency_cy_per_px
    if value is None or interval is None or frequency is None:
        raise BadInput(f"a group of bars must have an MTF with an interval at a frequency, got {measurement.status}")
    return Group(
        frequency=frequency,
        mtf=value,
        sd=(interval[1] - interval[0]) / (2.0 * HALF68_SD),
        angle_rad=float(np.deg2rad(measurement.orientation_deg or 0.0)),
    )


def frame_curves(result: Result, *, context: Context) -> Result:
    """Return MTF50 and curves through the bar groups of one frame; empty if there are too few.

    Parameters
    ----------
    result
        Measurements of "mtf" by "bars-forward".
    context
        Seed, speed and camera.

    Returns
    -------
    Result
        For rows and for columns, if groups of at least two frequencies exist: `mtf50`, the curve "mtf" (rows) or
        "mtf_vertical" (columns), in cycles per column pitch, and their figure data.
    """
    return _by_direction(result.measurements, ("mtf", "mtf_vertical"), context)


def session_curves(result: Result, kinds: Mapping[str, str], *, context: Context) -> Result:
    """Return MTF50 and curves through the bar targets of a session; empty if there are too few.

    Parameters
    ----------
    result
        Measurements of one session.
    kinds
        Kind of each stack ("edge", "bars", "point") by its label.
    context
        Seed, speed and camera.

    Returns
    -------
    Result
        As for one frame, without a stack; the curves are named "mtf_bars" and "mtf_bars_vertical", to be distinct from
        those of single targets.
    """
    own = [m for m in result.measurements if kinds.get(m.stack or "") == "bars"]
    return _by_direction(own, ("mtf_bars", "mtf_bars_vertical"), context)


def _by_direction(measurements: Sequence[Measurement], names: tuple[str, str], context: Context) -> Result:
    """Return one curve along rows and one along columns, each where groups of two frequencies exist."""
    out = Result()
    for (way, own), name in zip(_directions(measurements).items(), names, strict=True):
        frequencies = [m.frequency_cy_per_px for m in own if m.frequency_cy_per_px]
        if not frequencies or max(frequencies) < MIN_FREQUENCY_RATIO * min(frequencies):
            continue
        found = fit_group_curve(own, context=context)
        out += Result(
            measurements=found.measurements,
            curves={name: found.curves["mtf"]},
            evidence={f"bar groups, {way}": found.evidence["bar groups"]},
        )
    return out


def _directions(measurements: Sequence[Measurement]) -> dict[str, list[Measurement]]:
    """Return the valid groups near the rows' and near the columns' direction."""
    sound = [
        m for m in measurements if m.quantity == "mtf" and m.method == GROUPS_BY and m.status == "ok" and m.interval68
    ]
    return {way: _parallel_groups(sound, axis_deg) for way, axis_deg in (("rows", 0.0), ("columns", 90.0))}


def _parallel_groups(sound: Sequence[Measurement], axis_deg: float) -> list[Measurement]:
    """Return the largest set of groups near an axis within half the permitted angle of one of them."""
    near = [m for m in sound if _angle_between_deg(m.orientation_deg, axis_deg) < NEAR_DEG]
    sets = [
        [m for m in near if _angle_between_deg(m.orientation_deg, middle.orientation_deg) <= 0.5 * SAME_DIRECTION_DEG]
        for middle in near
    ]
    return max(sets, key=len, default=[])


def _angle_between_deg(one_deg: float | None, other_deg: float | None) -> float:
    """Angle between two directions, 0 to 90 degrees."""
    apart = abs((one_deg or 0.0) - (other_deg or 0.0)) % 180.0
    return min(apart, 180.0 - apart)


@with_timing
def fit_group_curve(measurements: Sequence[Measurement], *, context: Context) -> Result:
    """Fit one curve, c^((f/f2)^n) times the known transfer, to several bar groups of one direction.

    Parameters
    ----------
    measurements
        Of "mtf" by "bars-forward"; those without a value or not ok are excluded.
    context
        Seed, speed and camera.

    Returns
    -------
    Result
        `mtf50`, the curve "mtf" and figure data of the groups; refused with fewer than two groups, or where MTF50 lies
        far from all of them.

    Raises
    ------
    BadInput
        If the groups have different directions.

    Notes
    -----
    The likelihood is normal in each group's MTF. With more groups than parameters, `model-misfit` is set where chi
    squared has a p-value under 0.001.
    """
    groups = [group_of(one) for one in measurements if one.status == "ok" and one.value is not None]
    provenance = Provenance(
        version=charact.__version__, seed=context.seed, settings={"quick": context.quick, "groups": len(groups)}
    )
    common: dict[str, Any] = {"method": METHOD, "provenance": provenance}
    if len({group.frequency for group in groups}) < 2:
        reason = f"too few groups: a curve needs bars of two frequencies measured ok, got {len(groups)}"
        return Result(measurements=(make_refusal("mtf50", "cy/px", reason, flags=("low-signal",), **common),))
    _require_one_direction(groups)
    # Directions half a turn apart are equal: average the doubled angles.
    turned = np.sum(np.exp(2j * np.array([group.angle_rad for group in groups])))
    form = GroupCurveModel.of(context, angle_rad=0.5 * float(np.angle(turned)))
    posterior, left = _posterior(groups, form, context)
    curves = form.mtf(posterior.draws, REPORTED)
    curves[:, 0] = 1.0
    common |= {
        "flags": (*(flag for flag in posterior.flags if flag != "prior-bound"), *_misfit(left, len(groups) - 2)),
        "orientation_deg": float(np.rad2deg(form.angle_rad)) % 180.0,
        "posterior": posterior,
    }
    mtf50 = _mtf50(form.mtf(posterior.draws, FINE), groups, common)
    curve = curve_of(REPORTED, curves)
    return Result(
        measurements=(mtf50,),
        curves={"mtf": curve},
        evidence={"bar groups": _figure_data(groups, curve)},
    )


def _mtf50(curves: Array, groups: Sequence[Group], common: dict[str, Any]) -> Measurement:
    """Return MTF50 of drawn curves; refused where no group is near it."""
    crossing = crossing_frequency(FINE, curves, 0.5)
    told = sorted({group.frequency for group in groups})
    notes = [f"Through {len(groups)} groups of bars at {', '.join(f'{frequency:.3g}' for frequency in told)} cy/px."]
    half = float(np.median(np.where(np.isfinite(crossing), crossing, FINE[-1])))
    if not told[0] / TRUSTED_RATIO < half < told[-1] * TRUSTED_RATIO or np.mean(~np.isfinite(crossing)) > MAX_LOST:
        reason = (
            f"MTF50 must lie within a factor of {TRUSTED_RATIO:g} of the groups' frequencies, {told[0]:.3g} to {told[-1]:.3g} "
            f"cy/px, got some {half:.2g}"
        )
        return make_refusal("mtf50", "cy/px", reason, notes=tuple(notes), **common)
    if not told[0] <= half <= told[-1]:
        notes.append("MTF50 lies beyond the groups: the form, exp(-(f/fc)^n) times what is known, reaches to it.")
    return measurement_from_draws("mtf50", "cy/px", crossing[np.isfinite(crossing)], notes=tuple(notes), **common)


def _misfit(left: float, freedom: int) -> list[str]:
    return ["model-misfit"] if freedom > 0 and chdtrc(freedom, left) < MISFIT_LEVEL else []


def _require_one_direction(groups: Sequence[Group]) -> None:
    """Reject groups of different directions, whose MTFs may differ."""
    apart = [abs(np.rad2deg(group.angle_rad - groups[0].angle_rad)) % 180.0 for group in groups]
    largest = max(min(one, 180.0 - one) for one in apart)
    if largest > SAME_DIRECTION_DEG:
        raise BadInput(
            f"groups of bars for one curve must lie within {SAME_DIRECTION_DEG:g} degrees, got {largest:.0f} apart"
        )


def _posterior(groups: Sequence[Group], form: GroupCurveModel, context: Context) -> tuple[Posterior, float]:
    """Return draws of the parameters, and chi squared at the optimum."""
    frequency, mtf, sd = np.array([(group.frequency, group.mtf, group.sd) for group in groups]).T

    def squares(theta: Array) -> Array:
        return np.sum(((mtf - form.mtf(theta, frequency)) / sd) ** 2, axis=1)

    def log_probability(theta: Array) -> Array:
        inside = np.all((theta > form.bounds[:, 0]) & (theta < form.bounds[:, 1]), axis=1)
        safe = np.clip(theta, form.bounds[:, 0], form.bounds[:, 1])
        return np.where(inside, form.log_prior(safe) - 0.5 * squares(safe), -np.inf)

    asked = {"names": form.names, "units": form.units, "seed": context.seed, "bounds": form.bounds}
    start = form.grid[int(np.argmax(log_probability(form.grid)))]
    best, covariance = find_maximum(log_probability, start, form.bounds)
    # Half frequency and exponent have a curved ridge, which a Gaussian approximation misses.
    drawn = (importance_sample if context.quick else sample)(
        log_probability, start=best, covariance=covariance, **asked
    )
    return drawn, float(squares(best[None])[0])


def _figure_data(groups: Sequence[Group], curve: Curve) -> dict[str, Any]:
    low, high = curve.interval95 if curve.interval95 is not None else (curve.value, curve.value)
    return {
        "figure": "bar-groups",
        "frequency_cy_per_px": [group.frequency for group in groups],
        "mtf": [group.mtf for group in groups],
        "sd": [group.sd for group in groups],
        "curve_cy_per_px": curve.frequency_cy_per_px.tolist(),
        "curve": curve.value.tolist(),
        "curve_low95": low.tolist(),
        "curve_high95": high.tolist(),
    }
