"""A Gaussian halo beside a Gaussian core (Thomas et al., Proc. SPIE 2005): simple, and not the shape of a halo."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.bloom.blooms import provenance
from charact.bloom.finish import finished
from charact.bloom.profile import Profile, profile_of, reach_of
from charact.bloom.spot import DETECTED, read_spots
from charact.method import Context, register
from labdata.measurement import Measurement, Result, from_sd, refused
from labdata.session import Session

Array = NDArray[np.float64]

METHOD = "gaussian"
# The core's and the halo's widths from which the fit starts, px, and the least ratio that makes two of them.
CORE_PX, HALO_PX = 1.5, 12.0
TWO = 2.5
# An even disc of radius R has the variance R^2/4 along each axis: a Gaussian of width s is as wide as one of 4 s.
DISC = 4.0
LEAST_RINGS = 8
# Gain in chi squared from which on a halo is seen.
SEEN = 50.0


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Width of the Gaussian halo and its standard error, px; chi squared, its freedom, and what a halo gained."""

    width_px: float
    width_sd_px: float
    chi2: float
    freedom: int
    gain: float


@register(
    "bloom",
    METHOD,
    quantities=("halo_diameter", "bloom_diameter", "streak_length"),
    scope="None, for comparison: a halo is a disc with an edge, a Gaussian has none; the diameter of the even disc of "
    "equal variance is biased, and always flagged.",
)
def gaussian(session: Session, *, context: Context) -> Result:
    """Measure extents, and the halo as a Gaussian fitted to the level that shows it best.

    Parameters
    ----------
    session
        Session with stacks of kind "point".
    context
        Seed and settings.
    """
    spots = read_spots(session, context=context)
    fields: dict[str, Any] = {"method": METHOD, "provenance": provenance(context)}
    profiles = [profile_of(s, reach_of(s), context=context) for s in spots if s.significance > DETECTED]
    fits = [found for profile in profiles if (found := fit_of(profile)) is not None]
    out = [_halo(fits, **fields)]
    return finished(session, spots, out, {}, context=context, **fields)


def _halo(fits: list[Fit], **fields: Any) -> Measurement:
    best = max(fits, key=lambda one: one.gain, default=None)
    if best is None or best.gain < SEEN:
        reason = "a second Gaussian beside the core is worth nothing: no halo is visible"
        return refused("halo_diameter", "px", reason, **fields)
    misfit = best.chi2 / best.freedom
    notes = (f"the even disc of the variance of a Gaussian, which leaves a chi squared of {misfit:.2g} per degree",)
    sd = DISC * best.width_sd_px * float(np.sqrt(max(misfit, 1.0)))
    return from_sd("halo_diameter", "px", DISC * best.width_px, sd, flags=("model-misfit",), notes=notes, **fields)


def fit_of(profile: Profile) -> Fit | None:
    """Fit background, core and halo to the rings that are not cut; None where too few are left or no fit is found."""
    from scipy.optimize import least_squares

    radius, mean = profile.radius_px[profile.used], profile.mean_dn[profile.used]
    if len(radius) < LEAST_RINGS:
        return None
    root = np.asarray(np.linalg.inv(np.linalg.cholesky(profile.covariance())), np.float64)

    def residual(logs: Array) -> Array:
        return root @ (mean - _design(radius, logs) @ _heights(root, radius, mean, logs))

    found = least_squares(residual, np.log([CORE_PX, HALO_PX]), bounds=(np.log([0.3, 3.0]), np.log([8.0, 60.0])))
    core, halo = np.exp(found.x)
    if halo < TWO * core or _heights(root, radius, mean, found.x)[2] <= 0:
        return None
    alone = least_squares(lambda log: _residual_without(root, radius, mean, log), np.log([CORE_PX]))
    covariance = np.linalg.pinv(found.jac.T @ found.jac)
    return Fit(
        width_px=float(halo),
        width_sd_px=float(halo * np.sqrt(covariance[1, 1])),
        chi2=2.0 * float(found.cost),
        freedom=max(len(radius) - 5, 1),
        gain=2.0 * float(alone.cost - found.cost),
    )


def _residual_without(root: Array, radius: Array, mean: Array, log: Array) -> Array:
    """What a background and a core alone leave of whitened ring means."""
    design = _design(radius, log)
    return np.asarray(root @ (mean - design @ _heights(root, radius, mean, log)), float)


def _design(radius: Array, logs: Array) -> Array:
    """Background and a Gaussian of each width, shape (ring, term)."""
    shapes = [np.exp(-0.5 * (radius / width) ** 2) for width in np.exp(logs)]
    return np.stack([np.ones_like(radius), *shapes], axis=1)


def _heights(root: Array, radius: Array, mean: Array, logs: Array) -> Array:
    return np.asarray(np.linalg.lstsq(root @ _design(radius, logs), root @ mean, rcond=None)[0], float)
