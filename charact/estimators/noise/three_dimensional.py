"""3-D noise (NVESD model) of every dark and flat."""

from typing import Any
from zlib import crc32

import numpy as np

from charact.estimators.noise.findings import (
    Remarks,
    bounded,
    clipping_effects,
    fields_of,
    finding,
    judged,
    rounding_findings,
)
from charact.estimators.noise.thresholds import CHECKS
from charact.frames.components import OWN, TIME, Component
from charact.frames.cube import Cube, FrameMeans
from charact.frames.stack_statistics import StackStatistics
from charact.frames.temporal import level_change
from charact.frames.thresholds import CUBE
from charact.method import Context
from charact.method.stopwatch import Stopwatch
from charact.verdict import Finding
from labdata import Array
from labdata.measurement import Measurement, Result, intervals_of, make_measurement, make_refusal

METHOD = "three-dimensional"
NAMES = (*OWN, "tvh")


def three_dimensional(levels: list[StackStatistics], *, context: Context) -> Result:
    """Return the seven components of 3-D noise of every dark and flat with enough frames.

    `levels`: darks and flats, read with their cubes; interlaced fields are separated and their
    variances averaged. Returns `noise_t` to `noise_tvh` of each stack, DN, quantisation included;
    as figure data the means of frames with their spectrum, of rows and of columns. Seven refusals
    if no stack is long enough.
    """
    fields, result = fields_of(METHOD, context), Result()
    for level in levels:
        if level.cube is not None:
            result += _measure_stack(level, level.cube, context, {**fields, "stack": level.label})
    if result.measurements:
        return result
    longest = max((level.frames for level in levels), default=1)
    reason = (
        f"3-D noise needs a stack of at least {CUBE.min_frames} frames, and {CUBE.min_pixels} "
        f"rows and columns in each field; the longest stack has {longest} "
        f"{'frame' if longest == 1 else 'frames'}"
    )
    return Result(measurements=_refusals(reason, fields))


def _refusals(reason: str, fields: dict[str, Any]) -> tuple[Measurement, ...]:
    return tuple(make_refusal(f"noise_{name}", "DN", reason, **fields) for name in NAMES)


def _measure_stack(
    level: StackStatistics, cube: Cube, context: Context, fields: dict[str, Any]
) -> Result:
    """Return the seven components of one stack."""
    watch = Stopwatch()
    parts = cube.components
    if parts["tvh"].variance_dn2 <= 0:
        reason = f"{level.label} has no temporal noise of single pixels"
        return Result(measurements=_refusals(reason, fields))
    rng = np.random.default_rng([context.seed, 7, crc32(level.label.encode())])
    draws = {name: part.draws(rng, CUBE.draws) for name, part in parts.items()}
    out = [
        judged(
            _measurement(name, parts[name], draws[name], fields),
            _remarks(name, level, cube, draws),
        )
        for name in NAMES
    ]
    seconds = cube.seconds + watch.seconds()
    return Result(
        measurements=tuple(m.with_(seconds=seconds) for m in out),
        evidence={f"three-dimensional-noise:{level.label}": _figure_data(level, cube)},
    )


def _measurement(name: str, part: Component, draws: Array, fields: dict[str, Any]) -> Measurement:
    """Return the standard deviation of a component, or its upper limit."""
    value = float(np.sqrt(max(part.variance_dn2, 0.0)))
    # A negative estimate is chance and must not lower the limit below that of a zero estimate.
    possible = draws - min(part.variance_dn2, 0.0)
    _, interval68, (low, high) = intervals_of(np.sqrt(np.maximum(possible, 0.0)))
    notes: tuple[str, ...] = ()
    if np.quantile(draws, CUBE.false_alarm) <= 0:
        low = 0.0
        absence = f"no {name} noise detected (unbiased variance {part.variance_dn2:.2g} DN2)"
        notes = (f"{absence}: at most {high:.3g} DN",)
    around = [
        (min(low_edge, value), max(high_edge, value))
        for low_edge, high_edge in (interval68, (low, high))
    ]
    return make_measurement(f"noise_{name}", "DN", value, *around, notes=notes, **fields)


