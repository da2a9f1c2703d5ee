"""Do the targets of a session tell of one MTF: every pair of them at every bar target's frequency, judged together."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, ndtri

from charact.method import Context
from charact.mtf.session.constraints import HALF68_SD, ConstraintSource, is_vertical, pitches, sources
from charact.mtf.session.thresholds import THRESHOLDS
from labdata.conditions import Conditions
from labdata.measurement import Curve, Measurement, Result

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Reading:
    """What one target says of the MTF at one frequency."""

    target: str
    value: float
    sd: float


def mtf_consistency(result: Result, kinds: dict[str, str]) -> Result:
    """Return, as evidence "agreement", how far apart the targets' MTFs are at the frequencies of the bars.

    Parameters
    ----------
    result
        Measurements and curves of one session.
    kinds
        Kind of each stack ("edge", "bars", "point") by its label.

    Returns
    -------
    Result
        Empty where there are no two targets to compare.

    Notes
    -----
    Bonferroni: the differences are inside their joint 95 % region when none is beyond the normal quantile at
    1 - 0.05 / (2 n), n their number, however much they depend on each other.
    """
    rows = [
        (f"{one.target} - {other.target}", m.frequency_cy_per_px, one, other)
        for m in result.find("mtf")
        if kinds.get(m.stack or "") == "bars" and m.value is not None
        for one, other in combinations(_readings(m, result, kinds), 2)
    ]
    if not rows:
        return Result()
    difference = np.array([one.value - other.value for _, _, one, other in rows])
    sd = np.array([np.hypot(one.sd, other.sd) for _, _, one, other in rows])
    limit = float(ndtri(1.0 - THRESHOLDS.level / (2 * len(rows))))
    largest = float(np.abs(difference / sd).max())
    evidence = {
        "figure": "agreement",
        "pair": [pair for pair, *_ in rows],
        "frequency_cy_per_px": [frequency for _, frequency, *_ in rows],
        "difference": difference.tolist(),
        "half_width": (limit * sd).tolist(),
        "largest_z": largest,
        "joint_95_percent_limit_z": limit,
        "inside_joint_95_percent_region": largest <= limit,
    }
    return Result(evidence={"agreement of targets": evidence})


def _readings(bars: Measurement, result: Result, kinds: dict[str, str]) -> list[Reading]:
    """Return the bars' own reading and those of all curves along the same direction."""
    curves = [
        (kinds[stack], curve)
        for name, curve in result.curves.items()
        if (stack := curve.stack or name.partition(":")[2]) in kinds
        and _same_direction(bars.orientation_deg or 0.0, _direction_deg(name, stack, result))
    ]
    found = [
        _reading_at(kind, curve, bars.frequency_cy_per_px or 0.0)
        for kind, curve in curves
        if curve.interval68 is not None
    ]
    low, high = bars.interval68 or (np.nan, np.nan)
    return [Reading(target="bars", value=bars.value or 0.0, sd=(high - low) / (2 * HALF68_SD)), *found]


def _reading_at(kind: str, curve: Curve, frequency: float) -> Reading:
    """Return a curve's value at one frequency."""
    low, high = np.asarray(curve.interval68, float)
    value, width = (float(np.interp(frequency, curve.frequency_cy_per_px, line)) for line in (curve.value, high - low))
    return Reading(target=kind, value=value, sd=width / (2 * HALF68_SD))


def _direction_deg(name: str, stack: str, result: Result) -> float:
    """Return the direction of a curve's frequencies: a point source has one curve along rows and one along columns."""
    if name.startswith("mtf_vertical"):
        return 90.0
    directions = [m.orientation_deg for m in result.find("mtf50", stack=stack) if m.orientation_deg is not None]
    return min(directions, default=0.0)


def _same_direction(one_deg: float, other_deg: float) -> bool:
    apart = abs(one_deg - other_deg) % 180.0
    return min(apart, 180.0 - apart) <= THRESHOLDS.same_direction_deg


# What MTF50 is laid against; light by its logarithm, for it runs over decades.
AGAINST = ("row_px", "col_px", "mcp_v", "ln_light")


