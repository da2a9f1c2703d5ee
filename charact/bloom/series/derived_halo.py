"""What a fitted form says of a point's light: encircled radii, plateau and rim of the halo, glare."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.bloom.series.halo_models import HaloModel, pixel_of, profile_of
from charact.bloom.series.hankel import onto_nodes

Array = NDArray[np.float64]

# Radii in which the plateau is taken and the rim looked for, as shares of the halo's.
PLATEAU = (0.3, 0.7)
RIM = (0.75, 1.1)
STEP_PX = 0.1


@dataclass(frozen=True, kw_only=True)
class HaloHeights:
    """A halo's height, one number for each draw.

    Parameters
    ----------
    plateau
        Mean light between 0.3 and 0.7 of its radius over the source's whole light, 1/px^2.
    rim
        Highest light of the rim, blurred by the core without its wing, over the plateau, dimensionless.
    """

    plateau: Array
    rim: Array


def halo_of(form: HaloModel, points: Array) -> HaloHeights:
    """Return plateau and rim of a disc at draws of its parameters, shape (draw, parameter)."""
    of = form.at(points)
    radius, profile = of["halo_diameter"] / 2.0, profile_of(of)
    inner, outer = PLATEAU
    within = _within(outer) - _within(inner)
    share = profile @ within[:-1] + (1.0 - profile.sum(axis=1)) * within[-1]
    per_px2 = share / (np.pi * radius**2 * (outer**2 - inner**2))
    at = np.arange(RIM[0] * radius.min(), RIM[1] * radius.max(), 0.2)
    halo = form.halo_transform(points)
    assert halo is not None
    light = (form.blur_transform(points) * pixel_of(form.pitch_ratio) * halo) @ onto_nodes(at)
    near = (at > RIM[0] * radius[:, None]) & (at < RIM[1] * radius[:, None])
    rim = np.where(near, light, -np.inf).max(axis=1)
    return HaloHeights(plateau=of["halo_fraction"] * per_px2, rim=rim / per_px2)


def _within(x: float) -> Array:
    """Fractions of light within x of the disc's radius for each density of `transfer.PROFILE`, and of a flat disc."""
    root = float(np.sqrt(1.0 - x**2))
    return np.array([1.0 - root, x * np.arccos(x) - root + 1.0, x**4, x**14, x**2])


def energy_radii(form: HaloModel, points: Array, shares: tuple[float, ...], reach_px: float) -> Array:
    """Return radii that hold shares of a point's light, shape (draw, share), px; NaN beyond the reach."""
    at = np.arange(STEP_PX / 2, reach_px, STEP_PX)
    light = form.transform(points) @ onto_nodes(at)
    within = np.cumsum(light * 2.0 * np.pi * at * STEP_PX, axis=1)
    edges = at + STEP_PX / 2
    # Light falls nowhere below nothing, but its transform rings a little: radii need a rising sum.
    rising = np.maximum.accumulate(within, axis=1)
    out = [[np.interp(share, one, edges, right=np.nan) for share in shares] for one in rising]
    return np.array(out)


def glare(light: Array, background_dn: Array, sd_dn: Array, area_px2: float) -> tuple[float, float] | None:
    """Light that is spread evenly over the frame over the light of the source beside it, and its standard error.

    Parameters
    ----------
    light
        Light of the source at each level, DN px^2, shape (level,).
    background_dn, sd_dn
        Background at each level and its standard error, shape (level,).
    area_px2
        Area of the frame, column pitches squared.

    Returns
    -------
    tuple or None
        The ratio and its standard error, widened where the levels scatter more than their errors; None with fewer than
        three levels.
    """
    if len(light) < 3:
        return None
    design = np.stack([np.ones_like(light), light / light.max()], axis=1) / sd_dn[:, None]
    covariance = np.linalg.inv(design.T @ design)
    best = covariance @ design.T @ (background_dn / sd_dn)
    chi2 = float(((background_dn / sd_dn - design @ best) ** 2).sum()) / (len(light) - 2)
    per_light = float(best[1]) / float(light.max()) * area_px2
    sd = float(np.sqrt(covariance[1, 1] * max(chi2, 1.0))) / float(light.max()) * area_px2
    return per_light, sd
