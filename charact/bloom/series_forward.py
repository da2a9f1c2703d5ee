"""Halo, core and glare from one forward model of all levels of a point series, cut codes counted as what they are."""

from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.bloom.blooms import coarse, provenance
from charact.bloom.edge import STEP_SEEN, first_radius
from charact.bloom.finish import finished
from charact.bloom.profile import profile_of, reach_of
from charact.bloom.series.agreement import MISFIT, compared
from charact.bloom.series.choice import Candidate, candidates
from charact.bloom.series.gather import gathered
from charact.bloom.series.likelihood import Solved
from charact.bloom.series.plate import TiringProblem
from charact.bloom.series.shown import forms_evidence, profile_evidence
from charact.bloom.series.spread import encircled, glare, halo_of
from charact.bloom.series.trust import MISFIT_SHARE, is_uneven, own_diameters, why_no_halo
from charact.bloom.spot import DETECTED, Spot, read_spots
from charact.method import Context, register
from charact.posterior import laplace, sample, weighed
from charact.posterior.diagnostics import leans_on_bound
from labdata.measurement import Measurement, Posterior, Result, from_draws, refused
from labdata.session import Session

Array = NDArray[np.float64]

METHOD = "series-forward"
OF_THE_HALO = (("halo_diameter", "px"), ("halo_fraction", "1"), ("halo_plateau", "1/px2"), ("halo_rim", "1"))
# What needs the source's whole light, core included.
OF_ALL_LIGHT = ("halo_fraction", "halo_plateau", "encircled_radius_50", "encircled_radius_90")
# Relative error that forms leave out of a number, of any source and as a multiple of the share of the light by which
# rings are off: the first as closed-form series with wings show it, the second as simulated cameras do.
LEFT_OUT = {
    "halo_fraction": (0.012, 3.0),
    "halo_plateau": (0.012, 3.0),
    "halo_rim": (0.013, 1.0),
    "encircled_radius_50": (0.006, 1.0),
    "encircled_radius_90": (0.015, 1.0),
    "veiling_glare": (0.05, 3.0),
    "plate_saturation_density": (0.03, 6.0),
}
EXTENTS = ("bloom_diameter", "bloom_diameter_background", "bloom_diameter_clip")
# A best fit so near a bound, as a share of the range, is pressed against it.
AT_BOUND = 1e-3
# Share of the farthest ring beyond which a halo is not seen whole.
WHOLE = 0.92
# Walkers of an ensemble: a series takes its time, and its posterior is nearly Gaussian.
WALKERS = 16
# Steps after which a chain is given up: one parameter that the rings hardly know makes it crawl.
MOST_STEPS = 300
# Draws by importance, where a point or a chain takes too long, and how many must be effective.
FIRST_DRAWS, ENOUGH = 2000, 1000.0
# Draws for which the glare is worked out, and what belongs to it as well.
OF_GLARE = 200
LEAKS = "light that leaks through the target beside its pinhole counts as glare"
# Draws for which derived numbers are worked out.
DERIVED = 400
# Degrees of freedom that the noise has at least: rings of single frames tell it, too.
LEAST_FREEDOM = 3
# Standard error below which a level's own diameter counts as no better.
LEAST_SD_PX = 0.1
# Chance of levels' own diameters scattering as they do below which geometry does not hold.
CONSTANT = 1e-4


@register(
    "bloom",
    METHOD,
    quantities=("halo_diameter", "halo_fraction", "bloom_diameter", "streak_length"),
    preferred=True,
    scope="A round source whose halo has an edge that rises above the noise in one level at least; at any saturation.",
)
def series_forward(session: Session, *, context: Context) -> Result:
    """Measure halo, encircled light, glare, bloom diameters and streaks of a point series.

    Parameters
    ----------
    session
        Session with stacks of kind "point".
    context
        Seed and settings; the sensor, where known, gives pitches and the core's prior.

    Notes
    -----
    Cores (Gaussian, a tube's, Gaussian with a Moffat wing) and halos (none, a disc of bounced electrons, Gaussian) are
    fitted to ring means of all levels together; the Bayesian information criterion chooses. Each level's light and
    background are its own. A halo is told only where the disc is clearly the best and its edge is tied to one place.
    """
    began = perf_counter()
    spots = read_spots(session, context=context)
    fields: dict[str, Any] = {"method": METHOD, "provenance": provenance(context)}
    told = _told(session, spots, context, fields)
    result = finished(session, spots, told.measurements, told.evidence, began=began, context=context, **fields)
    return result if told.best is None else _agreeing(result, told.best, told.group)


