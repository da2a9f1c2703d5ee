"""Halo at an illuminated edge, fitted to the strips of all stacks."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from charact.estimators.bloom.extent_measurements import provenance
from charact.estimators.bloom.findings import finding
from charact.estimators.bloom.lit_edge_profile import LitEdgeLine, Strips, edge_line, strips_of
from charact.estimators.bloom.series.halo_models import (
    LEAST_DIAMETER_PX,
    WINGS,
    tube_priors,
)
from charact.estimators.bloom.series.optimum import BoundedOptimum, optimise_parameters
from charact.estimators.bloom.thresholds import Unmeasurable
from charact.frames.stack import Stack
from charact.frames.thresholds import CLIPPING
from charact.inference import importance_sample, laplace
from charact.method import Context, register
from charact.transfer import spreads
from charact.transfer.form import Parameter, Parametric
from charact.verdict import judge
from labdata import (
    Array,
    BadInput,
    Measurement,
    Posterior,
    Result,
    Session,
    StackEntry,
    has_tube,
    make_refusal,
    measurement_from_draws,
)

METHOD = "lit-edge"
QUANTITIES = (("halo_diameter", "px"), ("halo_fraction", "1"))
# Parameters of the core besides the Gaussian's, by core.
CORES = {"gaussian": (), "tube": tube_priors(None), "moffat": WINGS["moffat"]}
LEAST_STRIPS = 24


def nodes() -> tuple[Array, Array]:
    """Frequencies, cy/px, and weights of the profile integrals, valid to 160 px from the edge."""
    return spreads.quadrature(0.75, 280)


@dataclass(frozen=True, kw_only=True)
class EdgeHaloLikelihood(Parametric):
    """Likelihood of the whitened strips of all stacks of one edge.

    `strips`: strips of every stack; `line`: the edge, of an area of finite or infinite width;
    `core`: a name of `CORES`; `halo`: whether there is one.
    """

    strips: tuple[Strips, ...]
    line: LitEdgeLine
    core: str = "gaussian"
    halo: bool = True

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters in the order of a point's coordinates."""
        offset = (-10.0, 1.0) if all(strips.cut for strips in self.strips) else (-1.5, 1.5)
        # Elastic shares slightly beyond 0..1, since a bound at 0 would bias the diameter of a halo
        # without rim.
        bounds = {
            ("halo_diameter", "px"): (
                LEAST_DIAMETER_PX,
                max(2.0 * self.line.dark_px, LEAST_DIAMETER_PX + 4.0),
            ),
            ("elastic_share", "1"): (-0.15, 1.15),
            ("halo_fraction", "1"): (0.0, 0.6),
            ("edge_offset", "px"): offset,
            ("core_spread", "px2"): (0.05, 25.0),
        }
        common = (
            Parameter(name=name, unit=unit, low=a, high=b)
            for (name, unit), (a, b) in bounds.items()
        )
        return (*common, *CORES[self.core])

    @cached_property
    def _of_strips(self) -> tuple[tuple[Array, Array, Array], ...]:
        """Whitening matrix of each stack's used strips, and sine and cosine of the frequencies at
        all of them.
        """
        out = []
        for strips in self.strips:
            signal = strips.mean_dn[strips.unclipped] - np.median(
                strips.mean_dn[strips.unclipped][-8:]
            )
            # A model of straight edges has a relative error of 0.4 % of the signal above
            # background.
            covariance = strips.covariance() + np.diag((0.004 * signal) ** 2)
            turn = 2.0 * np.pi * np.outer(nodes()[0], strips.distance_px)
            out.append((np.linalg.inv(np.linalg.cholesky(covariance)), np.sin(turn), np.cos(turn)))
        return tuple(out)

    def log_probability(self, points: Array) -> Array:
        """Log-posterior with the optimum signal and background of every stack, shape (point,)."""
        prior = self.log_prior(points)
        safe = np.where(np.isfinite(prior)[:, None], points, self.bounds.mean(axis=1))
        return prior - 0.5 * (self.residuals(safe) ** 2).sum(axis=1)

    def residuals(self, points: Array) -> Array:
        """Normalised residuals, shape (point, number)."""
        out = []
        for number, strips in enumerate(self.strips):
            stack_residuals, amplitudes = self.fit_level(number, points)
            # A clipped side below full scale.
            short = np.maximum(strips.least_light_dn - amplitudes[:, :1], 0.0)
            out += [stack_residuals, short / max(0.03 * strips.least_light_dn, 1e-9)]
        return np.concatenate(out, axis=1)

    def residual_and_slopes(self, point: Array) -> tuple[Array, Array]:
        """Normalised residuals, and minus their derivatives, shape (number, parameter)."""
        low, high = self.bounds.T
        step = 1e-4 * (high - low)
        # Inside the bounds on either side.
        step = np.where(point + step > high, -step, step)
        residuals = self.residuals(np.concatenate([point[None], point + np.diag(step)]))
        return residuals[0], (residuals[0] - residuals[1:]).T / step

    def fit_level(self, number: int, points: Array) -> tuple[Array, Array]:
        """Whitened residuals of one stack, shape (point, strip), and its signal and background,
        (point, 2).
        """
        strips, white = self.strips[number], self._of_strips[number][0]
        light = self.shape(number, points)[:, strips.unclipped] @ white.T
        data, flat = white @ strips.mean_dn[strips.unclipped], white.sum(axis=1)
        aa, ab, bb = (light**2).sum(axis=1), light @ flat, float(flat @ flat)
        ad, bd = light @ data, float(flat @ data)
        determinant = np.maximum(aa * bb - ab**2, 1e-12 * aa * bb)
        level, ground = (bb * ad - ab * bd) / determinant, (aa * bd - ab * ad) / determinant
        return data - level[:, None] * light - ground[:, None] * flat, np.stack(
            [level, ground], axis=1
        )

    def shape(self, number: int, points: Array) -> Array:
        """Profile across an edge of unit signal, shape (point, strip)."""
        diameter, elastic, fraction, offset, spread, *core = points.T
        frequency = nodes()[0]
        blur = spreads.gaussian(frequency, spread)
        if self.core == "tube":
            blur = blur * spreads.tube(frequency, *core)
        elif self.core == "moffat":
            blur = spreads.mix(blur, core[0], spreads.moffat(frequency, *core[1:]))
        blur = blur * np.sinc(frequency)
        if self.halo:
            profile = np.stack([elastic, 1.0 - elastic, 0.0 * elastic, 0.0 * elastic], axis=-1)
            blur = blur * spreads.mix(
                1.0, fraction, spreads.halo_disc(frequency, diameter, profile)
            )
        edge_profile = self._step(number, blur, offset)
        if not np.isfinite(self.line.width_px):
            return edge_profile
        return edge_profile - self._step(number, blur, -self.line.width_px - offset)

    def _step(self, number: int, blur: Array, at: Array) -> Array:
        """Step response at given offsets: 1/2 - integral of T sin(2 pi f (x - x0)) / pi f."""
        _, sine, cosine = self._of_strips[number]
        frequency, weight = nodes()
        turn, density = 2.0 * np.pi * frequency * at[:, None], blur * weight / (np.pi * frequency)
        return 0.5 - (density * np.cos(turn)) @ sine + (density * np.sin(turn)) @ cosine


