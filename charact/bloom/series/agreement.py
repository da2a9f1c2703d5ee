"""Whether extents read from the frames are those of the fitted light: two ways to one number that must agree."""

import numpy as np
from numpy.typing import NDArray

from charact.bloom.series.choice import Candidate
from charact.bloom.spot import Spot
from labdata.measurement import Measurement

Array = NDArray[np.float64]

# What the two may differ by: px or a share, whichever is more, and the light that the fitted one may be off by.
WITHIN_PX, WITHIN_SHARE, LIGHT_SHARE = 1.0, 0.05, 0.03
LEVELS = {"bloom_diameter": "half_dn", "bloom_diameter_clip": "full_scale_dn"}


def contradicted(best: Candidate, group: tuple[Spot, ...], extents: tuple[Measurement, ...]) -> set[tuple[str, str]]:
    """Tell the extents that the fitted light does not bear out.

    Parameters
    ----------
    best
        The form fitted to the stacks.
    group
        The stacks, in the order of the series' levels.
    extents
        Measurements of the stacks, streaks among them.

    Returns
    -------
    set
        Quantity and stack of each extent that is off, or that a streak may have joined to a rim which the round light
        leaves apart.
    """
    problem = best.problem
    light = problem.light_at(best.peak.point[None])[..., 0]
    streaked = {one.stack for one in extents if one.quantity == "streak_level" and one.status != "refused"}
    out = set()
    for one in extents:
        spot = next((spot for spot in group if spot.label == one.stack), None)
        if one.quantity not in LEVELS or one.interval95 is None or spot is None:
            continue
        curve = light[problem.series.labels.index(spot.label)]
        level = getattr(spot, LEVELS[one.quantity])
        if _is_off(problem.series.node_px, curve, level, one.interval95) or (
            spot.label in streaked and _stands_apart(curve, level)
        ):
            out.add((one.quantity, spot.label))
    return out


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
