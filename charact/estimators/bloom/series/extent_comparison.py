"""Comparison of measured bloom diameters with those of the fitted model."""

from collections.abc import Callable
from dataclasses import replace
from typing import cast

import numpy as np

from charact.estimators.bloom.extent import Extent
from charact.estimators.bloom.findings import finding
from charact.estimators.bloom.point_stack import HALF_STEP_DN, PointStack
from charact.estimators.bloom.series.model_selection import FittedHaloModel
from charact.verdict import judge
from labdata import Array, Measurement

# Relative uncertainty of the fitted signal.
LIGHT_SHARE = 0.03
# Thresholds and measured extents that the fitted model predicts, and the extents that it may
# contradict.
READ: dict[str, Callable[[PointStack], tuple[float, Extent | None]]] = {
    "bloom_diameter": lambda spot: (spot.half_dn, spot.half),
    "bloom_diameter_clip": lambda spot: (spot.full_scale_dn - HALF_STEP_DN, spot.clip),
    "bloom_diameter_background": lambda spot: (
        spot.dark_dn + 2.0 * spot.light.level_dn,
        spot.background,
    ),
}
CONTRADICTED = ("bloom_diameter", "bloom_diameter_clip")
# Extent compared over all stacks.
JUDGED = "bloom_diameter"
# Factors on the contour's own error in the mean of both, for long contours and for short ones,
# calibrated on some hundred closed-form series of 4 to 16 frames. A short contour and the model
# depend on the same few pixels. Next to full scale the model replaces what clipping hides.
LONG = {"bloom_diameter": 0.44, "bloom_diameter_clip": 0.5, "bloom_diameter_background": 0.6}
SHORT = {"bloom_diameter": 1.1, "bloom_diameter_clip": 1.5, "bloom_diameter_background": 1.5}


def compare_extents(
    best: FittedHaloModel, group: tuple[PointStack, ...], extents: list[Measurement]
) -> list[Measurement]:
    """Combine measured diameters with those of the fitted model; differences widen the intervals.

    `best`: model fitted to the stacks; `group`: stacks in the order of the series; `extents`:
    measurements of the stacks, including streaks. A streak belongs to the frame alone: an extent
    that it distorts stays as measured, and is flagged where the streak may have joined it to a
    separate rim. Extents that the model contradicts are flagged, and all extents where the
    differences over the stacks exceed noise.
    """
    from scipy.special import chdtrc

    series, light = best.problem.series, best.problem.light_at(best.peak.point[None])[..., 0]
    streaked = {
        extent.stack
        for extent in extents
        if extent.quantity == "streak_level" and extent.status != "refused"
    }
    spots = {spot.label: spot for spot in group}
    out, differences = [], []
    for extent in extents:
        if extent.quantity in READ and extent.interval95 is not None and extent.stack in spots:
            spot = spots[extent.stack]
            (level, read), curve = (
                READ[extent.quantity](spot),
                light[series.labels.index(spot.label)],
            )
            inner = int(np.argmax(curve < level))
            joined = spot.label in streaked and bool(
                curve[inner] < level and (curve[inner:] >= level).any()
            )
            off = joined or _is_off(series.node_px, curve, level, extent.interval95)
            alone = off or read is None or read.pulled or read.contour is None
            diameter = _diameter(series.node_px, curve, level)
            if extent.quantity == JUDGED and not alone and np.isfinite(diameter):
                # Difference of both without noise or model error, px.
                differences.append(
                    (cast(float, extent.value) - diameter) / np.hypot(_sd(extent), 0.02)
                )
            extent = _combine_diameters(extent, diameter, alone=alone, frames=spot.frames)
            if off and extent.quantity in CONTRADICTED:
                effect = "the fitted spread crosses the threshold outside the interval"
                extent = judge(extent, [finding("model-misfit", effect)])
        out.append(extent)
    # Normalised differences between contours and model over the stacks exceed noise.
    differ = chdtrc(max(len(differences), 1), np.sum(np.square(differences))) < 1e-4
    misfit = finding("model-misfit", "measured and fitted diameters differ beyond noise")
    return [
        judge(extent, [misfit])
        if differ and extent.quantity == JUDGED and extent.status != "refused"
        else extent
        for extent in out
    ]


def _sd(extent: Measurement) -> float:
    """Standard error of an extent, px."""
    low, high = cast(tuple[float, float], extent.interval95)
    return (high - low) / 3.92


def _combine_diameters(
    extent: Measurement, diameter_px: float, *, alone: bool, frames: int
) -> Measurement:
    """Mean of a measured and a modelled diameter, or the measured one alone; the difference is in
    the intervals.
    """
    value, low68, low95 = extent.value, extent.interval68, extent.interval95
    if value is None or low68 is None or low95 is None or not np.isfinite(diameter_px):
        return extent
    mean = value if alone else 0.5 * (value + diameter_px)
    # Part of the difference charged as a standard error, so that the 95 % interval of the mean
    # covers both values.
    own_error_factor, charged = (1.0, 0.4) if alone else (_error_factor(extent, mean, frames), 0.3)
    sd = float(np.hypot(charged * (value - diameter_px), 0.0 if alone else 0.004))
    intervals = [
        tuple(
            mean + way * float(np.hypot(own_error_factor * (value - ends[at]), times * sd))
            for at, way in enumerate((-1, 1))
        )
        for ends, times in ((low68, 1.0), (low95, 1.96))
    ]
    return replace(extent, value=mean, interval68=intervals[0], interval95=intervals[1])


def _error_factor(extent: Measurement, diameter_px: float, frames: int) -> float:
    """Factor on a contour's own error in the mean with the fitted model; larger in all ways for the
    half diameter.
    """
    name, half = extent.quantity, extent.quantity == "bloom_diameter"
    long = LONG[name] + (0.35 * half) / (1.0 + (0.06 / max(_sd(extent), 1e-9)) ** 2)
    factor = long + (SHORT[name] - long) / (1.0 + (diameter_px / 6.0) ** 4)
    return factor * (1.0 + 3.0 * half / frames)


def _is_off(
    node_px: Array, light_dn: Array, level_dn: float, interval: tuple[float, float]
) -> bool:
    """Whether the model, allowances made, crosses the threshold outside an interval."""
    floor = float(light_dn[-1])
    light_limits = [floor + (light_dn - floor) * (1.0 + off) for off in (-LIGHT_SHARE, LIGHT_SHARE)]
    diameters = [_diameter(node_px, light, level_dn) for light in light_limits]
    if not np.isfinite(diameters).all():
        return False
    allowed = max(1.0, 0.05 * max(diameters))
    return interval[1] < min(diameters) - allowed or interval[0] > max(diameters) + allowed


def _diameter(node_px: Array, light_dn: Array, level_dn: float) -> float:
    """Diameter at which the signal first falls through a threshold; NaN where it does not within
    the rings.
    """
    nodes_below = np.flatnonzero(light_dn < level_dn)
    if not len(nodes_below):
        return float("nan")
    if nodes_below[0] == 0:
        return 0.0
    node = int(nodes_below[0])
    step_fraction = (light_dn[node - 1] - level_dn) / (light_dn[node - 1] - light_dn[node])
    return 2.0 * float(node_px[node - 1] + step_fraction * (node_px[node] - node_px[node - 1]))
