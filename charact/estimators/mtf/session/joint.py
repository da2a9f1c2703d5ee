"""One MTF fitted to all targets of a session: edges, bars, points, and the noise of flats as a
bound.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, log_ndtr, ndtr

import charact
from charact.estimators.mtf.curve import FINE, PINNED, REPORTED, crossing_frequency, curve_of
from charact.estimators.mtf.known_transfer import halo_diameters_px
from charact.estimators.mtf.session.constraints import MtfConstraint, constraints_from
from charact.estimators.mtf.session.joint_model import JointBlurModel, KnownCameraTransfer
from charact.estimators.mtf.session.thresholds import THRESHOLDS
from charact.inference import find_maximum, importance_sample, sample_posterior
from charact.inference.diagnostics import crowds_at_bound
from charact.method import Context
from charact.method.stopwatch import with_timing
from charact.transfer.extended import HaloComponent
from charact.verdict import Finding, judge
from labdata import (
    Array,
    Measurement,
    Posterior,
    Provenance,
    Result,
    has_tube,
    make_refusal,
    measurement_from_draws,
)

CORES: tuple[tuple[str, bool], ...] = (
    ("gaussian", False),
    ("exponential", False),
    ("moffat", False),
    ("exponential", True),
)
DRAWS = 1000
# Parameters whose bounds are physical: a posterior may lean on them.
NATURAL_BOUNDS = (
    "blur_px2",
    "halo_fraction",
    "halo_elastic_share",
    "moffat_exponent",
    "halo_diameter_px",
)


# Effect and remedy of each flag of a joint MTF.
FINDINGS = {
    "model-misfit": (
        "one MTF does not describe all targets",
        "the targets in focus, at one gain, and each alone in its `roi`",
    ),
    "not-converged": ("interval from the curvature at the optimum", "another `seed`"),
    "prior-bound": (
        "a parameter lies at a bound that was merely chosen: the interval is cut off there",
        "targets of more frequencies",
    ),
    "several-modes": ("two MTFs fit about equally well", "targets of more frequencies"),
}


@dataclass(frozen=True, kw_only=True)
class JointLikelihood:
    """Likelihood of one form: constraints of the targets, and the post-gain MTF of flats as an
    upper bound.
    """

    form: JointBlurModel
    constraints: Sequence[MtfConstraint]
    bounds: Sequence[MtfConstraint] = ()

    @cached_property
    def combinations(self) -> int:
        """Number of combinations that the targets measure."""
        return sum(constraint.value.size for constraint in self.constraints)

    @cached_property
    def _places(self) -> tuple[Array, Array, NDArray[np.bool_], Array, Array | None]:
        """Frequencies of all targets along rows and columns; whether the halo is excluded;
        described transfer and its bend.
        """
        every = (*self.constraints, *self.bounds)
        frequency, angle = (
            np.concatenate(of)
            for of in zip(*((o.frequency, o.angle_rad) for o in every), strict=True)
        )
        excludes_halo = np.concatenate(
            [np.full(constraint.frequency.size, constraint.excludes_halo) for constraint in every]
        )
        fx, fy = np.abs(frequency * np.cos(angle)), np.abs(frequency * np.sin(angle))
        return fx, fy, excludes_halo, self.form.known(fx, fy), self.form.known.bend(fx)

    def residuals(self, theta: Array) -> Array:
        """Return whitened residuals of targets, then of bounds, shape (n, combination + bound)."""
        fx, fy, excludes_halo, known, bend = self._places
        mtf = known * self.form.unknown(theta, fx, fy, bend=bend, excludes_halo=excludes_halo)
        every = (*self.constraints, *self.bounds)
        ends = np.cumsum([constraint.frequency.size for constraint in every])[:-1]
        parts = np.split(mtf, ends, axis=1)
        return np.concatenate(
            [constraint.residual(part) for constraint, part in zip(every, parts, strict=True)],
            axis=1,
        )

    def log_probability(self, theta: Array) -> Array:
        """Return ln of the posterior density up to a constant, shape (n, parameter) -> (n,).

        Notes
        -----
        Normal in every combination. Light moved before the gain lowers the whole MTF by any
        fraction of the post-gain part, so a post-gain MTF measured as P +- s has the likelihood
        Phi((P - M)/s).
        """
        walls = self.form.bounds
        targets, bounds = np.split(
            self.residuals(np.clip(theta, walls[:, 0], walls[:, 1])), [self.combinations], axis=1
        )
        return (
            self.form.log_prior(theta)
            - 0.5 * np.sum(targets**2, axis=1)
            + np.sum(log_ndtr(bounds), axis=1)
        )


@dataclass(frozen=True, kw_only=True)
class JointFit:
    """Optimum of a form: residuals and their slope there, covariance, and ln of the evidence by
    Laplace.
    """

    problem: JointLikelihood
    point: Array
    residual: Array
    slope: Array
    covariance: Array
    log_evidence: float

    @property
    def leverage(self) -> Array:
        """Share of the residuals' noise that the fit takes up, shape (combination, combination)."""
        walls = self.problem.form.bounds
        wall_distance = np.minimum(self.point - walls[:, 0], walls[:, 1] - self.point)
        free = wall_distance > 1e-6 * np.ptp(walls, axis=1)
        covariance = np.linalg.inv(np.linalg.inv(self.covariance)[np.ix_(free, free)])
        slope = self.slope[: self.problem.combinations, free]
        return slope @ covariance @ slope.T


