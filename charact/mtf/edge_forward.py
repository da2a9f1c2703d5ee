"""The forward method for edges: the whole profile fitted with the noise that is in it, and the posterior of its MTF."""

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import charact
from charact.method import Context, register
from charact.mtf import edge_checks, line
from charact.mtf.curve import FINE, PINNED, REPORTED, curve_of, falls_to
from charact.mtf.edge_fit import EdgeFit, fit, refit
from charact.mtf.edge_profile import Profile, centred, profile_of, refined
from charact.mtf.extent import LEAST_ROWS, extent
from charact.mtf.geometry import orientation_deg
from charact.mtf.optics import Known, halo_of, known_of
from charact.mtf.picture import Picture, mean_picture
from charact.mtf.region import Region
from charact.posterior import has_several_peaks, laplace, sample
from labdata.frames import FrameStack
from labdata.measurement import Measurement, Posterior, Provenance, Result, from_draws, measured, refused

Array = NDArray[np.float64]

QUANTITIES = ("mtf50", "mtf10", "mtf", "edge_angle")
WIDEST_PX = 110.0
# Least gain in chi squared for an edge to be one: a search of frames of noise finds up to about 40.
LEAST_CHI2 = 90.0
# What is no edge at all: chi squared per bin, and its share of that without an edge.
UNLIKE_MISFIT, UNLIKE_SHARE = 1.5, 0.2
MAX_STEPS = 3000
METHOD = "edge-forward"


@register(
    "edge",
    METHOD,
    quantities=QUANTITIES,
    preferred=True,
    scope=(
        "Straight edges tilted 1 to 45 degrees in any direction, step over 1 standard deviation of the pixel noise, "
        "30 rows and more; noise may depend on the signal and be correlated. Broken by motion between fields, "
        "clipping, windows narrower than the blur, and a curved response: on a Gaussian edge of high contrast a gamma "
        "of 0.45 to 2.2 moves MTF50 by -3 to +15 % and is told only where tails or the plateaus' noise show it; at "
        "low contrast it does no harm."
    ),
)
def edge_forward(stack: FrameStack, *, region: Region | None = None, context: Context) -> Result:
    """Measure the MTF across an edge by fitting its profile.

    Parameters
    ----------
    stack
        Frames of one edge; they are averaged.
    region
        ROW, COL, HEIGHT, WIDTH that holds the edge and its plateaus; None: the whole frame.
    context
        Seed, whether a Markov chain is wanted, and the camera.

    Returns
    -------
    Result
        `mtf50`, `mtf10`, `mtf` at pinned frequencies and `edge_angle`, the curve "mtf", and the profile as evidence.

    Notes
    -----
    Mean of a pixel at distance d: level + step (E(d) - 1/2) + slopes, E the edge spread of
    aperture x video x exp(-ln 2 (f/f2)^n) x departure x halo. Levels, step and slopes are marginalised in closed form.
    """
    began = time.perf_counter()
    used, where, crowded = only_edge(stack, region, context)
    if min(used.shape[1:]) < 8:
        return _nothing(
            f"an edge needs a region of at least 8 x 8 px, got {where[2]} x {where[3]}", where, context, began
        )
    found = _found(used, context)
    if isinstance(found, str):
        return _nothing(found, where, context, began)
    posterior = _posterior(found.fit, context)
    result = _result(found, posterior, used, where, context, began)
    if not crowded:
        return result
    flags = ("several-targets",) if region is not None else ()
    notes = ("The frame shows more than this edge; the region is the part that was used.",)
    measurements = tuple(m.with_(flags=flags, notes=(*m.notes, *notes)) for m in result.measurements)
    return Result(measurements=measurements, curves=result.curves, evidence=result.evidence)


def only_edge(stack: FrameStack, region: Region | None, context: Context) -> tuple[FrameStack, Region, bool]:
    """Return the frames cut to one edge and its plateaus, where that is, and whether there was more to see."""
    used = stack if region is None else stack.region(*region)
    row, col, height, width = region or (0, 0, *used.shape[1:])
    if min(height, width) < 2 * LEAST_ROWS:
        return used, (row, col, height, width), False
    picture, coarse = line.find(mean_picture(used.data, context.pitch_ratio))
    part = extent(picture, coarse)
    if part is None:
        return used, (row, col, height, width), False
    return used.region(*part), (row + part[0], col + part[1], part[2], part[3]), True


@dataclass(frozen=True, kw_only=True)
class Found:
    """An edge found and fitted."""

    picture: Picture
    rows: line.RowFit
    profile: Profile
    known: Known
    fit: EdgeFit