@dataclass(frozen=True, kw_only=True)
class EdgeHaloOptimum:
    """Best fit of a model."""

    problem: EdgeHaloLikelihood
    peak: BoundedOptimum

    @property
    def bic(self) -> float:
        """-2 log P + k ln N."""
        free = len(self.peak.point) - (0 if self.problem.halo else 3)
        number = sum(strips.unclipped.sum() for strips in self.problem.strips)
        return free * float(np.log(number)) - 2.0 * self.peak.log_probability

    def posterior(self, context: Context) -> Posterior:
        """Posterior draws of the parameters."""
        return (laplace if context.quick else importance_sample)(
            self.problem.log_probability,
            names=self.problem.names,
            units=self.problem.units,
            start=self.peak.point,
            covariance=self.peak.covariance,
            seed=context.seed,
            bounds=self.problem.bounds,
        )


def optimise_edge_halo(
    problem: EdgeHaloLikelihood, *, diameter_px: float | None = None
) -> EdgeHaloOptimum:
    """Return the best fit from several start diameters, since the disc edge causes many local
    optima.

    `diameter_px` fixes the diameter.
    """
    low, high = problem.bounds[0]
    diameters = (
        np.linspace(low + 2, high - 2, 24) if problem.halo else np.array([0.5 * (low + high)])
    )
    if diameter_px is not None:
        diameters = np.array([diameter_px])
    offset, core = 0.5 * problem.bounds[3].sum(), [shape.first for shape in CORES[problem.core]]
    points = np.array(
        [[d, w, 0.1, offset, s, *core] for d in diameters for w in (0.3, 0.8) for s in (1.0, 3.0)]
    )
    order = np.argsort(problem.log_probability(points))[::-1]
    fixed = () if diameter_px is None else (0,)
    peaks = [
        optimise_parameters(
            problem,
            problem.residual_and_slopes,
            points[index],
            fixed if problem.halo else (0, 1, 2),
            200,
            1e-5,
        )
        for index in order[:2]
    ]
    return EdgeHaloOptimum(problem=problem, peak=max(peaks, key=lambda peak: peak.log_probability))