def fit_joint_model(problem: JointLikelihood) -> JointFit:
    """Optimise from the best of many half frequencies; return the optimum with its Gauss-Newton
    curvature.
    """
    walls, count = problem.form.bounds, problem.combinations
    start = np.tile(problem.form.start(0.0), (24, 1))
    start[:, 0] = np.linspace(walls[0, 0], walls[0, 1], 26)[1:-1]
    begun = start[int(np.argmax(problem.log_probability(start)))]
    point, _ = find_maximum(problem.log_probability, begun, walls, iterations=20)
    slope, residual = _slope(problem.residuals, point, walls), problem.residuals(point[None])[0]
    margins = residual[count:]
    # Curvature of -ln Phi(z): h (h + z), h the density over Phi.
    ratio = np.exp(-0.5 * margins**2 - 0.5 * np.log(2.0 * np.pi) - log_ndtr(margins))
    curvature = slope.T @ (
        np.concatenate([np.ones(count), ratio * (ratio + margins)])[:, None] * slope
    )
    # A flat prior counts as one of the variance of its bounds.
    precision = 12.0 / np.ptp(walls, axis=1) ** 2 + problem.form.prior_precision[1]
    covariance = np.asarray(np.linalg.inv(curvature + np.diag(precision)), np.float64)
    height = float(problem.log_probability(point[None])[0])
    volume = 0.5 * float(np.linalg.slogdet(2.0 * np.pi * covariance)[1])
    return JointFit(
        problem=problem,
        point=point,
        residual=residual,
        slope=slope,
        covariance=covariance,
        log_evidence=height + volume,
    )


def _slope(values: Callable[[Array], Array], point: Array, walls: Array) -> Array:
    """Return the derivative of values to the parameters, shape (value, parameter), by differences
    inside the walls.
    """
    moves = np.diag(1e-4 * np.ptp(walls, axis=1))
    high, low = (np.clip(point + sign * moves, walls[:, 0], walls[:, 1]) for sign in (1.0, -1.0))
    return ((values(high) - values(low)) / np.diag(high - low)[:, None]).T


def consistency_test(fit: JointFit) -> dict[str, Any]:
    """Test whether the targets measure one MTF; return the evidence.

    Notes
    -----
    With J the slope of the whitened residuals and C the covariance of the parameters off their
    bounds, H = J C J^T is the share of each residual's noise that the fit takes up: chi-squared r.r
    has N - tr H degrees of freedom, and r_t (1 - H_tt)^-1 r_t is that of target t against the curve
    of the others (leave-one-out in linear theory). A bound violated by z standard deviations adds
    z^2.
    """
    problem, count = fit.problem, fit.problem.combinations
    residual, margins, leverage = fit.residual[:count], fit.residual[count:], fit.leverage
    broken = np.minimum(margins, 0.0)
    total = float(residual @ residual + np.sum(broken**2))
    freedom = float(max(residual.size - np.trace(leverage), 0.0))
    probability = float(chdtrc(freedom, total)) if freedom > 0.05 else 1.0
    chi2, chances, parts, first = [], [], [], 0
    for constraint in problem.constraints:
        rows = slice(first, first + constraint.value.size)
        first += constraint.value.size
        variance, axes = np.linalg.eigh(
            np.eye(constraint.value.size) - 0.5 * (leverage + leverage.T)[rows, rows]
        )
        compared = variance > THRESHOLDS.min_compared
        along = axes[:, compared].T @ residual[rows]
        chi2.append(float(np.sum(along**2 / variance[compared])))
        chances.append(float(chdtrc(compared.sum(), chi2[-1])) if compared.any() else 1.0)
        parts.append(residual[rows].tolist())
    every, chances = (*problem.constraints, *problem.bounds), [*chances, *ndtr(margins).tolist()]
    parts += [[z] for z in broken.tolist()]
    return {
        "figure": "joint-mtf",
        "counts_halo": problem.form.wide is not None,
        "target": [constraint.target for constraint in every],
        "kind": [constraint.kind for constraint in every],
        "values": [len(part) for part in parts],
        "residuals_sd": parts,
        "apart_chi_squared": [*chi2, *(broken**2).tolist()],
        "apart_probability": chances,
        "chi_squared": total,
        "degrees_of_freedom": freedom,
        "probability": probability,
        "inside_joint_95_percent_region": bool(probability >= THRESHOLDS.inconsistent_p_value),
        "differs_most": every[int(np.argmin(chances))].target,
    }