def _found(used: FrameStack, context: Context) -> Found | str:
    """Find and fit the edge; a sentence where there is none."""
    picture, coarse = line.find(mean_picture(used.data, context.pitch_ratio))
    rows = line.refine(picture, coarse)
    rows = replace(rows, line=centred(picture, rows.line))
    profile = profile_of(picture, rows.line, WIDEST_PX)
    if not profile.step > 0 or profile.gathered.half_width_px < 3:
        return "no target: no step from dark to bright was found in the region"
    known = known_of(picture, profile.angle_rad, context)
    halo, certain = halo_of(picture, profile.gathered.half_width_px, context)
    first = fit(profile, known, halo=halo, halo_certain=certain)
    if first.chi2 / first.free < edge_checks.MISFIT:
        profile = refined(profile, picture, first.profile[0])
        first = refit(profile, first)
    reason = _no_edge(first)
    if reason:
        return reason
    half = float(np.exp(first.point[1]))
    if profile.gathered.half_width_px < 0.6 / half:
        return (
            f"no target: the blur is wider than the region, which ends {profile.gathered.half_width_px:.0f} px from it"
        )
    return Found(picture=picture, rows=rows, profile=profile, known=known, fit=first)


def _no_edge(found: EdgeFit) -> str | None:
    """Return why the best step in a region is none, if so.

    Where even it does not describe the profile, noise is larger than was thought; where it leaves more than a fifth
    unexplained besides, what varies across the region is something else.
    """
    misfit = max(found.chi2 / found.free, 1.0)
    sd = np.sqrt(max((found.chi2_without - found.chi2) / misfit, 0.0))
    if sd**2 < LEAST_CHI2:
        return (
            f"no target: the best step in the region stands {sd:.1f} standard errors out of the noise, fewer than 9.5"
        )
    left = found.chi2 / found.chi2_without
    if misfit > UNLIKE_MISFIT and left > UNLIKE_SHARE:
        return f"no target: the best step in the region leaves {100 * left:.0f} % of what varies across it unexplained"
    return None


def _posterior(fit: EdgeFit, context: Context) -> Posterior:
    """Draw from the posterior: by Markov chain, or quickly from the curvature."""
    model = fit.model
    asked = {"names": model.names, "units": model.units, "start": fit.point, "covariance": fit.covariance}
    if context.quick:
        return laplace(model.log_probability, **asked, seed=context.seed, bounds=model.bounds)
    return sample(model.log_probability, **asked, seed=context.seed, bounds=model.bounds, max_steps=MAX_STEPS)


def _result(
    found: Found, posterior: Posterior, used: FrameStack, where: Region, context: Context, began: float
) -> Result:
    """Return the measurements, the curve and the evidence of a fitted edge."""
    model, known = found.fit.model, found.known
    fine = model.mtf(posterior.draws, FINE, np.abs(known(FINE)))
    half = float(np.nanmedian(falls_to(FINE, fine, 0.5)))
    full_scale = context.full_scale_dn or used.full_scale_dn
    flags = (
        *edge_checks.picture_flags(used.data, full_scale),
        *edge_checks.line_flags(found.picture, found.rows),
        *edge_checks.fit_flags(found.picture, found.profile, found.fit, half if half > 0 else 0.01),
        *edge_checks.response_flags(found.profile, found.fit),
        *edge_checks.noise_flags(found.profile, found.picture, used.black_level_dn),
        *_posterior_flags(posterior, context),
    )
    common = {
        "method": METHOD,
        "flags": flags,
        "notes": _notes(found, used, context),
        "region": where,
        "orientation_deg": orientation_deg(found.picture, found.profile.angle_rad),
        "provenance": Provenance(
            version=charact.__version__, seed=context.seed, settings={"quick": context.quick, "widest_px": WIDEST_PX}
        ),
    }
    measurements = [
        _level("mtf50", 0.5, fine, posterior, common),
        _level("mtf10", 0.1, fine, posterior, common),
        *(_pinned(f, model.mtf(posterior.draws, np.array([f]), np.abs(known(np.array([f])))), common) for f in PINNED),
        _angle(found, common),
    ]
    at = np.maximum(REPORTED, 1e-6)
    curve = curve_of(REPORTED, model.mtf(posterior.draws, at, np.abs(known(at))))
    seconds = time.perf_counter() - began
    return Result(
        measurements=tuple(m.with_(seconds=seconds) for m in measurements),
        curves={"mtf": curve},
        evidence={"edge-spread": _edge_spread(found)},
    )


