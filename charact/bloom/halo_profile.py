"""Halo diameter from a forward model of all radial profiles of a point series at once."""

from time import perf_counter
from typing import Any

import numpy as np

from charact.bloom.blooms import bloom_measurements, provenance, series_evidence
from charact.bloom.edge import STEP_SEEN, first_radius
from charact.bloom.fit import HaloFit, fit, own_diameter, problem_of
from charact.bloom.model import optics_of, shapes
from charact.bloom.profile import Profile, profile_of, reach_of
from charact.bloom.spot import DETECTED, Spot, read_spots
from charact.method import Context, register
from labdata.measurement import Measurement, Result, from_draws, refused
from labdata.sensor import Sensor
from labdata.session import Session

METHOD = "halo-profile"
# The profile is fitted out to this many halo radii: far enough for the pedestal, not so far as the next thing.
OUTER = 1.6
# A level serves where at least so many rings inside the halo are not saturated.
RINGS_INSIDE = 4
# Elastic share below which the halo has no rim and fades out towards its edge, so that the edge is a guess.
LEAST_RIM = 0.02
# Share by which a round halo may seem wider in one direction than in the other.
ROUND_SHARE = 0.02


@register(
    "bloom",
    METHOD,
    quantities=("halo_diameter", "bloom_diameter", "streak_length"),
    preferred=True,
    scope="A point source whose halo has a rim and rises above the noise in one level at least, far from the border.",
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
    out = [halo, *bloom_measurements(spots, square=context.sensor is None, sensor=context.sensor, **fields)]
    seconds = perf_counter() - began
    own = evidence.get("halo-constancy")
    halos = dict(zip(own["label"], own["halo_diameter_px"], strict=True)) if own else {}
    series = {"bloom-series": series_evidence(spots, halos)}
    return Result(measurements=tuple(m.with_(seconds=seconds) for m in out), evidence=series | evidence)


def _halo(spots: tuple[Spot, ...], context: Context, fields: dict[str, Any]) -> tuple[Measurement, dict[str, Any]]:
    """The halo of a series and what the report draws of it."""
    clear = [spot for spot in spots if spot.significance > DETECTED]
    if not clear:
        return refused("halo_diameter", "px", "no point source stands out of its surroundings", **fields), {}
    wide = [profile_of(spot, reach_of(spot), context=context) for spot in clear]
    radius, significance = first_radius(wide)
    if significance < STEP_SEEN and context.sensor is not None:
        # A peaked halo has a soft edge: the fit looks where the sheet's gap puts it.
        radius, significance = 0.5 * _expected_diameter_px(context.sensor), STEP_SEEN
    if significance < STEP_SEEN:
        reason = "no profile has a step that stands out of its noise: no halo is visible"
        return refused("halo_diameter", "px", reason, **fields), _profile_evidence(wide, None, radius)
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
        return refused("halo_diameter", "px", reason, **fields), _profile_evidence(serving, None, radius)
    flags = _flags(found, reach)
    if context.sensor is None:
        best = clear[[spot.label for spot in clear].index(problem.labels[int(np.argmax(found.significance))])]
        flags += _roundness(best, found, reach, context)
    halo = from_draws("halo_diameter", "px", found.posterior["halo_diameter"], posterior=found.posterior, flags=flags,
                      notes=_notes(context), **fields)  # fmt: skip
    evidence = _profile_evidence(serving, found, radius) | {"halo-constancy": _constancy(found, problem.labels)}
    return halo, evidence


def _expected_diameter_px(sensor: Sensor) -> float:
    """Four gaps as the sheet states them, column pitches."""
    pitch_um = float(sensor.ccd.pitch_x_um) * float(sensor.taper.demagnification)
    return 4e3 * float(sensor.photocathode.gap_mm) / pitch_um


def _notes(context: Context) -> tuple[str, ...]:
    return ("the row pitch is unknown: pixels are taken as square",) if context.sensor is None else ()


def _flags(found: HaloFit, reach: int) -> tuple[str, ...]:
    """What the fit says against its number; bounds of nuisance parameters harm nothing, a missing rim does."""
    from scipy.stats import chi2

    flags = tuple(flag for flag in found.posterior.flags if flag != "prior-bound")
    if chi2.sf(found.chi2, found.freedom) < 1e-4:
        flags += ("model-misfit",)
    if found.point[0] > 1.7 * reach:
        flags += ("window-too-small",)
    if np.quantile(found.posterior["elastic_share"], 0.16) < LEAST_RIM:
        flags += ("prior-bound",)
    own = np.isfinite(found.diameters)
    if own.sum() > 1:
        pull = (found.diameters[own] - found.point[0]) / np.maximum(found.diameter_sd[own], 0.05)
        if chi2.sf(float(pull @ pull), int(own.sum()) - 1) < 1e-4:
            flags += ("model-misfit",)
    return flags


def _roundness(spot: Spot, found: HaloFit, reach: int, context: Context) -> tuple[str, ...]:
    """A flag where the halo is wider along rows than along columns: then pixels are not square after all."""
    wide, tall = (
        own_diameter(problem_of([profile_of(spot, reach, context=context, along=along)], reach, context=context), 0,
                     found.point)
        for along in ("rows", "columns")
    )  # fmt: skip
    apart = abs(wide[0] - tall[0])
    return ("model-misfit",) if apart > max(4.0 * np.hypot(wide[1], tall[1]), ROUND_SHARE * found.point[0]) else ()


def _profile_evidence(profiles: list[Profile], found: HaloFit | None, radius: float) -> dict[str, Any]:
    """Radial profiles of the levels with their joint fit."""
    data: dict[str, Any] = {
        "figure": "point-profile",
        "label": [profile.label for profile in profiles],
        "radius_px": [profile.radius_px.tolist() for profile in profiles],
        "mean_dn": [profile.mean_dn.tolist() for profile in profiles],
        "sd_dn": [profile.sd_dn.tolist() for profile in profiles],
        "used": [profile.used.tolist() for profile in profiles],
        "steepest_radius_px": None if np.isnan(radius) else radius,
    }
    if found is None:
        return {"point-profile": data}
    core, pedestal, halo = found.amplitudes.T
    fitted = {
        "halo_diameter_px": float(np.median(found.posterior["halo_diameter"])),
        "elastic_share": float(np.median(found.posterior["elastic_share"])),
        "model_dn": [_model(profile, found, one).tolist() for one, profile in enumerate(profiles)],
        "pedestal_dn": pedestal.tolist(),
        "halo_share": np.where(core + halo > 0, halo / np.where(core + halo > 0, core + halo, 1.0), 0.0).tolist(),
        "chi2": found.chi2,
        "freedom": found.freedom,
    }
    return {"point-profile": data | fitted}


def _constancy(found: HaloFit, labels: tuple[str, ...]) -> dict[str, Any]:
    """Each level's own diameter beside that of all: geometry fixes it whatever the light."""
    seen = np.isfinite(found.diameters)
    own, sd = found.diameters[seen], found.diameter_sd[seen]
    weight = 1.0 / np.maximum(sd, 1e-6) ** 2
    mean = float(weight @ own / weight.sum()) if len(own) else None
    return {
        "figure": "halo-constancy",
        "label": [label for label, one in zip(labels, seen, strict=True) if one],
        "halo_diameter_px": own.tolist(),
        "interval95_px": np.stack([own - 1.96 * sd, own + 1.96 * sd], axis=1).tolist(),
        "significance": found.significance[seen].tolist(),
        "joint_px": float(np.median(found.posterior["halo_diameter"])),
        "joint_elastic_share": float(np.median(found.posterior["elastic_share"])),
        "chi2_of_constancy": float(weight @ (own - mean) ** 2) if mean is not None else None,
        "freedom": max(0, len(own) - 1),
        "fit_chi2": found.chi2,
        "fit_freedom": found.freedom,
    }


def _model(profile: Profile, found: HaloFit, one: int) -> np.ndarray:
    """The best fit on every ring, saturated ones included."""
    core, disc = shapes(found.point[None], optics_of(profile.radius_px))
    amplitude = found.amplitudes[one]
    return amplitude[0] * core[0] + amplitude[1] + amplitude[2] * disc[0]
