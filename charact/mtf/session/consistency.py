"""Do the targets of a session tell of one MTF: every pair of them at every bar target's frequency, judged together."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import ndtri

from labdata.measurement import Curve, Measurement, Result

# Directions further apart than this have MTFs of their own.
SAME_DIRECTION_DEG = 10.0
LEVEL = 0.05
# Half of a 68 % interval in standard deviations.
HALF68_SD = 0.994458


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
    limit = float(ndtri(1.0 - LEVEL / (2 * len(rows))))
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
    told = [m.orientation_deg for m in result.find("mtf50", stack=stack) if m.orientation_deg is not None]
    return min(told, default=0.0)


def _same_direction(one_deg: float, other_deg: float) -> bool:
    apart = abs(one_deg - other_deg) % 180.0
    return min(apart, 180.0 - apart) <= SAME_DIRECTION_DEG
