"""Consistency of the targets' MTFs at the bars' frequencies, and of MTF50 over the field and
settings.
"""

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from scipy.special import chdtrc, ndtri

from charact.estimators.mtf.session.constraints import (
    ConstraintSource,
    is_vertical,
    pitches,
    sources,
)
from charact.estimators.mtf.session.thresholds import HALF68_SD, THRESHOLDS
from charact.method import Context
from labdata import Conditions, Measurement, Result


def mtf_consistency(result: Result, kinds: Mapping[str, str]) -> Result:
    """Return the evidence "agreement of targets": differences of the targets' MTFs at the
    frequencies of the bars.

    Bonferroni: the n differences lie in their joint 95 % region if none exceeds the normal quantile
    at 1 - 0.05 / (2 n), whatever their correlation. Empty without two targets to compare.
    """
    rows = [
        (
            f"{reading[0]} - {other[0]}",
            m.frequency_cy_per_px,
            reading[1] - other[1],
            np.hypot(reading[2], other[2]),
        )
        for m in result.find("mtf")
        if kinds.get(m.stack or "") == "bars" and m.value is not None
        for reading, other in combinations(_readings(m, result, kinds), 2)
    ]
    if not rows:
        return Result()
    pairs, frequencies, *numbers = zip(*rows, strict=True)
    difference, sd = np.array(numbers)
    limit = float(ndtri(1.0 - THRESHOLDS.level / (2 * len(rows))))
    largest = float(np.abs(difference / sd).max())
    evidence = {
        "figure": "agreement",
        "pair": list(pairs),
        "frequency_cy_per_px": list(frequencies),
        "difference": difference.tolist(),
        "half_width": (limit * sd).tolist(),
        "largest_z": largest,
        "joint_95_percent_limit_z": limit,
        "inside_joint_95_percent_region": largest <= limit,
    }
    return Result(evidence={"agreement of targets": evidence})


def _readings(
    bars: Measurement, result: Result, kinds: Mapping[str, str]
) -> list[tuple[str, float, float]]:
    """Return target, MTF and standard uncertainty of the bars and of all curves along the same
    direction.
    """
    low, high = bars.interval68 or (np.nan, np.nan)
    readings = [("bars", bars.value or 0.0, (high - low) / (2 * HALF68_SD))]
    for name, curve in result.curves.items():
        stack = curve.stack or name.partition(":")[2]
        if stack not in kinds or curve.interval68 is None:
            continue
        difference_deg = (
            abs((bars.orientation_deg or 0.0) - _direction_deg(name, stack, result)) % 180.0
        )
        if min(difference_deg, 180.0 - difference_deg) > THRESHOLDS.same_direction_deg:
            continue
        value, width = (
            float(np.interp(bars.frequency_cy_per_px or 0.0, curve.frequency_cy_per_px, line))
            for line in (curve.value, np.diff(curve.interval68, axis=0)[0])
        )
        readings.append((kinds[stack], value, width / (2 * HALF68_SD)))
    return readings


def _direction_deg(name: str, stack: str, result: Result) -> float:
    """Return the direction of a curve's frequencies: a point source has one curve along rows and
    one along columns.
    """
    if name.startswith("mtf_vertical"):
        return 90.0
    directions = [
        m.orientation_deg
        for m in result.find("mtf50", stack=stack)
        if m.orientation_deg is not None
    ]
    return min(directions, default=0.0)


# Settings that MTF50 is compared with; light by its logarithm.
AGAINST = ("row_px", "col_px", "mcp_v", "ln_light")


def mtf_uniformity(
    result: Result,
    kinds: Mapping[str, str],
    conditions: Mapping[str, Conditions],
    *,
    context: Context,
) -> Result:
    """Compare the MTF50 of edges and points with field position, gain and light, and test whether
    it is constant.

    Evidence "MTF50 over the field and settings" (and "..., vertical"): the table, chi-squared about
    the weighted mean with its p-value, and the slope against each setting that differs, with its
    standard error. Empty without two valid targets along one direction whose place, gain or light
    differs.
    """
    rows = [_row(source, conditions, context) for source in sources(result, kinds)]
    evidence = {}
    for vertical, name in ((False, ""), (True, ", vertical")):
        direction_rows = [row for row in rows if row["vertical"] == vertical]
        slopes = {
            key: slope for key in AGAINST if (slope := _slope(direction_rows, key)) is not None
        }
        if slopes:
            evidence[f"MTF50 over the field and settings{name}"] = _table(direction_rows, slopes)
    return Result(evidence=evidence)


def _row(source: ConstraintSource, conditions: Mapping[str, Conditions], context: Context) -> dict:
    """Return MTF50 of a target, cycles per column pitch, with place and settings; NaN where
    unknown.
    """
    m = source.of
    angle = m.orientation_deg or 0.0
    low, high = m.interval68 or (np.nan, np.nan)
    pitch = pitches(source.kind, angle, context)
    stack_conditions = conditions.get(m.stack or "", Conditions())
    light = (
        stack_conditions.illuminance_lux
        if stack_conditions.illuminance_lux is not None
        else stack_conditions.photons_per_px
    )
    row, col, height, width = m.region or (np.nan,) * 4
    return {
        "target": m.stack or "",
        "vertical": is_vertical(angle),
        "mtf50": (m.value or np.nan) / pitch,
        "sd": (high - low) / (2.0 * HALF68_SD * pitch),
        "row_px": row + 0.5 * height,
        "col_px": col + 0.5 * width,
        "mcp_v": np.nan if stack_conditions.mcp_v is None else stack_conditions.mcp_v,
        "ln_light": np.log(light) if light else np.nan,
    }


def _slope(rows: list[dict], key: str) -> list[float] | None:
    """Return the slope of MTF50 against a setting and its standard error; None where it does not
    differ.
    """
    known = [row for row in rows if np.isfinite(row[key]) and row["sd"] > 0]
    if len(known) < 2:
        return None
    x, y, weight = np.array([(row[key], row["mtf50"], row["sd"] ** -2) for row in known]).T
    if np.ptp(x) <= 1e-9 * max(float(np.abs(x).max()), 1.0):
        return None
    deviation = x - np.average(x, weights=weight)
    spread = float(np.sum(weight * deviation**2))
    return [float(np.sum(weight * deviation * y) / spread), float(spread**-0.5)]


def _table(rows: list[dict], slopes: dict[str, list[float]]) -> dict:
    value, sd = np.array([(row["mtf50"], row["sd"]) for row in rows]).T
    mean = float(np.average(value, weights=sd**-2))
    squares = float(np.sum(((value - mean) / sd) ** 2))
    probability = float(chdtrc(len(rows) - 1, squares))
    return {
        "figure": "constancy",
        "target": [row["target"] for row in rows],
        "mtf50_cy_per_px": value.tolist(),
        "sd_cy_per_px": sd.tolist(),
        **{key: [row[key] for row in rows] for key in AGAINST},
        "slopes": slopes,
        "mean_mtf50_cy_per_px": mean,
        "chi_squared": squares,
        "degrees_of_freedom": len(rows) - 1,
        "probability": probability,
        "constant_at_5_percent": bool(probability >= THRESHOLDS.level),
    }