def _remarks(name: str, level: StackStatistics, cube: Cube, draws: dict[str, Array]) -> Remarks:
    """Return what was seen of a component.

    Of noise of which the fraction p is cut off, a component keeps the fraction 1 - p of its
    amplitude, as a value that is cut does not follow it; the random one keeps more, see
    `clipping_effects`.
    """
    remarks: Remarks = []
    if cube.fields > 1:
        of = (
            "even and odd rows"
            if cube.fields == 2
            else "lines of both fields and both scan directions"
        )
        remarks.append(f"{of} form separate cubes; their variances are averaged")
    part, half = cube.components[name], _half(draws[name])
    value_dn = float(np.sqrt(max(part.variance_dn2, 0.0)))
    random_dn2 = cube.components["tvh"].variance_dn2
    low, high = level.low_fraction, level.high_fraction
    for clipped_fraction, end in ((low, "0"), (high, "the highest")):
        if (
            clipped_fraction > CHECKS.max_clipped_fraction
            or 2.0 * clipped_fraction * random_dn2 > 0.5 * _half(draws["tvh"])
        ):
            _, lowered_dn = clipping_effects(clipped_fraction, random_dn2**0.5, level.mean_dn)
            if name != "tvh" and lowered_dn is not None:
                lowered_dn = value_dn * clipped_fraction / (1.0 - clipped_fraction)
            effect = f"{100 * clipped_fraction:.2g} % of the values are at code {end}"
            # Pulses that are cut off at full scale may hold any part of the variance.
            bound = lowered_dn if clipped_fraction == low else None
            remarks.append(finding("clipped", effect, bound=bound, sign=-1))
    rounded = rounding_findings(random_dn2)
    remarks += rounded if name == "tvh" else bounded(rounded)
    for axis, slope in part.slopes.items():
        if (
            slope.min_fraction > CUBE.max_slope
            and abs(slope.estimate_dn2) > CUBE.slope_weight * half
        ):
            flag, along = ("lag", "frames") if axis == TIME else ("correlated-noise", "pixels")
            effect = f"noise is correlated over so many {along} that it is hardly separable from"
            remedy = "a longer stack" if axis == TIME else "a larger image"
            remarks.append(finding(flag, f"{effect} {name}", remedy))
    if name in ("v", "h", "vh"):
        shading = f"{cube.shading_dn:.3g} DN rms"
        remarks.append(
            f"excludes smooth shading up to fourth order along rows and columns, {shading}"
        )
    if difference_dn := cube.row_difference_dn.get(name, 0.0):
        effect = f"even and odd rows differ by {difference_dn:.3g} DN, as fields not separated"
        remarks.append(finding("interlace-motion", effect))
    return remarks + (_frame_mean_findings(cube.means) if name == "t" else [])


def _half(draws: Array) -> float:
    """Return half of the 95 % interval."""
    return 0.5 * float(np.ptp(np.quantile(draws, [0.025, 0.975])))


def _frame_mean_findings(means: FrameMeans) -> list[Finding]:
    """Return findings of drift and flicker in the frame means."""
    out = []
    if means.drift_seen:
        change = level_change(means.mean_dn, 0.0)
        effect = (
            f"the mean {change or f'drifts by {means.drift_dn:.3g} DN from first to last frame'}"
        )
        out.append(finding("drift", effect))
    if means.line is not None:
        period = f"{means.frequency_cy_per_exposure[means.line]:.3g} cycles per exposure"
        if means.line_hz is not None:
            period = f"{means.line_hz:.3g} Hz, or an alias of a higher frequency"
        effect = f"the mean flickers by {means.line_rms_dn:.3g} DN rms at {period}"
        out.append(finding("flicker", effect))
    return out


def _figure_data(level: StackStatistics, cube: Cube) -> dict[str, Any]:
    """Return the figure data: means of frames, rows and columns."""
    means = cube.means
    return {
        "figure": "three-dimensional-noise",
        **{f"{name}_dn2": part.variance_dn2 for name, part in cube.components.items()},
        "fields": cube.fields,
        "frames": level.frames,
        "exposure_mean_dn": means.mean_dn.tolist(),
        "exposure_period_s": means.exposure_period_s,
        "frequency_cy_per_exposure": means.frequency_cy_per_exposure.tolist(),
        "power_dn2": means.power_dn2.tolist(),
        "drift_dn": means.drift_dn,
        "flicker_rms_dn": means.line_rms_dn,
        "flicker_hz": means.line_hz,
        "row_mean_dn": cube.row_mean_dn.tolist(),
        "column_mean_dn": cube.column_mean_dn.tolist(),
    }
