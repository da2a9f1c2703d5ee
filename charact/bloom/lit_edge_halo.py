"""Blooming beside extended sources: the halo of a lamp-lit door measured along its edge, all levels together."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.bloom.lit_edge_halo_fit import BESIDES, EdgeHaloLikelihood, EdgeHaloOptimum, optimise_edge_halo, problem_of
from charact.bloom.lit_edge_profile import DARK_PX, LitEdgeLine, Strips, edge_line, strips_of
from charact.method import Context, register
from charact.posterior import importance_sample, laplace
from labdata.errors import BadInput
from labdata.measurement import Measurement, Posterior, Provenance, Result, make_refusal, measurement_from_draws
from labdata.session import Session, StackEntry

Array = NDArray[np.float64]

METHOD = "lit-edge"
QUANTITIES = (("halo_diameter", "px"), ("halo_fraction", "1"))
# Share of full scale over dark above which a lit side no longer shows its light, and by which levels are told apart.
CUT_SHARE = 0.75
# The true edge lies so far from where the frame crosses the level: little where the lit side is not cut, px.
OFFSET_PX, OFFSET_OF_CUT_PX = (-1.5, 1.5), (-10.0, 1.0)
# What a halo must gain in the Bayesian information criterion, and what a diameter off by so much must cost.
GAIN, OFF, OFF_COST = 20.0, (0.75, 1.3), 6.0
# Share of the way to the border that a halo may reach.
WHOLE = 0.85
# Relative standard error beyond which a diameter that leans on cut levels alone is not told.
VAGUE = 0.1
LEAST_STRIPS = 24
MISFIT = 1e-4
# Criterion up to which another core counts, by the weight exp(-criterion / 2).
RIVAL = 10.0


@register(
    "lit-edge",
    METHOD,
    quantities=("halo_diameter", "halo_fraction"),
    scope="A straight edge of a bright area, four times as long as the halo reaches, with dark room beside it; better "
    "with one level that is not cut.",
)
def measure_lit_edge(session: Session, *, context: Context) -> Result:
    """Measure diameter and share of the halo from the edges of a session.

    Parameters
    ----------
    session
        Session with stacks of kind "edge", all of one target at several lights; darks, better.
    context
        Seed and settings.

    Notes
    -----
    Where a level does not reach the highest code it says where the edge is and how bright the lit side; brighter ones
    show the halo. With cut levels alone the place of the edge is free in the fit, the diameter accordingly less sure,
    and the halo's share unknown: nothing says how bright the lit side is.
    """
    fields: dict[str, Any] = {"method": METHOD, "provenance": _provenance(context)}
    measurements, evidence = _measure(session, context, fields)
    return Result(measurements=tuple(measurements), evidence=evidence)


def _measure(
    session: Session, context: Context, fields: dict[str, Any]
) -> tuple[list[Measurement], dict[str, dict[str, Any]]]:
    levels = _levels(session, context)
    if isinstance(levels, str):
        return _refuse_all(levels, fields), {}
    line, strips = levels
    if min(int(one.used.sum()) for one in strips) < LEAST_STRIPS:
        return _refuse_all(f"fewer than {LEAST_STRIPS} px beside the edge are not cut", fields), {}
    found = _select_model(strips, line)
    evidence = {"lit-edge": _evidence(found, strips)}
    reason = _refusal_reason(found, line)
    if reason:
        return _refuse_all(reason, fields), evidence
    context.progress("posterior of the halo beside an edge", 0.7)
    posterior = _posterior(found.problem, found.peak, context)
    diameter, fraction = _average_models(found, posterior, context)
    if diameter.std() > VAGUE * float(np.median(diameter)):
        return _refuse_all("the edge tells the halo's diameter to no better than a tenth: a fainter level, not cut, says "
                        "where the edge is", fields), evidence  # fmt: skip
    flags = tuple(flag for flag in posterior.flags if flag != "prior-bound") + _misfit(found)
    flags += ("window-too-small",) if float(np.median(diameter)) > 2 * WHOLE * _room(line) else ()
    notes = ("the row pitch is unknown: pixels are taken as square",) if context.sensor is None else ()
    notes += () if session.of_kind("dark") else ("the level without light is taken from the darkest pixels",)
    common = {"flags": flags, "notes": notes, "posterior": posterior, **fields}
    out = [measurement_from_draws("halo_diameter", "px", diameter, **common)]
    if all(one.cut for one in strips):
        out.append(
            make_refusal("halo_fraction", "1", "every level is cut: nothing says how bright the lit side is", **fields)
        )
    else:
        out.append(measurement_from_draws("halo_fraction", "1", fraction, **common))
    return out, evidence


def _refuse_all(reason: str, fields: dict[str, Any]) -> list[Measurement]:
    return [make_refusal(quantity, unit, reason, **fields) for quantity, unit in QUANTITIES]


def _provenance(context: Context) -> Provenance:
    from charact import __version__

    settings = {"pitch_ratio": context.pitch_ratio, "quick": context.quick}
    return Provenance(version=__version__, seed=context.seed, settings=settings)


def _levels(session: Session, context: Context) -> tuple[LitEdgeLine, tuple[Strips, ...]] | str:
    """The edge, found where it is sharpest, and the strips of every level."""
    entries = session.of_kind("edge")
    if not entries:
        raise BadInput("blooming beside an edge needs stacks of kind edge")
    order = sorted(entries, key=lambda entry: entry.conditions.illuminance_lux or 0.0)
    first = order[-1].target.region
    frames = [_frame(entry, session, context) for entry in order if entry.target.region == first]
    kept = [one for one in frames if np.percentile(one[0], 99.0) - one[2] > 0.03 * (one[3] - one[2])]
    if not kept:
        return "no level rises above its dark frames by 3 % of full scale"
    # The brightest level that is not cut tells best where the edge is, else the faintest that is.
    whole = [one for one in kept if np.percentile(one[0], 99.0) < one[2] + CUT_SHARE * (one[3] - one[2])]
    image, _, dark, full = whole[-1] if whole else kept[0]
    low, high = np.percentile(image, (2.0, 98.0))
    level = 0.5 * (float(low) + float(high)) if whole else dark + 0.5 * (full - dark)
    line = edge_line(image, level, context.pitch_ratio)
    if isinstance(line, str):
        return line
    strips = tuple(
        strips_of(image, line, label=label, dark_dn=dark, full_dn=full, pitch_ratio=context.pitch_ratio)
        for image, label, dark, full in kept
    )
    return line, strips


def _frame(entry: StackEntry, session: Session, context: Context) -> tuple[Array, str, float, float]:
    """Mean frame, label, dark level and highest code of a stack."""
    stack = entry.read()
    full = context.full_scale_dn if context.full_scale_dn is not None else stack.full_scale_dn
    dark, image = session.dark_like(entry.conditions), stack.data.mean(axis=0, dtype=np.float64)
    if dark is not None:
        level = dark.read().mean_dn
    else:
        level = stack.black_level_dn if stack.black_level_dn is not None else float(np.percentile(image, 2.0))
    return image, entry.label, level, float(stack.data.max() if full is None else full)


@dataclass(frozen=True, kw_only=True)
class _Found:
    """The best fit with a halo, and by how much the criterion prefers it to the best without."""

    problem: EdgeHaloLikelihood
    peak: EdgeHaloOptimum
    gain: float
    rivals: tuple[tuple[float, EdgeHaloLikelihood, EdgeHaloOptimum], ...]


def _select_model(strips: tuple[Strips, ...], line: LitEdgeLine) -> _Found:
    """Fit cores of all families with and without a halo; the Bayesian information criterion chooses."""
    offset = OFFSET_OF_CUT_PX if all(one.cut for one in strips) else OFFSET_PX
    number = float(np.log(sum(one.used.sum() for one in strips)))
    plain = problem_of(strips, width_px=line.width_px, room_px=_room(line), offset_px=offset)
    fits: dict[bool, list[tuple[float, EdgeHaloLikelihood, EdgeHaloOptimum]]] = {True: [], False: []}
    for halo in (True, False):
        for core in BESIDES:
            problem = replace(plain, core=core, halo=halo)
            peak = optimise_edge_halo(problem)
            free = len(peak.point) - (0 if halo else 3)
            fits[halo].append((free * number - 2.0 * peak.log_probability, problem, peak))
    (bic, problem, peak), without = min(fits[True], key=lambda one: one[0]), min(fits[False], key=lambda one: one[0])
    rivals = tuple((value - bic, of, other) for value, of, other in fits[True] if value < bic + RIVAL)
    return _Found(problem=problem, peak=peak, gain=without[0] - bic, rivals=rivals)


def _room(line: LitEdgeLine) -> float:
    return float(min(line.room_px, DARK_PX))


def _refusal_reason(found: _Found, line: LitEdgeLine) -> str:
    """Why no halo is told, or nothing."""
    if found.gain < GAIN:
        return "the light beside the edge falls as a core's alone: no halo is visible"
    problem, diameter = found.problem, found.peak.point[0]
    for factor in OFF:
        off = float(np.clip(factor * diameter, *problem.bounds[0]))
        if off in problem.bounds[0]:
            continue
        if found.peak.log_probability - optimise_edge_halo(problem, diameter_px=off).log_probability < OFF_COST:
            return "the light beside the edge fades out without a kink: its width is no halo's"
    if diameter > 2 * _room(line):
        return f"the halo reaches the border of the frame, {_room(line):.0f} px from the edge"
    if 0.5 * diameter > line.ends_px:
        return (
            f"the edge is too short: its ends are {line.ends_px:.0f} px from what is measured, the halo reaches farther"
        )
    return ""


def _posterior(problem: EdgeHaloLikelihood, peak: EdgeHaloOptimum, context: Context) -> Posterior:
    asked: dict[str, Any] = {
        "names": problem.names, "units": problem.units, "start": peak.point, "covariance": peak.covariance,
        "seed": context.seed, "bounds": problem.bounds,
    }  # fmt: skip
    return (laplace if context.quick else importance_sample)(problem.log_probability, **asked)


def _average_models(found: _Found, best: Posterior, context: Context) -> tuple[Array, Array]:
    """Draws of the halo's diameter and share, of each core as many as its weight says, shape (draw,)."""
    weight = np.exp([-0.5 * over for over, _, _ in found.rivals])
    count = np.rint(len(best.draws) * weight / weight.sum()).astype(int)
    parts = [
        (best if peak is found.peak else _posterior(problem, peak, context)).draws[:number]
        for number, (_, problem, peak) in zip(count, found.rivals, strict=True)
    ]
    return tuple(np.concatenate([part[:, column] for part in parts]) for column in (0, 2))  # pyright: ignore[reportReturnType]


