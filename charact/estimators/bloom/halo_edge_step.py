"""Radial profile of one stack, and the halo edge as its steepest step."""

from dataclasses import dataclass

import numpy as np

from charact.estimators.bloom.lit_edge_profile import smooth_variance
from charact.estimators.bloom.point_stack import PointStack
from charact.estimators.bloom.series.rings import SECTORS, geometry_of
from charact.frames.clipping import is_cut
from charact.method import Context
from labdata import Array, Mask


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Ring means of one stack.

    `radius_px`: mean radius of each ring, column pitches; `mean_dn`, `sd_dn`: ring means and their
    standard errors, DN; `usable`: rings neither saturated nor next to a saturated one; shape
    (ring,) each.
    """

    radius_px: Array
    mean_dn: Array
    sd_dn: Array
    usable: Mask


def profile_of(spot: PointStack, *, context: Context) -> Profile:
    """Average a stack's mean frame over rings one column pitch wide, without the source's columns
    beyond 6 px.

    Standard errors come from the scatter of sectors of each ring, which includes correlated noise
    of pixels and successive frames, and are smoothed over rings.
    """
    rows, cols = spot.image.shape
    reach_px = int(max(8, min(60, spot.row, spot.col, rows - 1 - spot.row, cols - 1 - spot.col)))
    dx, dy = np.arange(cols) - spot.col, (np.arange(rows)[:, None] - spot.row) * context.pitch_ratio
    column = (np.abs(dx) <= 2.5) & (np.hypot(dx, dy) >= 6.0)
    geometry = geometry_of(
        (rows, cols),
        spot.row,
        spot.col,
        pitch_ratio=context.pitch_ratio,
        spoiled=column,
        reach_px=reach_px,
    )
    pixels = geometry.pixels(spot.image[None])[0]
    mean, brightest = geometry.means(pixels), geometry.largest(pixels)
    raw = np.nansum((geometry.sector_means(pixels) - mean) ** 2, axis=0) / (SECTORS * (SECTORS - 1))
    # Rings outside the saturated core, and inside any saturated outer ring.
    usable = np.ones(len(mean), bool)
    over = np.flatnonzero(is_cut(mean, brightest, spot.dark_dn, spot.full_scale_dn))
    inner, outer = over[over < reach_px // 2], over[over >= reach_px // 2]
    usable[: int(inner[-1]) + 3 if len(inner) else 0] = False
    usable[int(outer[0]) if len(outer) else len(usable) :] = False
    return Profile(
        radius_px=geometry.radius_px,
        mean_dn=mean,
        usable=usable,
        sd_dn=np.maximum(
            np.sqrt(smooth_variance(raw * geometry.count, 0.06) / geometry.count), 1e-3
        ),
    )


FIRST_RING = 8
STEP_SEEN = 6.0


def step_significance(profile: Profile) -> Array:
    """Return the excess of each ring's step over its neighbours' in standard errors, shape (ring,);
    0 where unusable.

    A smooth wing falls ever more slowly, so that the step at r is about the mean of the steps
    inside and outside. At the edge of a disc it exceeds them.
    """
    mean, variance, half = profile.mean_dn, profile.sd_dn**2, 2
    out = np.zeros(len(mean))
    for ring in range(FIRST_RING, len(mean) - 3 * half):
        rings = ring + half * np.array([-3, -1, 1, 3])
        if not profile.usable[rings[0] : rings[3] + 1].all():
            continue
        weight = np.array([-0.5, 1.5, -1.5, 0.5])
        out[ring] = weight @ mean[rings] / np.sqrt(weight**2 @ variance[rings])
    return out


def edge_radius(profile: Profile) -> tuple[float, float]:
    """Return the radius of the steepest fall at the most significant step, and the significance."""
    score = step_significance(profile)
    top = int(np.argmax(score))
    if score[top] <= 0:
        return float("nan"), 0.0
    rings = np.arange(max(FIRST_RING, top - 4), min(len(score) - 2, top + 5))
    rings = rings[profile.usable[rings - 1] & profile.usable[rings + 1]]
    fall = profile.mean_dn[rings - 1] - profile.mean_dn[rings + 1]
    best = int(np.argmax(fall))
    if not 0 < best < len(rings) - 1:
        return float(profile.radius_px[rings[best]]), float(score[top])
    inner_fall, middle_fall, outer_fall = fall[best - 1 : best + 2]
    bend = inner_fall - 2 * middle_fall + outer_fall
    shift = 0.5 * (inner_fall - outer_fall) / bend if bend < 0 else 0.0
    return float(profile.radius_px[rings[best]] + np.clip(shift, -0.5, 0.5)), float(score[top])