@dataclass(frozen=True, kw_only=True)
class UniformityRow:
    """MTF50 of one target, cycles per column pitch, and where and how it was taken; NaN where that is unknown."""

    target: str
    vertical: bool
    mtf50: float
    sd: float
    row_px: float
    col_px: float
    mcp_v: float
    ln_light: float


def mtf_uniformity(
    result: Result, kinds: Mapping[str, str], conditions: Mapping[str, Conditions], *, context: Context
) -> Result:
    """Lay the MTF50 of edges and points against field position, gain and light, and test whether it is constant.

    Parameters
    ----------
    result
        Measurements and curves of one session; only sound (ok) ones are used.
    kinds, conditions
        Kind ("edge", "bars", "point") and conditions of each stack by its label.
    context
        The camera, for its pitches.

    Returns
    -------
    Result
        Evidence "MTF50 over the field and settings" (and "..., vertical"): the table, chi squared of all against their
        weighted mean with its chance, and the slope against each setting that differs, with its standard error. Empty
        where no direction has two targets whose place, gain or light differs.
    """
    rows = [_row(source, conditions, context) for source in sources(result, kinds)]
    evidence = {}
    for vertical, name in ((False, ""), (True, ", vertical")):
        own = [row for row in rows if row.vertical == vertical]
        trends = {key: trend for key in AGAINST if (trend := _trend(own, key)) is not None}
        if trends:
            evidence[f"MTF50 over the field and settings{name}"] = _table(own, trends)
    return Result(evidence=evidence)


def _row(source: ConstraintSource, conditions: Mapping[str, Conditions], context: Context) -> UniformityRow:
    m = source.of
    angle = m.orientation_deg or 0.0
    low, high = m.interval68 or (np.nan, np.nan)
    pitch = pitches(source.kind, angle, context)
    taken = conditions.get(m.stack or "", Conditions())
    light = taken.illuminance_lux if taken.illuminance_lux is not None else taken.photons_per_px
    row, col, height, width = m.region or (np.nan,) * 4
    return UniformityRow(
        target=m.stack or "",
        vertical=is_vertical(angle),
        mtf50=(m.value or np.nan) / pitch,
        sd=(high - low) / (2.0 * HALF68_SD * pitch),
        row_px=row + 0.5 * height,
        col_px=col + 0.5 * width,
        mcp_v=np.nan if taken.mcp_v is None else taken.mcp_v,
        ln_light=np.log(light) if light else np.nan,
    )


def _trend(rows: list[UniformityRow], key: str) -> tuple[float, float] | None:
    """Return the slope of MTF50 against a setting and its standard error; None where it does not differ."""
    known = [row for row in rows if np.isfinite(getattr(row, key)) and row.sd > 0]
    if len(known) < 2:
        return None
    x, y, weight = np.array([(getattr(row, key), row.mtf50, row.sd**-2) for row in known]).T
    away = x - np.average(x, weights=weight)
    spread = float(np.sum(weight * away**2))
    if np.ptp(x) <= 1e-9 * max(float(np.abs(x).max()), 1.0):
        return None
    return float(np.sum(weight * away * y) / spread), float(spread**-0.5)


def _table(rows: list[UniformityRow], trends: dict[str, tuple[float, float]]) -> dict:
    value, sd = np.array([(row.mtf50, row.sd) for row in rows]).T
    mean = float(np.average(value, weights=sd**-2))
    squares = float(np.sum(((value - mean) / sd) ** 2))
    probability = float(chdtrc(len(rows) - 1, squares))
    return {
        "figure": "constancy",
        "target": [row.target for row in rows],
        "mtf50_cy_per_px": value.tolist(),
        "sd_cy_per_px": sd.tolist(),
        **{key: [getattr(row, key) for row in rows] for key in AGAINST},
        "slopes": {key: list(trend) for key, trend in trends.items()},
        "mean_mtf50_cy_per_px": mean,
        "chi_squared": squares,
        "degrees_of_freedom": len(rows) - 1,
        "probability": probability,
        "constant_at_5_percent": bool(probability >= THRESHOLDS.level),
    }
