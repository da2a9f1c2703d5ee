"""Whether extents read from the frames are those of the fitted light: two ways to one number that must agree."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from charact.bloom.series.choice import Candidate
from charact.bloom.spot import Spot
from labdata.measurement import Measurement

Array = NDArray[np.float64]

MISFIT = ("model-misfit",)
# What the two may differ by: px or a share, whichever is more, and the light that the fitted one may be off by.
WITHIN_PX, WITHIN_SHARE, LIGHT_SHARE = 1.0, 0.05, 0.03
# Levels that the fitted light tells, and those whose extents it may contradict.
LEVELS: dict[str, Callable[[Spot], float]] = {
    "bloom_diameter": lambda spot: spot.half_dn,
    "bloom_diameter_clip": lambda spot: spot.full_scale_dn,
    "bloom_diameter_background": lambda spot: spot.dark_dn + 2.0 * spot.light.level_dn,
}
CONTRADICTED = ("bloom_diameter", "bloom_diameter_clip")
# Share of the difference between both that is charged to what is told, as a standard error.
CHARGED = 0.4


def compared(best: Candidate, group: tuple[Spot, ...], extents: tuple[Measurement, ...]) -> tuple[Measurement, ...]:
    """Return the measurements, extents held against the fitted light: intervals own to a difference, flags to more.

    Parameters
    ----------
    best
        The form fitted to the stacks.
    group
        The stacks, in the order of the series' levels.
    extents
        Measurements of the stacks, streaks among them.

    Notes
    -----
    An extent is flagged that is off, or that a streak may have joined to a rim which the round light leaves apart.
    """
    problem = best.problem
    light = problem.light_at(best.peak.point[None])[..., 0]
    streaked = {one.stack for one in extents if one.quantity == "streak_level" and one.status != "refused"}
    spots = {spot.label: spot for spot in group}
    out = []
    for one in extents:
        if one.quantity in LEVELS and one.interval95 is not None and one.stack in spots:
            spot = spots[one.stack]
            curve, level = light[problem.series.labels.index(spot.label)], LEVELS[one.quantity](spot)
            joined = spot.label in streaked and _stands_apart(curve, level)
            off = joined or _is_off(problem.series.node_px, curve, level, one.interval95)
            one = _charged(one, _diameter(problem.series.node_px, curve, level))
            one = one.with_(flags=MISFIT) if off and one.quantity in CONTRADICTED else one
        out.append(one)
    return tuple(out)


def _charged(extent: Measurement, diameter_px: float) -> Measurement:
    """The extent with what it differs from the fitted light's in its intervals."""
    value, low68, low95 = extent.value, extent.interval68, extent.interval95
    if value is None or low68 is None or low95 is None or not np.isfinite(diameter_px):
        return extent
    sd = CHARGED * abs(value - diameter_px)
    wide = [
        (value - float(np.hypot(value - low, times * sd)), value + float(np.hypot(high - value, times * sd)))
        for (low, high), times in ((low68, 1.0), (low95, 1.96))
    ]
    return replace(extent, interval68=wide[0], interval95=wide[1])


def _is_off(node_px: Array, light_dn: Array, level_dn: float, interval: tuple[float, float]) -> bool:
    """Whether no light near the fitted one falls through a level inside an interval, allowances made."""
    floor = float(light_dn[-1])
    near = [floor + (light_dn - floor) * (1.0 + off) for off in (-LIGHT_SHARE, LIGHT_SHARE)]
    found = [_diameter(node_px, one, level_dn) for one in near]
    if not np.isfinite(found).all():
        return False
    allowed = max(WITHIN_PX, WITHIN_SHARE * max(found))
    return interval[1] < min(found) - allowed or interval[0] > max(found) + allowed


def _diameter(node_px: Array, light_dn: Array, level_dn: float) -> float:
    """Where light first falls through a level, twice; NaN where it does not within the rings."""
    below = np.flatnonzero(light_dn < level_dn)
    if not len(below):
        return float("nan")
    if below[0] == 0:
        return 0.0
    one = int(below[0])
    share = (light_dn[one - 1] - level_dn) / (light_dn[one - 1] - light_dn[one])
    return 2.0 * float(node_px[one - 1] + share * (node_px[one] - node_px[one - 1]))


def _stands_apart(light_dn: Array, level_dn: float) -> bool:
    """Whether light that has fallen through a level comes back to it farther out."""
    below = np.flatnonzero(light_dn < level_dn)
    return bool(len(below)) and bool((light_dn[below[0] :] >= level_dn).any())
