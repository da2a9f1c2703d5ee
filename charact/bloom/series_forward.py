"""Halo, core and glare from one forward model of all levels of a point series, cut codes counted as what they are."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.bloom.common_measurements import add_common_measurements
from charact.bloom.extent_measurements import provenance, quantisation_flags
from charact.bloom.halo_edge_step import STEP_SEEN, first_radius
from charact.bloom.point_stack import DETECTED, PointStack, read_point_stacks
from charact.bloom.profile import profile_of, reach_of
from charact.bloom.series.extent_comparison import MISFIT, compare_extents
from charact.bloom.series.figure_data import forms_evidence, profile_evidence
from charact.bloom.series.halo_checks import MISFIT_SHARE, halo_refusal_reason, is_uneven, own_diameters
from charact.bloom.series.model_selection import FittedHaloModel, candidates
from charact.bloom.series.ring_series import build_ring_series
from charact.bloom.series.series_measurements import (
    OF_THE_HALO,
    energy_radius_measurements,
    glare_measurements,
    halo_measurements,
    levels_apart,
    mcp_saturation_measurements,
    nearest_px,
    several_flag,
)
from charact.bloom.thresholds import CUT_SD
from charact.method import Context, register
from charact.posterior import importance_sample, laplace
from labdata.measurement import Measurement, Posterior, Result, make_refusal
from labdata.session import Session

Array = NDArray[np.float64]

METHOD = "series-forward"
EXTENTS = ("bloom_diameter", "bloom_diameter_background", "bloom_diameter_clip")
# Share of the farthest ring beyond which a halo is not seen whole.
WHOLE = 0.92
# Draws by importance of the first density, and how many must be effective; fewer where time is short.
FIRST_DRAWS, ENOUGH, ENOUGH_QUICKLY = 2000, 1000.0, 100.0
# Chance of levels' own diameters scattering as they do below which geometry does not hold.
CONSTANT = 1e-4


@register(
    "bloom",
    METHOD,
    quantities=("halo_diameter", "halo_fraction", "bloom_diameter", "streak_length"),
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
    spots = read_point_stacks(session, context=context)
    fields: dict[str, Any] = {"method": METHOD, "provenance": provenance(context)}
    told = _analyse_series(session, spots, context, fields)
    result = add_common_measurements(session, spots, told.measurements, told.evidence, context=context, **fields)
    return result if told.best is None else _compare_extents(result, told.best, told.group)


@dataclass(frozen=True, kw_only=True)
class _SeriesResult:
    """What a series says of all its stacks together, and by which form of which stacks."""

    measurements: list[Measurement]
    evidence: dict[str, Any]
    best: FittedHaloModel | None = None
    group: tuple[PointStack, ...] = ()


def _compare_extents(result: Result, best: FittedHaloModel, group: tuple[PointStack, ...]) -> Result:
    """Hold extents against the fitted light; where that fits no ring, none that it shows is sure."""
    if best.problem.misfit.share <= MISFIT_SHARE and not is_uneven(best.problem.series):
        return replace(result, measurements=compare_extents(best, group, result.measurements))
    labels = {one.label for one in group}
    told = (
        one.with_(flags=MISFIT) if one.quantity in EXTENTS and one.stack in labels else one
        for one in result.measurements
    )
    return replace(result, measurements=tuple(told))


def _analyse_series(
    session: Session, spots: tuple[PointStack, ...], context: Context, fields: dict[str, Any]
) -> _SeriesResult:
    """What the series says, and what the report draws of it."""
    clear = tuple(spot for spot in spots if spot.significance > DETECTED)
    if not clear:
        return _SeriesResult(
            measurements=_refuse_halo("no point source stands out of its surroundings", fields), evidence={}
        )
    found = build_ring_series(session, clear, context=context)
    if isinstance(found, str):
        return _SeriesResult(measurements=_refuse_halo(found, fields), evidence={})
    series, group = found
    context.progress("forms of the source's light", 0.9)
    has_tube = context.sensor is not None or any(one.conditions.mcp_v is not None for one in group)
    radius, seen = first_radius([profile_of(spot, reach_of(spot), context=context) for spot in group])
    forms = candidates(series, pitch_ratio=context.pitch_ratio, sensor=context.sensor, has_tube=has_tube,
                       first_diameter_px=2 * radius if seen > STEP_SEEN else float("nan"))  # fmt: skip
    best = forms[0]
    context.progress("posterior of the series", 0.95)
    posterior = _posterior(best, context)
    reason = halo_refusal_reason(forms)
    own = own_diameters(best) if reason is None else None
    flags = _flags(best, posterior, own) + quantisation_flags(
        min(group, key=lambda one: one.full_scale_dn - one.dark_dn)
    )
    notes = _notes(context, group, spots)
    if own is None:
        said = _refuse_halo(reason or "", fields)
    else:
        said = halo_measurements(best, posterior, own, group, flags, notes, fields)
    flags += several_flag(group)
    said += energy_radius_measurements(best, posterior, flags, notes, fields)
    said += glare_measurements(best, posterior, group, flags, notes, fields)
    said += mcp_saturation_measurements(forms, posterior, flags, notes, fields) if has_tube else []
    evidence = profile_evidence(best, posterior, own) | forms_evidence(forms, quick=context.quick)
    return _SeriesResult(measurements=said, evidence=evidence, best=best, group=group)


def _refuse_halo(reason: str, fields: dict[str, Any]) -> list[Measurement]:
    return [make_refusal(quantity, unit, reason, **fields) for quantity, unit in OF_THE_HALO]


def _posterior(best: FittedHaloModel, context: Context) -> Posterior:
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
        gaussian = laplace(best.problem.log_probability, **asked)
        if not _is_cut(best, gaussian):
            return gaussian
    enough = ENOUGH_QUICKLY if context.quick else ENOUGH
    return importance_sample(best.problem.log_probability, enough=enough, first_draws=FIRST_DRAWS, **asked)


def _is_cut(best: FittedHaloModel, gaussian: Posterior) -> bool:
    """Whether bounds cut a Gaussian so that its peak is not the middle of its diameters: its width says little then."""
    if best.form.halo != "disc":
        return False
    diameter = gaussian["halo_diameter"]
    away = float(best.peak.point[best.form.names.index("halo_diameter")]) - float(np.median(diameter))
    return abs(away) > CUT_SD * float(np.std(diameter))


def _flags(best: FittedHaloModel, posterior: Posterior, own: tuple[Array, Array, Array] | None) -> tuple[str, ...]:
    """What speaks against the numbers; bounds of nuisance parameters harm nothing."""
    from scipy.stats import chi2

    flags = tuple(flag for flag in posterior.flags if flag != "prior-bound")
    series = best.problem.series
    if best.problem.misfit.share > MISFIT_SHARE or is_uneven(series):
        flags += ("model-misfit",)
    if own is None:
        return flags
    diameter = float(np.median(posterior["halo_diameter"]))
    if diameter / 2.0 > WHOLE * series.radius_px[-1]:
        flags += ("window-too-small",)
    apart, freedom = levels_apart(own)
    return flags + (("model-misfit",) if freedom and chi2.sf(apart, freedom) < CONSTANT else ())


def _notes(context: Context, group: tuple[PointStack, ...], spots: tuple[PointStack, ...]) -> tuple[str, ...]:
    notes = ("the row pitch is unknown: pixels are taken as square",) if context.sensor is None else ()
    if np.isfinite(nearest_px(group)):
        notes += (f"pixels nearer to another source, {nearest_px(group):.0f} px away or more, are left out",)
    if len(group) < len(spots):
        notes += (f"{len(group)} of {len(spots)} stacks show a source in one place, the others are left out",)
    return notes