@register("lit-edge", METHOD)
def measure_lit_edge(session: Session, *, context: Context) -> Result:
    """Measure diameter and fraction of the halo from the edges of a session.

    Parameters
    ----------
    session
        Session with stacks of kind "edge", all of one target at several illuminances; preferably
        with darks.
    context
        Seed and settings.

    Notes
    -----
    An unclipped stack locates the edge and gives the signal of the illuminated side; brighter ones
    show the halo. With clipped stacks alone the edge position is free in the fit, the diameter less
    certain, and the halo fraction unknown.
    """
    fields: dict[str, Any] = {"method": METHOD, "provenance": provenance(context)}
    evidence: dict[str, dict[str, Any]] = {}
    try:
        measurements = _measure(session, context, fields, evidence)
    except Unmeasurable as refusal:
        measurements = [
            make_refusal(quantity, unit, str(refusal), **fields) for quantity, unit in QUANTITIES
        ]
    return Result(measurements=tuple(measurements), evidence=evidence)


def _measure(
    session: Session, context: Context, fields: dict[str, Any], evidence: dict[str, Any]
) -> list[Measurement]:
    line, strips = _levels(session, context)
    if min(int(stack_strips.unclipped.sum()) for stack_strips in strips) < LEAST_STRIPS:
        raise Unmeasurable(f"fewer than {LEAST_STRIPS} px next to the edge are unclipped")
    fits = {
        halo: [
            optimise_edge_halo(EdgeHaloLikelihood(strips=strips, line=line, core=core, halo=halo))
            for core in CORES
        ]
        for halo in (True, False)
    }
    best, without = (min(optima, key=lambda optimum: optimum.bic) for optima in fits.values())
    evidence["lit-edge"] = {**_evidence(best), "bic_gain_of_halo": without.bic - best.bic}
    if without.bic - best.bic < 20.0:
        raise Unmeasurable(
            "the profile next to the edge is that of a core alone: no halo is visible"
        )
    _check_edge_of_halo(best)
    context.progress("posterior of the halo next to an edge", 0.7)
    posterior = best.posterior(context)
    diameter, fraction = _average_models(best, fits[True], posterior, context)
    if diameter.std() > 0.1 * float(np.median(diameter)):
        raise Unmeasurable(
            "the halo diameter is uncertain by more than 10 %: a fainter, unclipped stack would "
            "locate the edge"
        )
    findings = [finding(flag) for flag in posterior.flags if flag != "prior-bound"]
    if _is_misfit(best):
        findings.append(finding("model-misfit", "the strips deviate from the model beyond noise"))
    # Maximum halo radius over the distance to the border.
    if float(np.median(diameter)) > 2 * 0.85 * line.dark_px:
        findings.append(finding("window-too-small"))
    notes = (
        () if has_tube(context.camera) else ("the row pitch is unknown: pixels are assumed square",)
    )
    notes += (
        () if session.of_kind("dark") else ("the black level is estimated from the darkest pixels",)
    )
    common = {"notes": notes, "posterior": posterior, **fields}
    out = [judge(measurement_from_draws("halo_diameter", "px", diameter, **common), findings)]
    if all(stack_strips.cut for stack_strips in strips):
        reason = "every stack is clipped: the signal of the bright side is unknown"
        return [*out, make_refusal("halo_fraction", "1", reason, **fields)]
    number = measurement_from_draws("halo_fraction", "1", fraction, **common)
    return [*out, judge(number, findings)]