@dataclass(frozen=True, kw_only=True)
class _Told:
    """What a series says of all its stacks together, and by which form of which stacks."""

    measurements: list[Measurement]
    evidence: dict[str, Any]
    best: Candidate | None = None
    group: tuple[Spot, ...] = ()


def _agreeing(result: Result, best: Candidate, group: tuple[Spot, ...]) -> Result:
    """Hold extents against the fitted light; where that fits no ring, none that it shows is sure."""
    if best.problem.model_share <= MISFIT_SHARE and not is_uneven(best.problem.series):
        return replace(result, measurements=compared(best, group, result.measurements))
    labels = {one.label for one in group}
    told = (
        one.with_(flags=MISFIT) if one.quantity in EXTENTS and one.stack in labels else one
        for one in result.measurements
    )
    return replace(result, measurements=tuple(told))


def _told(session: Session, spots: tuple[Spot, ...], context: Context, fields: dict[str, Any]) -> _Told:
    """What the series says, and what the report draws of it."""
    clear = tuple(spot for spot in spots if spot.significance > DETECTED)
    if not clear:
        return _Told(measurements=_refused("no point source stands out of its surroundings", fields), evidence={})
    found = gathered(session, clear, context=context)
    if isinstance(found, str):
        return _Told(measurements=_refused(found, fields), evidence={})
    series, group = found
    context.progress("forms of the source's light", 0.5)
    radius, seen = first_radius([profile_of(spot, reach_of(spot), context=context) for spot in group])
    forms = candidates(series, pitch_ratio=context.pitch_ratio, sensor=context.sensor,
                       first_diameter_px=2 * radius if seen > STEP_SEEN else float("nan"))  # fmt: skip
    best = forms[0]
    context.progress("posterior of the series", 0.8)
    posterior = _posterior(best, context)
    reason = why_no_halo(forms)
    own = own_diameters(best) if reason is None else None
    flags = _flags(best, posterior, own) + coarse(min(group, key=lambda one: one.full_scale_dn - one.dark_dn))
    notes = _notes(context, group, spots)
    said = _refused(reason or "", fields) if own is None else _halo(best, posterior, own, group, flags, notes, fields)
    said += _spread(best, posterior, flags, notes, fields) + _glare(best, posterior, group, flags, notes, fields)
    said += _plate(best, posterior, flags, notes, fields)
    evidence = profile_evidence(best, posterior, own) | forms_evidence(forms, quick=context.quick)
    return _Told(measurements=said, evidence=evidence, best=best, group=group)


def _refused(reason: str, fields: dict[str, Any]) -> list[Measurement]:
    return [refused(quantity, unit, reason, **fields) for quantity, unit in OF_THE_HALO]


def _posterior(best: Candidate, context: Context) -> Posterior:
    """Draws of the best form's parameters."""
    asked: dict[str, Any] = {
        "names": best.form.names,
        "units": best.form.units,
        "start": best.peak.point,
        "covariance": best.peak.covariance,
        "seed": context.seed,
        "bounds": best.form.bounds,
    }
    if context.quick:
        return laplace(best.problem.log_probability, **asked)
    if not isinstance(best.problem, TiringProblem):
        walkers = max(WALKERS, 2 * len(best.form.names))
        chain = sample(best.problem.log_probability, walkers=walkers, max_steps=MOST_STEPS, **asked)
        if "not-converged" not in chain.flags:
            return chain
    return weighed(best.problem.log_probability, enough=ENOUGH, first_draws=FIRST_DRAWS, **asked)