@dataclass(frozen=True, kw_only=True)
class JointMtf:
    """Forms with their shares of the evidence and draws, and the test of the best."""

    fits: Sequence[JointFit]
    shares: Array
    posteriors: Sequence[Posterior]
    test: dict[str, Any]

    @property
    def forms(self) -> dict[str, float]:
        """Share of the evidence of each form by its name."""
        return {
            fit.problem.form.name: float(weight)
            for fit, weight in zip(self.fits, self.shares, strict=True)
        }

    def mtf(self, frequency: Array, vertical: bool) -> Array:
        """Return drawn MTFs along rows or along columns, cycles per column pitch, shape (draw,
        f).
        """
        none = np.zeros_like(frequency)
        fx, fy = (none, frequency) if vertical else (frequency, none)
        return np.concatenate(
            [
                fit.problem.form.transfer(posterior.draws[: max(1, round(DRAWS * weight))], fx, fy)
                for fit, posterior, weight in zip(
                    self.fits, self.posteriors, self.shares, strict=True
                )
            ]
        )


@with_timing
def fit_joint_mtf(result: Result, kinds: Mapping[str, str], *, context: Context) -> Result:
    """Fit one MTF to all valid targets of a session and test their consistency.

    Parameters
    ----------
    result, kinds
        Measurements and curves of one session, and the kind ("edge", "bars", "point") of each stack
        by its label.
    context
        Seed, whether a Markov chain may be run, and the camera. Without an intensifier there is no
        halo.

    Returns
    -------
    Result
        `mtf50`, `mtf10` and `mtf` at pinned frequencies, method "joint" and no stack, along each of
        rows (0 deg) and columns (90 deg) that targets measure; curves "mtf_joint" and
        "mtf_joint_vertical"; evidence "joint MTF". All frequencies are cycles per column pitch.
        Empty with fewer than two valid targets.

    Notes
    -----
    Likelihood normal in the principal components of each target's curve and in each bar group's
    value. The draws are those of every form of the core in proportion to its evidence (Laplace). A
    p-value of all targets under 0.05 is noted with the name of the target that deviates most; under
    0.01 the flag is `model-misfit`.
    """
    sound, bounds = constraints_from(result, kinds, context)
    if len({constraint.target for constraint in sound}) < 2:
        return Result()
    joint = _fit_and_draw(sound, bounds, context)
    shares = ", ".join(f"{name} {100 * weight:.0f} %" for name, weight in joint.forms.items())
    settings = {"quick": context.quick, "forms": shares, "targets": joint.test["target"]}
    common = {
        "method": "joint",
        "notes": _notes(joint.test, shares),
        "provenance": Provenance(version=charact.__version__, seed=context.seed, settings=settings),
    }
    measurements: list[Measurement] = []
    curves = {}
    for vertical in _directions(sound):
        direction_settings = {**common, "orientation_deg": 90.0 if vertical else 0.0}
        fine, pinned = joint.mtf(FINE, vertical), joint.mtf(np.array(PINNED), vertical)
        measurements += [
            *(
                _crossing_frequency(name, level, fine, joint, direction_settings)
                for name, level in (("mtf50", 0.5), ("mtf10", 0.1))
            ),
            *(
                measurement_from_draws(
                    "mtf", "1", values, frequency_cy_per_px=frequency, **direction_settings
                )
                for frequency, values in zip(PINNED, pinned.T, strict=True)
            ),
        ]
        name = "mtf_joint_vertical" if vertical else "mtf_joint"
        curves[name] = curve_of(REPORTED, joint.mtf(np.maximum(REPORTED, 1e-6), vertical))
    findings = _findings(joint)
    return Result(
        measurements=tuple(judge(measurement, findings) for measurement in measurements),
        curves=curves,
        evidence={"joint MTF": {**joint.test, "forms": joint.forms}},
    )


def _directions(sound: Sequence[MtfConstraint]) -> list[bool]:
    """Return which of rows (False) and columns (True) have targets."""
    off = np.concatenate(
        [np.abs((np.rad2deg(constraint.angle_rad) + 90.0) % 180.0 - 90.0) for constraint in sound]
    )
    has_axis = {False: off < THRESHOLDS.near_axis_deg, True: off > 90.0 - THRESHOLDS.near_axis_deg}
    return [vertical for vertical, has in has_axis.items() if has.any()] or [False]


