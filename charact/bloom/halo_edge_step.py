"""Radial profile of one stack, and the halo edge as its steepest step."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.bloom.point_stack import LINEAR_SHARE, PointStack
from charact.method import Context

Array = NDArray[np.float64]

SECTORS = 16


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Ring means of one stack.

    `label`: its stack; `radius_px`: mean radius of each ring, column pitches, shape (ring,); `mean_dn`: ring means,
    shape (ring,), DN; `sd_dn`: their standard errors, shape (ring,), DN; `used`: rings neither saturated nor next to a
    saturated one, shape (ring,).
    """

    label: str
    radius_px: Array
    mean_dn: Array
    sd_dn: Array
    used: NDArray[np.bool_]


def reach_of(spot: PointStack, most_px: int = 60) -> int:
    """Return the number of rings that fit into the frame around the source, at most `most_px`."""
    rows, cols = spot.image.shape
    return int(max(8, min(most_px, spot.row, spot.col, rows - 1 - spot.row, cols - 1 - spot.col)))


def profile_of(spot: PointStack, reach_px: int, *, context: Context) -> Profile:
    """Average a stack's mean frame over rings one column pitch wide.

    Standard errors come from the scatter of sixteen sectors of each ring, which includes correlated noise of pixels and
    successive frames, and are smoothed over rings.
    """
    rows = np.arange(spot.image.shape[0])[:, None]
    cols = np.arange(spot.image.shape[1])[None, :]
    dx, dy = np.broadcast_arrays(cols - spot.col, (rows - spot.row) * context.pitch_ratio)
    radius = np.hypot(dx, dy)
    inside = (radius < reach_px) & ((np.abs(dx) > 2.5) | (radius < 6.0))
    ring = radius[inside].astype(int)
    sector = ((np.arctan2(dy[inside], dx[inside]) / (2 * np.pi) + 0.5) * SECTORS).astype(int) % SECTORS
    value = spot.image[inside]
    count = np.bincount(ring, minlength=reach_px).astype(float)
    mean = np.bincount(ring, value, minlength=reach_px) / np.maximum(count, 1)
    centre = np.bincount(ring, radius[inside], minlength=reach_px) / np.maximum(count, 1)
    cell = ring * SECTORS + sector
    cells = np.bincount(cell, minlength=reach_px * SECTORS).reshape(reach_px, SECTORS).astype(float)
    total = np.bincount(cell, value, minlength=reach_px * SECTORS).reshape(reach_px, SECTORS)
    residual = np.where(cells > 0, total / np.maximum(cells, 1) - mean[:, None], 0.0)
    share = cells / np.maximum(count[:, None], 1)
    raw = (share**2 * residual**2).sum(axis=1) * SECTORS / (SECTORS - 1)
    sd = np.sqrt(_geometric_mean(raw * np.maximum(count, 1)) / np.maximum(count, 1))
    return Profile(
        label=spot.label,
        radius_px=centre,
        mean_dn=mean,
        sd_dn=np.maximum(sd, 1e-3),
        used=_usable_rings(mean, value, ring, spot, reach_px) & (count > 0),
    )


def _geometric_mean(values: Array) -> Array:
    """Geometric mean over five rings."""
    logs = np.log(np.maximum(values, 1e-9))
    padded = np.pad(logs, 2, mode="edge")
    return np.exp(np.convolve(padded, np.full(5, 0.2), mode="valid") + 0.06)


def _usable_rings(
    mean: Array, value: Array, ring: NDArray[np.int64], spot: PointStack, reach_px: int
) -> NDArray[np.bool_]:
    """Rings outside the saturated core, and inside any saturated outer ring."""
    top = spot.dark_dn + LINEAR_SHARE * (spot.full_scale_dn - spot.dark_dn)
    brightest = np.zeros(reach_px)
    np.maximum.at(brightest, ring, value)
    over = np.flatnonzero((mean > top) | (brightest > 0.95 * spot.full_scale_dn))
    inner = over[over < reach_px // 2]
    used = np.ones(reach_px, bool)
    if len(inner):
        used[: int(inner[-1]) + 1 + 2] = False
    outer = over[over >= reach_px // 2]
    if len(outer):
        used[int(outer[0]) :] = False
    return used


FIRST_RING = 8
STEP_SEEN = 6.0


def step_significance(profile: Profile) -> Array:
    """Return the excess of each ring's step over its neighbours' in standard errors, shape (ring,); 0 where unusable.

    A smooth wing falls ever more slowly, so that the step at r is about the mean of the steps inside and outside. At
    the edge of a disc it exceeds them.
    """
    mean, variance, half = profile.mean_dn, profile.sd_dn**2, 2
    out = np.zeros(len(mean))
    for ring in range(FIRST_RING, len(mean) - 3 * half):
        places = ring + half * np.array([-3, -1, 1, 3])
        if not profile.used[places[0] : places[3] + 1].all():
            continue
        weight = np.array([-0.5, 1.5, -1.5, 0.5])
        out[ring] = weight @ mean[places] / np.sqrt(weight**2 @ variance[places])
    return out


def edge_radius(profile: Profile) -> tuple[float, float]:
    """Return the radius of the steepest fall at the most significant step, and the significance."""
    score = step_significance(profile)
    top = int(np.argmax(score))
    if score[top] <= 0:
        return float("nan"), 0.0
    near = np.arange(max(FIRST_RING, top - 4), min(len(score) - 2, top + 5))
    near = near[profile.used[near - 1] & profile.used[near + 1]]
    fall = profile.mean_dn[near - 1] - profile.mean_dn[near + 1]
    best = int(np.argmax(fall))
    if not 0 < best < len(near) - 1:
        return float(profile.radius_px[near[best]]), float(score[top])
    left, middle, right = fall[best - 1 : best + 2]
    bend = left - 2 * middle + right
    shift = 0.5 * (left - right) / bend if bend < 0 else 0.0
    return float(profile.radius_px[near[best]] + np.clip(shift, -0.5, 0.5)), float(score[top])


def first_radius(profiles: list[Profile]) -> tuple[float, float]:
    """Return the edge radius of the stack that shows it most significantly, and the significance."""
    found = [edge_radius(profile) for profile in profiles]
    return max(found, key=lambda one: one[1]) if found else (float("nan"), 0.0)