def _level(quantity: str, level: float, fine: Array, posterior: Posterior, common: dict) -> Measurement:
    """Return the frequency at which the MTF falls to a level; refused where it does not below 1.5 cy/px."""
    draws = falls_to(FINE, fine, level)
    lost = float(np.mean(~np.isfinite(draws)))
    if lost > 0.02:
        rest = {key: value for key, value in common.items() if key != "flags"}
        reason = (
            f"the MTF must fall to {level:g} below {FINE[-1]:.1f} cy/px, and {100 * lost:.0f} % of its draws do not"
        )
        return refused(quantity, "cy/px", reason, **rest, flags=common["flags"])
    kept = draws[np.isfinite(draws)]
    return from_draws(quantity, "cy/px", kept, posterior=posterior, **_with_peaks(common, kept))


def _pinned(frequency: float, draws: Array, common: dict) -> Measurement:
    """Return the MTF at one frequency."""
    one = draws[:, 0]
    return from_draws("mtf", "1", one, frequency_cy_per_px=float(frequency), **_with_peaks(common, one))


def _posterior_flags(posterior: Posterior, context: Context) -> tuple[str, ...]:
    """Return what of the posterior's distrust reaches what is measured: peaks count where the quantity has them."""
    known = {"several-modes", *(() if context.sensor is None else ("prior-bound",))}
    return tuple(flag for flag in posterior.flags if flag not in known)


def _with_peaks(common: dict, draws: Array) -> dict:
    """Return what measurements share, flagged where the draws of this one have several peaks."""
    if not has_several_peaks(draws[:, None]):
        return common
    return {**common, "flags": (*common["flags"], "several-modes")}


def _angle(found: Found, common: dict) -> Measurement:
    """Return the tilt of the edge to the grid axis nearest to it, degrees, from the scatter of its rows."""
    rows = np.flatnonzero(np.isfinite(found.rows.offset))
    spread = found.rows.offset_sd * np.sqrt(max(found.profile.grain.covariance_over_variance, 1.0))
    error = spread / np.sqrt(max(float(np.sum((rows - rows.mean()) ** 2)), 1.0)) if rows.size > 2 else 45.0
    error = float(np.rad2deg(error / found.picture.pitch_ratio))
    value = abs(float(np.rad2deg(found.profile.angle_rad)))
    halves = [(value - k * error, value + k * error) for k in (0.994458, 1.959964)]
    return measured("edge_angle", "deg", value, *halves, **{**common, "notes": ()})


def _notes(found: Found, used: FrameStack, context: Context) -> tuple[str, ...]:
    """Return what a reader may want to know and what lowers no trust."""
    grain, half = found.profile.grain.covariance_over_variance, found.profile.gathered.half_width_px
    notes = list(used.notes)
    if grain > 1.3 or grain < 0.8:
        notes.append(f"Noise is correlated between pixels (sum of correlations {grain:.1f}) and treated as such.")
    if found.fit.model.halo is None:
        notes.append(f"Normalised to the light within {half:.0f} px of the edge; a wider halo would not be seen.")
    if context.sensor is None and context.pitch_ratio == 1.0:
        notes.append("Pixels taken as square.")
    if found.profile.shading_sd > 0:
        notes.append(f"The plateaus undulate by {found.profile.shading_sd:.2g} DN, which widens the intervals.")
    return tuple(notes)


def _edge_spread(found: Found) -> dict:
    """Return the profile, the model and what is left, as numbers for a figure."""
    profile, (model, amplitude) = found.profile, found.fit.profile
    return {
        "figure": "edge-spread",
        "distance_px": profile.distance.tolist(),
        "value_dn": profile.value.tolist(),
        "sd_dn": np.sqrt(np.diag(profile.covariance)).tolist(),
        "model_dn": model.tolist(),
        "residual_dn": (profile.value - model).tolist(),
        "step_dn": float(amplitude[0]),
        "chi_squared": found.fit.chi2,
        "degrees_of_freedom": found.fit.free,
        "orientation_deg": orientation_deg(found.picture, profile.angle_rad),
    }


def _nothing(reason: str, where: Region, context: Context, began: float) -> Result:
    """Return the refusal of all that an edge gives."""
    flags = ("no-target",) if reason.startswith("no target") else ("window-too-small",)
    provenance = Provenance(version=charact.__version__, seed=context.seed)
    seconds = time.perf_counter() - began
    common = {"method": METHOD, "flags": flags, "region": where, "seconds": seconds, "provenance": provenance}
    units = {"mtf50": "cy/px", "mtf10": "cy/px", "edge_angle": "deg"}
    return Result(measurements=tuple(refused(name, unit, reason, **common) for name, unit in units.items()))