def _flags(best: Candidate, posterior: Posterior, own: tuple[Array, Array, Array] | None) -> tuple[str, ...]:
    """What speaks against the numbers; bounds of nuisance parameters harm nothing."""
    from scipy.stats import chi2

    flags = tuple(flag for flag in posterior.flags if flag != "prior-bound")
    series = best.problem.series
    if best.problem.model_share > MISFIT_SHARE or is_uneven(series):
        flags += ("model-misfit",)
    if own is None:
        return flags
    if np.quantile(posterior["elastic_share"], 0.025) < 0.0:
        # Without electrons that keep their energy a halo has no rim: it fades out, and wings shift where it ends.
        flags += ("prior-bound",)
    diameter = float(np.median(posterior["halo_diameter"]))
    if diameter / 2.0 > WHOLE * series.radius_px[-1]:
        flags += ("window-too-small",)
    apart, freedom = _apart(own, diameter)
    return flags + (("model-misfit",) if freedom and chi2.sf(apart, freedom) < CONSTANT else ())


def _apart(own: tuple[Array, Array, Array], diameter: float) -> tuple[float, int]:
    """How far the levels' own diameters lie from a common one, as chi squared with its freedom."""
    seen = np.isfinite(own[0])
    pull = (own[0][seen] - diameter) / np.maximum(own[1][seen], LEAST_SD_PX)
    return float(pull @ pull), max(int(seen.sum()) - 1, 0)


def _notes(context: Context, group: tuple[Spot, ...], spots: tuple[Spot, ...]) -> tuple[str, ...]:
    notes = ("the row pitch is unknown: pixels are taken as square",) if context.sensor is None else ()
    if len(group) < len(spots):
        notes += (f"{len(group)} of {len(spots)} stacks show a source in one place, the others are left out",)
    return notes


def _halo(best: Candidate, posterior: Posterior, own: tuple[Array, Array, Array], group: tuple[Spot, ...],
          flags: tuple[str, ...], notes: tuple[str, ...], fields: dict[str, Any]) -> list[Measurement]:  # fmt: skip
    """The halo's diameter, share, plateau and rim; the diameter's interval is wider where levels scatter more."""
    middle = float(np.median(posterior["halo_diameter"]))
    apart, freedom = _apart(own, middle)
    wider = np.sqrt(max(1.0, apart / freedom)) if freedom else 1.0
    wider = wider * _noise_unknown(group, len(posterior.draws), posterior.seed)
    draws = {"halo_diameter": middle + wider * (posterior["halo_diameter"] - middle)}
    draws |= {"halo_fraction": posterior["halo_fraction"]}
    halo = halo_of(best.form, posterior.draws[:DERIVED])
    draws |= {"halo_plateau": halo.plateau, "halo_rim": halo.rim}
    for quantity in ("halo_fraction", "halo_plateau", "halo_rim"):
        draws[quantity] = draws[quantity] * _as_told(best, quantity, len(draws[quantity]), posterior)
    blind = flags if shows_core(best, posterior) else (*flags, "prior-bound")
    return [
        from_draws(quantity, unit, draws[quantity], flags=blind if quantity in OF_ALL_LIGHT else flags, notes=notes,
                   posterior=posterior, **fields)
        for quantity, unit in OF_THE_HALO
    ]  # fmt: skip


def _noise_unknown(group: tuple[Spot, ...], draws: int, seed: int | None) -> Array:
    """Factors for a noise that is itself known from so many frames only (Student's), shape (draw,)."""
    freedom = max(min(one.frames for one in group) - 1, LEAST_FREEDOM)
    return np.sqrt(freedom / np.random.default_rng(seed).chisquare(freedom, draws))


def _as_told(best: Candidate, quantity: str, draws: int, posterior: Posterior) -> Array:
    """Factors for what a form leaves out of a quantity: that of any, and that of a source that is not round."""
    of_any, of_round = LEFT_OUT[quantity]
    sd = np.hypot(of_any, of_round * best.problem.model_share)
    return np.exp(sd * np.random.default_rng(posterior.seed).standard_normal(draws))


def shows_core(best: Candidate, posterior: Posterior) -> bool:
    """Whether the source's whole light is known: where every core is cut, it may be anything that makes its halo."""
    if best.form.halo == "none":
        return True
    share = best.form.names.index("halo_fraction")
    bounds = best.form.bounds[[share]]
    pressed = np.abs(bounds - best.peak.point[share]).min() < AT_BOUND * np.ptp(bounds)
    return not pressed and not leans_on_bound(posterior.draws[:, [share]], bounds).any()


