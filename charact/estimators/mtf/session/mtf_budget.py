"""MTF budget: the MTF of each stage of the camera, fitted to curves along rows and columns
together.

The curves are those of the joint fit, or of a point source if the session has one target; the noise
of flats adds the post-gain MTF. Stages known no better than from the description, and groups known
as a product only, are listed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtrc

from charact.estimators.mtf.curve import REPORTED, quantiles
from charact.estimators.mtf.session.constraints import (
    FREQUENCIES,
    POST_GAIN,
    interpolate_draws,
    sources,
)
from charact.estimators.mtf.session.stage_transfers import (
    AFTER_GAIN,
    PARAMETERS,
    STAGES,
    Direction,
    StageModel,
)
from charact.estimators.mtf.session.thresholds import THRESHOLDS
from charact.inference import find_maximum, laplace, sample_posterior
from charact.method import Context
from labdata import Array, Camera, Curve, Measurement, Posterior, Result, has_tube

EVIDENCE = "stage budget"
# Frequencies at which the stages are shown, cycles per column pitch in both directions.
SHOWN = np.maximum(REPORTED, 1e-6)
DIRECTIONS: tuple[Direction, ...] = ("horizontal", "vertical")


class MeasuredCurve(NamedTuple):
    """A measured MTF along one direction, shape (f,).

    Frequencies are cycles per column pitch, vertically per row pitch; `after_gain`: the post-gain
    MTF.
    """

    direction: Direction
    frequency_cy_per_px: Array
    value: Array
    after_gain: bool = False


class MeasuredCurves(NamedTuple):
    """Curves with the covariance of all their values, one curve after the other; it may be of low
    rank.
    """

    curves: tuple[MeasuredCurve, ...]
    covariance: Array


@dataclass(frozen=True, kw_only=True)
class MtfBudget:
    """Fitted stages.

    `identified`: stages that the curves determine better than the description; `products`: groups
    of the others of which only the product is identified; `known`: stages without parameters;
    `statement`: the same in sentences; `chance`: p-value of the residuals.
    """

    posterior: Posterior
    identified: tuple[str, ...]
    products: tuple[tuple[str, ...], ...]
    known: tuple[str, ...]
    statement: tuple[str, ...]
    chance: float
    camera: StageModel = field(repr=False)

    def product(
        self, stages: Sequence[str], frequency_cy_per_px: Array, direction: Direction
    ) -> Array:
        """Return draws of the product of stages, shape (draw, frequency), frequencies per pitch of
        the direction.
        """
        logs = self.camera.log_stages(
            self.posterior.draws, np.asarray(frequency_cy_per_px, float), direction
        )
        return np.exp(np.sum(logs[[STAGES.index(stage) for stage in stages]], axis=0))


def fit_mtf_budget(
    measured: Sequence[MeasuredCurves],
    sensor: Camera,
    *,
    interlaced: bool,
    seed: int,
    quick: bool = False,
    halo: bool = False,
) -> MtfBudget:
    """Fit the stages of a camera to its measured curves, best along rows and columns.

    The stages are those of `StageModel`, with the description's ranges as normal priors; errors of
    the curves are normal. A post-gain curve lacks the lens, the halo and the tube's share before
    the gain. `interlaced`: a row of a frame sums two rows of the chip; `halo`: the curves are
    normalised to all light, so that the halo lowers them.
    """
    camera = StageModel.of(sensor, interlaced=interlaced, halo=halo)
    whitened = [
        (
            target.curves,
            np.concatenate([curve.value for curve in target.curves]),
            _whitener(target.covariance),
        )
        for target in measured
    ]
    bounds = camera.bounds

    def chi2(theta: Array) -> Array:
        total = np.zeros(len(theta))
        for curves, value, root in whitened:
            predicted = [
                camera.mtf(
                    theta, curve.frequency_cy_per_px, curve.direction, after_gain=curve.after_gain
                )
                for curve in curves
            ]
            total += np.sum(
                ((np.concatenate(predicted, axis=1) - value) @ root) ** 2,
                axis=1,
            )
        return total

    def log_probability(theta: Array) -> Array:
        in_bounds = np.all((theta >= bounds[:, 0]) & (theta <= bounds[:, 1]), axis=1)
        safe = np.where(in_bounds[:, None], theta, camera.mean)
        prior = np.sum(((safe - camera.mean) / camera.sd) ** 2, axis=1)
        return np.where(in_bounds, -0.5 * (chi2(safe) + prior), -np.inf)

    point, covariance = find_maximum(log_probability, camera.mean, bounds)
    posterior = (laplace if quick else sample_posterior)(
        log_probability,
        names=camera.names,
        units=tuple(PARAMETERS[name][0] for name in camera.names),
        start=point,
        covariance=covariance,
        seed=seed,
        bounds=bounds,
    )
    rank = sum(root.shape[1] for *_, root in whitened)
    chance = float(chdtrc(rank, float(chi2(point[None])[0])))
    prior = np.random.default_rng([seed, 1]).normal(
        camera.mean, camera.sd, (2000, len(camera.mean))
    )
    prior = np.clip(prior, bounds[:, 0] + 1e-6, bounds[:, 1])
    identified, products, known = _identify_stages(
        camera, posterior.draws, prior, [curve for target in measured for curve in target.curves]
    )
    return MtfBudget(
        posterior=posterior,
        identified=identified,
        products=products,
        known=known,
        chance=chance,
        camera=camera,
        statement=_sentences(camera.stages, identified, products, known, chance),
    )


def _whitener(covariance: Array) -> Array:
    """Return the matrix that whitens errors; directions without variance only reflect the fitted
    form.
    """
    value, vector = np.linalg.eigh(np.asarray(covariance, float))
    measured = value > 1e-6 * value.max()
    return vector[:, measured] / np.sqrt(value[measured])


def _identify_stages(
    camera: StageModel, draws: Array, prior: Array, curves: Sequence[MeasuredCurve]
) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...], tuple[str, ...]]:
    """Return the identified stages, the groups identified as products, and stages without
    parameters.

    They are compared along rows at the MTF50 of the sharpest measured curve.
    """
    across = [curve for curve in curves if curve.direction == "horizontal"] or list(curves)
    half = np.array(
        [max(_half_frequency(curve.frequency_cy_per_px, curve.value) for curve in across)]
    )
    ln_stages, before = (
        camera.log_stages(theta, half, across[0].direction)[:, :, 0] for theta in (draws, prior)
    )
    sd, prior_sd = ln_stages.std(axis=1), before.std(axis=1)
    present = [i for i in range(len(STAGES)) if STAGES[i] in camera.stages]
    known = [i for i in present if prior_sd[i] < 1e-9]
    alone = [i for i in present if i not in known and sd[i] < THRESHOLDS.identified * prior_sd[i]]
    unidentified = [i for i in present if i not in known and i not in alone]
    products: list[tuple[int, ...]] = []
    for group in (
        group
        for size in range(2, len(unidentified) + 1)
        for group in combinations(unidentified, size)
    ):
        members = list(group)
        together = ln_stages[members].sum(axis=0).std()
        if not any(set(product) & set(group) for product in products) and (
            together < THRESHOLDS.product * np.sqrt(np.sum(sd[members] ** 2))
        ):
            products.append(group)

    def names(indices: Sequence[int]) -> tuple[str, ...]:
        return tuple(STAGES[i] for i in indices)

    return names(alone), tuple(names(group) for group in products), names(known)


def _half_frequency(frequency: Array, value: Array) -> float:
    return float(np.interp(0.5, value[::-1], frequency[::-1]))


def _sentences(
    stages: tuple[str, ...],
    identified: tuple[str, ...],
    products: tuple[tuple[str, ...], ...],
    known: tuple[str, ...],
    chance: float,
) -> tuple[str, ...]:
    grouped = {stage for group in products for stage in group}
    undetermined = [stage for stage in stages if stage not in (*identified, *known, *grouped)]
    out = [f"identified by the curves: {', '.join(identified) or 'none'}"]
    out += [f"only the product of {' and '.join(group)} is identified" for group in products]
    if undetermined:
        out.append(f"known from the description alone: {', '.join(undetermined)}")
    if known:
        out.append(f"taken as known: {', '.join(known)}")
    if chance < THRESHOLDS.budget_p_value:
        out.append(f"the stages do not describe the curves (chance {chance:.2g})")
    return tuple(out)


def add_mtf_budget(result: Result, kinds: Mapping[str, str], *, context: Context) -> Result:
    """Return the result of a session with its MTF budget, as evidence and as notes on the MTF50
    that it explains.

    The result is unchanged without an intensifier, or without valid curves with draws along both
    rows and columns. These are of the same draws and are taken together, so that shared errors
    count once. The difference of a joint MTF of two or three parameters from a product of stages
    adds the covariance s^2 exp(-|f - f'|/0.08) along each direction.
    """
    system = None if not has_tube(context.camera) else _system_curves(result, kinds)
    if not has_tube(context.camera) or system is None:
        return result
    curves, explained, halo = system
    after = _post_gain_curves(result)
    measured = [_with_covariance(curves, context)]
    measured += [] if after is None else [_with_covariance(after, context, after_gain=True)]
    budget = fit_mtf_budget(
        measured,
        context.camera,
        interlaced=context.interlaced,
        seed=context.seed,
        quick=context.quick,
        halo=halo,
    )
    sentences = (*_stage_losses(budget, curves, context), *budget.statement)
    notes = tuple(f"Stages: {sentence}." for sentence in sentences)
    noted = tuple(
        m.with_(notes=(*m.notes, *notes)) if m is explained else m for m in result.measurements
    )
    evidence = {EVIDENCE: _figure_data(budget, curves, after, sentences, context)}
    return Result(
        measurements=noted, curves=result.curves, evidence={**result.evidence, **evidence}
    )


def _system_curves(
    result: Result, kinds: Mapping[str, str]
) -> tuple[tuple[Curve, Curve], Measurement, bool] | None:
    """Return the joint curves along rows and columns, else those of a valid point, their MTF50, and
    whether the halo is counted: a point's method counts it.
    """
    across, down = (result.curves.get(name) for name in ("mtf_joint", "mtf_joint_vertical"))
    vouching, halo = result.find("mtf50", method="joint"), True
    if across is not None and down is not None:
        halo = result.evidence["joint MTF"]["counts_halo"]
    else:
        points = [
            source
            for source in sources(result, kinds)
            if source.kind == "point" and len(source.curves) == 2
        ]
        if not points:
            return None
        (across, _), (down, _) = points[0].curves
        of = points[0].of
        vouching = tuple(m for m in result.find("mtf50", stack=of.stack) if m.region == of.region)
    if not _draw_jointly(across, down) or not vouching or any(m.value is None for m in vouching):
        return None
    return (across, down), vouching[0], halo


def _draw_jointly(first: Curve, second: Curve) -> bool:
    return (
        first.draws is not None
        and second.draws is not None
        and len(first.draws) == len(second.draws)
    )


def _post_gain_curves(result: Result) -> tuple[Curve, Curve] | None:
    """Return the valid curves of the flats' noise, vertical ones in cycles per row pitch."""
    measured = result.find("post_gain_mtf50")
    across, down = (result.curves.get(name) for name in POST_GAIN)
    if not measured or any(m.status != "ok" for m in measured) or across is None or down is None:
        return None
    return (across, down) if _draw_jointly(across, down) else None


def _with_covariance(
    curves: tuple[Curve, Curve], context: Context, *, after_gain: bool = False
) -> MeasuredCurves:
    """Return curves along rows and columns with the errors that their draws share."""
    parts, drawn = [], []
    for curve, direction in zip(curves, DIRECTIONS, strict=True):
        per_pitch = _per_pitch(direction, context)
        # Curves of the whole camera count column pitches in both directions, those after the gain
        # each its own.
        pitch_frequency = FREQUENCIES * per_pitch if after_gain else FREQUENCIES
        is_measured = (pitch_frequency <= curve.frequency_cy_per_px[-1]) & (
            np.interp(pitch_frequency, curve.frequency_cy_per_px, curve.value) > THRESHOLDS.min_mtf
        )
        drawn.append(interpolate_draws(pitch_frequency[is_measured], curve))
        parts.append(
            MeasuredCurve(
                direction=direction,
                frequency_cy_per_px=FREQUENCIES[is_measured] * per_pitch,
                value=drawn[-1].mean(axis=0),
                after_gain=after_gain,
            )
        )
    covariance = np.atleast_2d(np.cov(np.concatenate(drawn, axis=1).T))
    first = len(parts[0].value)
    for part, block in zip(parts, (slice(None, first), slice(first, None)), strict=True):
        separation = np.abs(part.frequency_cy_per_px[:, None] - part.frequency_cy_per_px)
        covariance[block, block] += THRESHOLDS.cascade_sd**2 * np.exp(
            -separation / THRESHOLDS.cascade_correlation_cy_per_px
        )
    return MeasuredCurves(curves=tuple(parts), covariance=covariance)


def _per_pitch(direction: Direction, context: Context) -> float:
    """Return the pitch of a direction's pixels in column pitches."""
    return context.pitch_ratio if direction == "vertical" else 1.0


def _stage_losses(budget: MtfBudget, curves: tuple[Curve, Curve], context: Context) -> list[str]:
    """Return the MTF of each stage at the MTF50 of the whole, along rows and along columns, in
    sentences.
    """
    out = []
    for curve, direction, lines in zip(curves, DIRECTIONS, ("rows", "columns"), strict=True):
        half = _half_frequency(curve.frequency_cy_per_px, curve.value)
        mtf50_frequency = np.array([half * _per_pitch(direction, context)])
        transfer_of_stage = {
            stage: float(np.median(budget.product((stage,), mtf50_frequency, direction)))
            for stage in budget.camera.stages
        }
        measured = ", ".join(
            f"{stage} {value:.2f}" for stage, value in transfer_of_stage.items() if value < 0.9995
        )
        out.append(
            f"along {lines} at {half:.3f} cycles per column pitch the stages leave {measured}"
        )
    return out


def _figure_data(
    budget: MtfBudget,
    curves: tuple[Curve, Curve],
    after: tuple[Curve, Curve] | None,
    sentences: Sequence[str],
    context: Context,
) -> dict[str, Any]:
    misfit = budget.chance < THRESHOLDS.budget_p_value
    parameters = quantiles(budget.posterior.draws, (0.5, 0.025, 0.975)).T.tolist()
    return {
        "figure": "stage-budget",
        "status": "suspect" if misfit or budget.posterior.flags else "ok",
        "flags": sorted({*budget.posterior.flags, *(["model-misfit"] if misfit else [])}),
        "chance": budget.chance,
        "the_curves_say": "; ".join(sentences),
        "statement": list(sentences),
        "identified": list(budget.identified),
        "products": [list(group) for group in budget.products],
        "known": list(budget.known),
        "parameters": dict(zip(budget.posterior.names, parameters, strict=True)),
        **{
            direction: _panel(
                budget, direction, curves[i], None if after is None else after[i], context
            )
            for i, direction in enumerate(DIRECTIONS)
        },
    }


def _panel(
    budget: MtfBudget, direction: Direction, curve: Curve, after: Curve | None, context: Context
) -> dict[str, Any]:
    """Return one direction: stages, their product and the measured curves, with 95 % intervals."""
    assert has_tube(context.camera)
    pitch_frequency, stages = SHOWN * _per_pitch(direction, context), budget.camera.stages
    mm = float(context.camera.ccd.pitch_x_um) * 1e-3 * float(context.camera.taper.demagnification)
    panel = {
        "frequency_cy_per_column": SHOWN.tolist(),
        "cathode_lp_per_mm": (SHOWN / mm).tolist(),
        "stages": {
            stage: _band(budget.product((stage,), pitch_frequency, direction)) for stage in stages
        },
        "product": _band(budget.product(stages, pitch_frequency, direction)),
        "measured": _band(interpolate_draws(SHOWN, curve)),
    }
    if after is not None:
        panel["product_after_gain"] = _band(budget.product(AFTER_GAIN, pitch_frequency, direction))
        # Beyond its last frequency a curve holds nothing; null is a gap in what is drawn.
        known = np.where(pitch_frequency <= after.frequency_cy_per_px[-1], 1.0, np.nan)
        panel["measured_after_gain"] = _band(interpolate_draws(pitch_frequency, after) * known)
    return panel


def _band(draws: Array) -> dict[str, list[float]]:
    """Return median and 95 % interval of draws at every frequency."""
    lines = quantiles(draws, (0.5, 0.025, 0.975))
    return {
        name: line.tolist() for name, line in zip(("value", "low95", "high95"), lines, strict=True)
    }