def _levels(session: Session, context: Context) -> tuple[LitEdgeLine, tuple[Strips, ...]]:
    """The edge, located in the best stack, and the strips of every stack."""
    entries = session.of_kind("edge")
    if not entries:
        raise BadInput("the halo of an edge needs stacks of kind edge")
    order = sorted(entries, key=lambda entry: entry.conditions.illuminance_lux or 0.0)
    first = order[-1].target.region
    frames = [_frame(entry, session, context) for entry in order if entry.target.region == first]
    lit_frames = [
        frame
        for frame in frames
        if np.percentile(frame[0], 99.0) - frame[2] > 0.03 * (frame[3] - frame[2])
    ]
    if not lit_frames:
        raise Unmeasurable("no stack exceeds its dark frames by 3 % of full scale")
    # The brightest unclipped stack locates the edge best, else the faintest one.
    unclipped_frames = [
        frame
        for frame in lit_frames
        if np.percentile(frame[0], 99.0)
        < frame[2] + CLIPPING.linear_fraction * (frame[3] - frame[2])
    ]
    image, _, dark, full = unclipped_frames[-1] if unclipped_frames else lit_frames[0]
    level = (
        0.5 * float(sum(np.percentile(image, (2.0, 98.0))))
        if unclipped_frames
        else dark + 0.5 * (full - dark)
    )
    line = edge_line(image, level, context.pitch_ratio)
    return line, tuple(
        strips_of(
            image, line, label=label, dark_dn=dark, full_dn=full, pitch_ratio=context.pitch_ratio
        )
        for image, label, dark, full in lit_frames
    )


def _frame(
    entry: StackEntry, session: Session, context: Context
) -> tuple[Array, str, float, float]:
    """Mean frame, label, dark level and full scale of a stack."""
    stack = Stack.of(entry.read(), context)
    dark = session.dark_like(entry.conditions)
    level, _ = stack.black_level_dn(None if dark is None else dark.read().mean_dn)
    return stack.mean_frame_dn, entry.label, level, stack.top_dn


def _check_edge_of_halo(best: EdgeHaloOptimum) -> None:
    """Refuse a halo without an edge in the profile, or one too large for the frame or the edge."""
    diameter, line = best.peak.point[0], best.problem.line
    for factor in (0.75, 1.3):
        off = float(np.clip(factor * diameter, *best.problem.bounds[0]))
        if off in best.problem.bounds[0]:
            continue
        if (
            best.peak.log_probability
            - optimise_edge_halo(best.problem, diameter_px=off).peak.log_probability
            < 6.0
        ):
            raise Unmeasurable(
                "the profile next to the edge falls off smoothly, without the end of a halo"
            )
    if diameter > 2 * line.dark_px:
        raise Unmeasurable(
            f"the halo extends to the border of the frame, {line.dark_px:.0f} px from the edge"
        )
    if 0.5 * diameter > line.ends_px:
        raise Unmeasurable(
            f"the edge is too short: its ends are {line.ends_px:.0f} px from the measured part, "
            "the halo is wider"
        )


def _average_models(
    best: EdgeHaloOptimum, fits: list[EdgeHaloOptimum], best_posterior: Posterior, context: Context
) -> tuple[Array, Array]:
    """Draws of the halo's diameter and fraction, averaged over cores by weight, shape (draw,)."""
    rivals = [optimum for optimum in fits if optimum.bic < best.bic + 10.0]
    weight = np.exp([-0.5 * (optimum.bic - best.bic) for optimum in rivals])
    count = np.rint(len(best_posterior.draws) * weight / weight.sum()).astype(int)
    parts = [
        (best_posterior if optimum is best else optimum.posterior(context)).draws[:number]
        for number, optimum in zip(count, rivals, strict=True)
    ]
    draws = np.concatenate([part[:, [0, 2]] for part in parts])
    return draws[:, 0], draws[:, 1]


def _is_misfit(best: EdgeHaloOptimum) -> bool:
    """Return whether the strips deviate from the model by more than noise."""
    from scipy.special import chdtrc

    problem, point = best.problem, best.peak.point[None]
    total = sum(
        float((problem.fit_level(number, point)[0] ** 2).sum())
        for number in range(len(problem.strips))
    )
    freedom = sum(int(strips.unclipped.sum()) - 2 for strips in problem.strips) - len(
        best.peak.point
    )
    return bool(chdtrc(max(freedom, 1), total) < 1e-4)


def _evidence(best: EdgeHaloOptimum) -> dict[str, Any]:
    """Strips of every stack with the model."""
    point, strips, model = best.peak.point[None], best.problem.strips, []
    for number in range(len(strips)):
        light, ground = best.problem.fit_level(number, point)[1][0]
        model.append((light * best.problem.shape(number, point)[0] + ground).tolist())
    of_strips = {
        name: [getattr(stack_strips, field).tolist() for stack_strips in strips]
        for name, field in (
            ("distance_px", "distance_px"),
            ("mean_dn", "mean_dn"),
            ("sd_dn", "sd_dn"),
            ("used", "unclipped"),
        )
    }
    return {
        "figure": "lit-edge",
        "label": [stack_strips.label for stack_strips in strips],
        **of_strips,
        "model_dn": model,
        "edge_px": float(best.peak.point[3]),
        "halo_diameter_px": float(best.peak.point[0]),
    }
