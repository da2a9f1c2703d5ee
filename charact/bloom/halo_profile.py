"""Halo diameter from a forward model of all radial profiles of a point series at once."""

from time import perf_counter
from typing import Any

import numpy as np

from charact.bloom.blooms import bloom_measurements, provenance, series_evidence
from charact.bloom.edge import STEP_SEEN, first_radius
from charact.bloom.fit import HaloFit, fit, problem_of
from charact.bloom.model import optics_of, shapes
from charact.bloom.profile import Profile, profile_of
from charact.bloom.spot import DETECTED, Spot, read_spots
from charact.bloom.threshold import reach_of
from charact.method import Context, register
from labdata.measurement import Measurement, Result, from_draws, refused
from labdata.session import Session

METHOD = "halo-profile"
# The profile is fitted out to this many halo radii: far enough for the pedestal, not so far as the next thing.
OUTER = 1.6
# A level serves where at least so many rings inside the halo are not saturated.
RINGS_INSIDE = 4


@register(
    "bloom",
    METHOD,
    quantities=("halo_diameter", "bloom_diameter", "streak_length"),
    scope="A point source whose halo rises above the noise in one level at least; the source far from the border.",
)
def halo_profile(session: Session, *, context: Context) -> Result:
    """Measure halo diameter, bloom diameters and streaks.

    Parameters
    ----------
    session
        Session with stacks of kind "point".
    context
        Seed and settings; the sensor, where known, gives pitches and the core's prior.

    Notes
    -----
    Saturated rings and those next to them are left out (they say "at least this bright"); amplitudes of core, halo
    and pedestal are each level's own, so that a core that saturates or tires moves nothing else.
    """
    began = perf_counter()
    spots = read_spots(session, context=context)
    fields: dict[str, Any] = {"method": METHOD, "provenance": provenance(context)}
    halo, evidence = _halo(spots, context, fields)
    out = [halo, *bloom_measurements(spots, square=context.sensor is None, **fields)]
    seconds = perf_counter() - began
    return Result(measurements=tuple(m.with_(seconds=seconds) for m in out),
                  evidence={"bloom-series": series_evidence(spots), **evidence})  # fmt: skip


def _halo(spots: tuple[Spot, ...], context: Context, fields: dict[str, Any]) -> tuple[Measurement, dict[str, Any]]:
    """The halo of a series and what the report draws of it."""
    clear = [spot for spot in spots if spot.significance > DETECTED]
    if not clear:
        return refused("halo_diameter", "px", "no point source stands out of its surroundings", **fields), {}
    wide = [profile_of(spot, reach_of(spot), context=context) for spot in clear]
    radius, significance = first_radius(wide)
    if significance < STEP_SEEN:
        reason = "no profile has a step that stands out of its noise: no halo is visible"
        return refused("halo_diameter", "px", reason, **fields), _profile_evidence(wide, None, None, context)
    reach = int(np.clip(OUTER * radius, 16, min(map(reach_of, clear))))
    profiles = [profile_of(spot, reach, context=context) for spot in clear]
    serving = [
        p for p in profiles if p.used[: int(0.85 * radius)].sum() >= RINGS_INSIDE and p.used[-RINGS_INSIDE:].all()
    ]
    if not serving:
        return refused("halo_diameter", "px", "every level saturates the inside of the halo", **fields), {}
    context.progress("posterior of the halo", 0.9)
    problem = problem_of(serving, reach, context=context)
    found = fit(problem, seed=context.seed, quick=context.quick, first_diameter_px=2 * radius)
    if found is None:
        reason = "the profiles show no disc with an edge: no halo is visible"
        return refused("halo_diameter", "px", reason, **fields), _profile_evidence(serving, None, None, context)
    flags = _flags(found, reach, all(spot.dark_known for spot in clear))
    halo = from_draws("halo_diameter", "px", found.posterior["halo_diameter"], posterior=found.posterior, flags=flags,
                      notes=_notes(context), **fields)  # fmt: skip
    return halo, _profile_evidence(serving, found, problem.labels, context)


def _notes(context: Context) -> tuple[str, ...]:
    return ("the row pitch is unknown: pixels are taken as square",) if context.sensor is None else ()


def _flags(found: HaloFit, reach: int, darks: bool) -> tuple[str, ...]:
    """What the fit says against its number; the elastic share may well lie on its bound, and harms nothing there."""
    from scipy.stats import chi2

    flags = tuple(flag for flag in found.posterior.flags if flag != "prior-bound")
    if chi2.sf(found.chi2, found.freedom) < 1e-4:
        flags += ("model-misfit",)
    if found.point[0] > 1.7 * reach:
        flags += ("window-too-small",)
    own = np.isfinite(found.diameters)
    if own.sum() > 1:
        pull = (found.diameters[own] - found.point[0]) / np.maximum(found.diameter_sd[own], 0.05)
        if chi2.sf(float(pull @ pull), int(own.sum()) - 1) < 1e-4:
            flags += ("model-misfit",)
    return flags


def _profile_evidence(profiles: list[Profile], found: HaloFit | None, labels, context: Context) -> dict[str, Any]:
    """Radial profiles with their fits, and each level's own diameter."""
    data: dict[str, Any] = {
        "figure": "point-profile",
        "label": [p.label for p in profiles],
        "radius_px": [p.radius_px.tolist() for p in profiles],
        "mean_dn": [p.mean_dn.tolist() for p in profiles],
        "sd_dn": [p.sd_dn.tolist() for p in profiles],
        "used": [p.used.tolist() for p in profiles],
    }
    if found is None:
        return {"point-profile": data}
    data["halo_diameter_px"] = float(np.median(found.posterior["halo_diameter"]))
    data["elastic_share"] = float(np.median(found.posterior["elastic_share"]))
    data["model_dn"] = [_model(p, found, i).tolist() for i, p in enumerate(profiles)]
    data["chi2"], data["freedom"] = found.chi2, found.freedom
    data["halo_share"] = [
        float(halo / (core + halo)) if core + halo > 0 else None for core, _, halo in found.amplitudes
    ]
    levels = {
        "figure": "halo-constancy",
        "label": list(labels),
        "halo_diameter_px": [None if np.isnan(d) else float(d) for d in found.diameters],
        "interval95_px": [
            None if np.isnan(d) else [float(d - 1.96 * s), float(d + 1.96 * s)]
            for d, s in zip(found.diameters, found.diameter_sd, strict=True)
        ],
        "significance": found.significance.tolist(),
    }
    return {"point-profile": data, "halo-constancy": levels}


def _model(profile: Profile, found: HaloFit, one: int) -> np.ndarray:
    """The best fit on every ring, saturated ones included."""
    core, disc = shapes(found.point[None], optics_of(profile.radius_px))
    amplitude = found.amplitudes[one]
    return amplitude[0] * core[0] + amplitude[1] + amplitude[2] * disc[0]