def _fit_and_draw(
    sound: Sequence[MtfConstraint], bounds: Sequence[MtfConstraint], context: Context
) -> JointMtf:
    """Fit every form and draw from those that the data leave open."""
    elliptical, known = len(_directions(sound)) == 2, KnownCameraTransfer.of(context)
    # The halo of a described intensifier counts where a target's window contains all of it.
    halo = None
    if has_tube(context.camera) and not all(constraint.excludes_halo for constraint in sound):
        halo = HaloComponent(size_px=halo_diameters_px(context, transposed=False))
    forms = [
        JointBlurModel(core=core, blurred=blurred, wide=halo, elliptical=elliptical, known=known)
        for core, blurred in CORES
    ]
    fits = [
        fit_joint_model(JointLikelihood(form=form, constraints=sound, bounds=bounds))
        for form in forms
    ]
    fits.sort(key=lambda fit: -fit.log_evidence)
    shares = np.exp([fit.log_evidence - fits[0].log_evidence for fit in fits])
    shares /= shares.sum()
    likely = shares > THRESHOLDS.min_model_weight
    fits, shares = (
        [fit for fit, keep in zip(fits, likely, strict=True) if keep],
        shares[likely] / shares[likely].sum(),
    )
    posteriors = [
        _posterior(fit, context, context.seed + number) for number, fit in enumerate(fits)
    ]
    return JointMtf(fits=fits, shares=shares, posteriors=posteriors, test=consistency_test(fits[0]))


def _posterior(fit: JointFit, context: Context, seed: int) -> Posterior:
    """Draw from one form's posterior, by importance before a Markov chain.

    Two blurs in a row trade off along a bent ridge, on which a Markov chain is slow.
    """
    form = fit.problem.form
    asked = {
        "names": form.names,
        "units": form.units,
        "start": fit.point,
        "covariance": fit.covariance,
        "seed": seed,
        "bounds": form.bounds,
        "draws": DRAWS,
    }
    if context.quick:
        return importance_sample(fit.problem.log_probability, **asked)
    return sample_posterior(fit.problem.log_probability, **asked, max_steps=3000)


def _findings(joint: JointMtf) -> list[Finding]:
    """Return the findings of the joint MTF, none of which has a bound."""
    flags = {
        flag for posterior in joint.posteriors for flag in posterior.flags if flag != "prior-bound"
    }
    for fit, posterior in zip(joint.fits, joint.posteriors, strict=True):
        chosen = np.array([name not in NATURAL_BOUNDS for name in posterior.names])
        if crowds_at_bound(posterior.draws, fit.problem.form.bounds)[chosen].any():
            flags.add("prior-bound")
    target_p_values = joint.test["apart_probability"]
    # Bonferroni over the targets.
    lowest_p_value = min(joint.test["probability"], min(target_p_values) * len(target_p_values))
    if lowest_p_value < THRESHOLDS.misfit_p_value:
        flags.add("model-misfit")
    return [
        Finding(flag=flag, effect=effect, remedy=remedy)
        for flag, (effect, remedy) in FINDINGS.items()
        if flag in flags
    ]


def _notes(test: dict[str, Any], shares: str) -> tuple[str, ...]:
    notes = [f"Joint fit to {', '.join(dict.fromkeys(test['target']))}; blur model: {shares}."]
    if not test["inside_joint_95_percent_region"]:
        notes.append(
            "The targets lie outside their joint 95 % region (chi squared "
            f"{test['chi_squared']:.1f} for {test['degrees_of_freedom']:.1f} degrees of freedom, "
            f"chance {test['probability']:.2g}); {test['differs_most']} differs most from the "
            "others."
        )
    return tuple(notes)


def _crossing_frequency(
    quantity: str, level: float, fine: Array, joint: JointMtf, common: dict
) -> Measurement:
    """Return the frequency at which the MTF falls to a level; refused where it does not in 2 % of
    the draws.
    """
    draws = crossing_frequency(FINE, fine, level)
    known = np.isfinite(draws)
    if (lost := 100 * np.mean(~known)) > 2.0:
        reason = (
            f"the MTF must fall to {level:g} below {FINE[-1]:.1f} cy/px, and {lost:.0f} % of "
            f"its draws do not"
        )
        return make_refusal(quantity, "cy/px", reason, **common)
    return measurement_from_draws(
        quantity, "cy/px", draws[known], posterior=joint.posteriors[0], **common
    )