def _spread(best: Candidate, posterior: Posterior, flags: tuple[str, ...], notes: tuple[str, ...],
            fields: dict[str, Any]) -> list[Measurement]:  # fmt: skip
    """Radii that hold half and nine tenths of the light."""
    reach = float(best.problem.series.radius_px[-1])
    radii = encircled(best.form, posterior.draws[:DERIVED], (0.5, 0.9), reach)
    flags = flags if shows_core(best, posterior) else (*flags, "prior-bound")
    out = []
    for quantity, draws in zip(("encircled_radius_50", "encircled_radius_90"), radii.T, strict=True):
        if np.isnan(draws).any():
            reason = f"some of this light lies beyond the {reach:.0f} px about the source that were looked at"
            out.append(refused(quantity, "px", reason, **fields))
        else:
            draws = draws * _as_told(best, quantity, len(draws), posterior)
            out.append(from_draws(quantity, "px", draws, flags=flags, notes=notes, **fields))
    return out


def _glare(best: Candidate, posterior: Posterior, group: tuple[Spot, ...], flags: tuple[str, ...],
           notes: tuple[str, ...], fields: dict[str, Any]) -> list[Measurement]:  # fmt: skip
    """Light of the source that lies evenly over the frame, from the backgrounds of all levels."""
    settings = {(one.conditions.mcp_v, one.conditions.camera_gain_db, one.conditions.gain_control) for one in group}
    if len(settings) > 1:
        return [refused("veiling_glare", "%", "the levels were taken at different gains", **fields)]
    solved = best.problem.solved(posterior.draws[:OF_GLARE])
    rows, cols = group[0].image.shape
    area = rows * cols * best.form.pitch_ratio
    sd = _background_sd(solved)
    found = [
        glare(light, background, error, area)
        for light, background, error in zip(solved.amplitudes[:, 0].T, solved.amplitudes[:, 1].T, sd.T, strict=True)
    ]
    told = np.array([one for one in found if one is not None])
    if not len(told):
        return [refused("veiling_glare", "%", "the backgrounds of three levels at least would tell it", **fields)]
    rng = np.random.default_rng(posterior.seed)
    draws = 100.0 * (told[:, 0] + told[:, 1] * rng.standard_normal(len(told)))
    draws = draws * _as_told(best, "veiling_glare", len(draws), posterior)
    return [from_draws("veiling_glare", "%", draws, flags=flags, notes=(*notes, LEAKS), **fields)]


def _plate(best: Candidate, posterior: Posterior, flags: tuple[str, ...], notes: tuple[str, ...],
           fields: dict[str, Any]) -> list[Measurement]:  # fmt: skip
    """Density of light at which the plate's gain has halved, and what is left of each level's light behind it."""
    if not isinstance(best.problem, TiringProblem):
        reason = "cores keep their share of the light at all levels: a plate at rest says all they show"
        return [refused("plate_saturation_density", "DN", reason, **fields)]
    load = best.form.names.index("plate_load")
    if leans_on_bound(posterior.draws[:, [load]], best.form.bounds[[load]]).any():
        flags = (*flags, "prior-bound")
    density = 1.0 / np.maximum(posterior["plate_load"], 1e-9)
    density = density * _as_told(best, "plate_saturation_density", len(density), posterior)
    out = [from_draws("plate_saturation_density", "DN", density, flags=flags, notes=notes, **fields)]
    left = best.problem.compression(posterior.draws[:DERIVED])
    for label, draws in zip(best.problem.series.labels, left, strict=True):
        out.append(from_draws("core_compression", "1", draws, flags=flags, stack=label, **fields))
    return out


def _background_sd(solved: Solved) -> Array:
    """Standard error of each level's background, shape (level, point)."""
    normal = solved.normal
    determinant = normal[:, 0, 0] * normal[:, 1, 1] - normal[:, 0, 1] ** 2
    return np.sqrt(np.maximum(normal[:, 0, 0] / np.maximum(determinant, 1e-300), 1e-12))