def _misfit(found: _Found) -> tuple[str, ...]:
    from scipy.stats import chi2

    problem, point = found.problem, found.peak.point
    total = sum(float(problem.fitted(one, point[None])[0][0]) for one in range(len(problem.strips)))
    freedom = sum(int(one.used.sum()) - 2 for one in problem.strips) - len(point)
    return ("model-misfit",) if chi2.sf(total, max(freedom, 1)) < MISFIT else ()


def _evidence(found: _Found, strips: tuple[Strips, ...]) -> dict[str, Any]:
    """Strips of every level with the model."""
    point, problem = found.peak.point[None], found.problem
    model = []
    for one in range(len(strips)):
        light, ground = problem.fitted(one, point)[1][0]
        model.append((light * problem.shape(one, point)[0] + ground).tolist())
    return {
        "figure": "lit-edge",
        "label": [one.label for one in strips],
        "distance_px": [one.distance_px.tolist() for one in strips],
        "mean_dn": [one.mean_dn.tolist() for one in strips],
        "sd_dn": [one.sd_dn.tolist() for one in strips],
        "used": [one.used.tolist() for one in strips],
        "model_dn": model,
        "edge_px": float(found.peak.point[3]),
        "halo_diameter_px": float(found.peak.point[0]),
        "bic_gain_of_halo": found.gain,
    }
