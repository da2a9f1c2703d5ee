"""One MTF fitted to all targets of a session: edges, bars, points, and the noise of flats as a bound."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, log_ndtr, ndtr

import charact
from charact.method import Context
from charact.method.stopwatch import with_timing
from charact.mtf.blur_models.one_dimensional import Core, HaloComponent
from charact.mtf.curve import FINE, PINNED, REPORTED, crossing_frequency, curve_of
from charact.mtf.known_transfer import halo_diameters_px
from charact.mtf.session.constraints import MtfConstraint, constraints_from
from charact.mtf.session.joint_model import JointBlurModel, KnownCameraTransfer
from charact.mtf.session.thresholds import ACCURACY, THRESHOLDS
from charact.posterior import find_maximum, importance_sample, sample_posterior
from labdata.measurement import Measurement, Posterior, Provenance, Result, make_refusal, measurement_from_draws

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class JointLikelihood:
    """One form and what it has to explain.

    Parameters
    ----------
    form
        Form of the transfer.
    constraints
        What the targets say of the MTF.
    bounds
        What the noise of flats says of the part behind the gain: no less than the whole.
    """

    form: JointBlurModel
    constraints: Sequence[MtfConstraint]
    bounds: Sequence[MtfConstraint] = ()

    def residual(self, theta: Array) -> Array:
        """Return all whitened residuals, shape (n, combination)."""
        return self._residuals(theta)[:, : self._combinations]

    def below_bounds(self, theta: Array) -> Array:
        """Return by how many standard deviations the MTF lies below each bound, shape (n, bound)."""
        return self._residuals(theta)[:, self._combinations :]

    @cached_property
    def _combinations(self) -> int:
        return sum(one.value.size for one in self.constraints)

    @cached_property
    def _places(self) -> tuple[Array, Array, NDArray[np.bool_], Array, Array | None]:
        """Frequencies of all targets, one after the other, along rows and columns; whether within; what is known."""
        every = (*self.constraints, *self.bounds)
        frequency, angle = (np.concatenate(of) for of in zip(*((o.frequency, o.angle_rad) for o in every), strict=True))
        within = np.concatenate([np.full(one.frequency.size, one.within) for one in every])
        fx, fy = np.abs(frequency * np.cos(angle)), np.abs(frequency * np.sin(angle))
        return fx, fy, within, self.form.known(fx, fy), self.form.known.bend(fx)

    def _residuals(self, theta: Array) -> Array:
        """Return whitened residuals of targets and bounds; each MTF is needed at all its places together."""
        fx, fy, within, known, bend = self._places
        mtf = known * self.form.unknown(theta, fx, fy, bend=bend, within=within)
        last, parts = 0, []
        for one in (*self.constraints, *self.bounds):
            first, last = last, last + one.frequency.size
            parts.append(one.residual(mtf[:, first:last]))
        return np.concatenate(parts, axis=1)

    def log_probability(self, theta: Array) -> Array:
        """Return ln of the posterior density but for a constant, shape (n, parameter) -> (n,).

        Notes
        -----
        Normal in every combination. Light moved before the gain lowers the whole MTF by any share of what is behind
        the gain, so a transfer measured there as P +- s has the likelihood Phi((P - M)/s).
        """
        walls = self.form.bounds
        safe = np.clip(theta, walls[:, 0], walls[:, 1])
        residuals = self._residuals(safe)
        targets, bounds = np.split(residuals, [self._combinations], axis=1)
        fit = -0.5 * np.sum(targets**2, axis=1) + np.sum(log_ndtr(bounds), axis=1)
        return self.form.log_prior(theta) + fit


@dataclass(frozen=True, kw_only=True)
class JointFit:
    """The peak of a problem, the slope of its residuals there, its covariance, and ln of its evidence by Laplace."""

    problem: JointLikelihood
    point: Array
    slope: Array
    covariance: Array
    log_evidence: float

    @property
    def taken(self) -> Array:
        """Share of the residuals' noise that the fit takes up, shape (combination, combination)."""
        walls = self.problem.form.bounds
        away = np.minimum(self.point - walls[:, 0], walls[:, 1] - self.point)
        free = away > 1e-6 * (walls[:, 1] - walls[:, 0])
        held = np.linalg.inv(np.linalg.inv(self.covariance)[np.ix_(free, free)])
        return self.slope[:, free] @ held @ self.slope[:, free].T


def fit_joint_model(problem: JointLikelihood) -> JointFit:
    """Optimise from the best of many half frequencies; return the optimum with its Gauss-Newton curvature."""
    walls = problem.form.bounds
    start = np.tile(problem.form.start, (24, 1))
    start[:, 0] = np.linspace(walls[0, 0], walls[0, 1], 26)[1:-1]
    begun = start[int(np.argmax(problem.log_probability(start)))]
    point, _ = find_maximum(problem.log_probability, begun, walls, iterations=ACCURACY.newton_steps)
    slope = _slope(problem.residual, point, walls)
    bound_slope = _slope(problem.below_bounds, point, walls)
    below = problem.below_bounds(point[None])[0]
    # Curvature of -ln Phi(z): h (h + z), h the density over Phi.
    ratio = np.exp(-0.5 * below**2 - 0.5 * np.log(2.0 * np.pi) - log_ndtr(below))
    bend = bound_slope.T @ ((ratio * (ratio + below))[:, None] * bound_slope)
    covariance = np.linalg.inv(slope.T @ slope + bend + np.diag(problem.form.prior_precision))
    height = float(problem.log_probability(point[None])[0])
    volume = 0.5 * float(np.linalg.slogdet(2.0 * np.pi * covariance)[1])
    return JointFit(problem=problem, point=point, slope=slope, covariance=covariance, log_evidence=height + volume)


def _slope(values: Callable[[Array], Array], point: Array, walls: Array) -> Array:
    """Return how values move with the parameters, shape (value, parameter), by differences inside the walls."""
    moves = np.diag(1e-4 * (walls[:, 1] - walls[:, 0]))
    high = np.clip(point + moves, walls[:, 0], walls[:, 1])
    low = np.clip(point - moves, walls[:, 0], walls[:, 1])
    return ((values(high) - values(low)) / np.diag(high - low)[:, None]).T


@dataclass(frozen=True, kw_only=True)
class ConsistencyTest:
    """Whether the targets tell of one MTF.

    Parameters
    ----------
    chi2, freedom, probability
        Chi squared of all combinations against the joint curve, its degrees of freedom, and the chance of one as large.
    targets, values
        Name of each target and the number of its values.
    leave_one_out_chi2, leave_one_out_p_value
        Chi squared of each target against the curve of all the others, and the chance of one as large.
    residuals
        Whitened residuals of each target, shape (combination,) each.
    """

    chi2: float
    freedom: float
    probability: float
    targets: tuple[str, ...]
    values: tuple[int, ...]
    leave_one_out_chi2: tuple[float, ...]
    leave_one_out_p_value: tuple[float, ...]
    residuals: tuple[tuple[float, ...], ...]

    @property
    def most_deviating(self) -> str:
        """The target that fits the others least."""
        return self.targets[int(np.argmin(self.leave_one_out_p_value))]


def consistency_test(fit: JointFit) -> ConsistencyTest:
    """Test a fit.

    Notes
    -----
    With J the slope of the whitened residuals and C the covariance of the parameters that lean on no bound,
    H = J C J^T is the share of each residual's noise that the fit takes up: chi squared r.r has N - tr H degrees of
    freedom, and r_t (1 - H_tt)^-1 r_t is that of target t, with one degree of freedom per value, against the
    curve of the others, whose error it contains (leave-one-out in linear theory). A bound
    violated by z standard deviations adds z^2.
    """
    problem, point = fit.problem, fit.point
    residual = problem.residual(point[None])[0]
    taken = fit.taken
    below = problem.below_bounds(point[None])[0]
    total = float(residual @ residual + np.sum(np.minimum(below, 0.0) ** 2))
    freedom = float(max(residual.size - np.trace(taken), 0.0))
    apart, chances, parts, first = [], [], [], 0
    for one in problem.constraints:
        own = slice(first, first + one.value.size)
        first += one.value.size
        left = np.eye(one.value.size) - taken[own, own]
        value, count = _leave_one_out_chi2(residual[own], left)
        apart.append(value)
        chances.append(float(chdtrc(count, value)) if count else 1.0)
        parts.append(tuple(residual[own].tolist()))
    return ConsistencyTest(
        chi2=total,
        freedom=freedom,
        probability=float(chdtrc(freedom, total)) if freedom > 0.05 else 1.0,
        targets=(*(one.target for one in problem.constraints), *(one.target for one in problem.bounds)),
        values=(*(one.value.size for one in problem.constraints), *(1 for _ in problem.bounds)),
        leave_one_out_chi2=(*apart, *(np.minimum(below, 0.0) ** 2).tolist()),
        leave_one_out_p_value=(*chances, *ndtr(below).tolist()),
        residuals=(*parts, *((float(min(z, 0.0)),) for z in below)),
    )


def _leave_one_out_chi2(residual: Array, left: Array) -> tuple[float, int]:
    """Return chi squared of one target against the others and its degrees of freedom."""
    variance, axes = np.linalg.eigh(0.5 * (left + left.T))
    compared = variance > THRESHOLDS.min_compared
    along = axes[:, compared].T @ residual
    return float(np.sum(along**2 / variance[compared])), int(compared.sum())


METHOD = "joint"
DRAWS = 1000
CORES: tuple[tuple[Core, bool], ...] = (
    ("gaussian", False), ("exponential", False), ("moffat", False), ("exponential", True),
)  # fmt: skip
NATURAL_BOUNDS = ("blur_px2", "halo_fraction", "halo_elastic_share", "moffat_exponent", "halo_diameter_px")


@dataclass(frozen=True, kw_only=True)
class JointMtf:
    """All that a joint fit found: forms with their share of the evidence and draws, and the test of the best."""

    fits: Sequence[JointFit]
    shares: Array
    posteriors: Sequence[Posterior]
    verdict: ConsistencyTest

    def mtf(self, frequency: Array, vertical: bool) -> Array:
        """Return drawn MTFs along rows or along columns, cycles per column pitch, shape (draw, f)."""
        none = np.zeros_like(frequency)
        fx, fy = (none, frequency) if vertical else (frequency, none)
        return np.concatenate([
            fit.problem.form.transfer(posterior.draws[: max(1, round(DRAWS * share))], fx, fy)
            for fit, posterior, share in zip(self.fits, self.posteriors, self.shares, strict=True)
        ])  # fmt: skip


@with_timing
def fit_joint_mtf(result: Result, kinds: Mapping[str, str], *, context: Context) -> Result:
    """Fit one MTF to all targets of a session and test their consistency.

    Parameters
    ----------
    result
        Measurements and curves of one session; only sound (ok) ones are used.
    kinds
        Kind of each stack ("edge", "bars", "point") by its label.
    context
        Seed, whether a Markov chain may be run, and the camera. Without a description of an intensifier no halo is
        looked for.

    Returns
    -------
    Result
        `mtf50`, `mtf10` and `mtf` at pinned frequencies, method "joint" and no stack, along each of rows (0 deg) and
        columns (90 deg) of which targets tell; curves "mtf_joint" and "mtf_joint_vertical"; evidence "joint MTF".
        All frequencies are cycles per column pitch. Empty where fewer than two targets are sound.

    Notes
    -----
    Likelihood normal in the principal components of each target's curve and in each bar group's value. The draws are
    those of every form of the core in proportion to its evidence (Laplace). Where chi squared of all targets has a
    chance under 0.05 a note says so and names the one that differs most; under 0.01 the flag is `model-misfit`.
    """
    sound, bounds = constraints_from(result, kinds, context)
    if len({one.target for one in sound}) < 2:
        return Result()
    found = _fit_and_draw(sound, bounds, context)
    common = {
        "method": METHOD,
        "flags": _flags(found),
        "notes": _notes(found),
        "provenance": Provenance(
            version=charact.__version__,
            seed=context.seed,
            settings={"quick": context.quick, "forms": _forms(found), "targets": list(found.verdict.targets)},
        ),
    }
    measurements: list[Measurement] = []
    curves = {}
    for vertical in _directions(sound):
        own = {**common, "orientation_deg": 90.0 if vertical else 0.0}
        fine = found.mtf(FINE, vertical)
        measurements += [
            _crossing_frequency(name, level, fine, found, own) for name, level in (("mtf50", 0.5), ("mtf10", 0.1))
        ]
        pinned = found.mtf(np.array(PINNED), vertical)
        measurements += [
            measurement_from_draws("mtf", "1", values, frequency_cy_per_px=frequency, **own)
            for frequency, values in zip(PINNED, pinned.T, strict=True)
        ]
        name = "mtf_joint_vertical" if vertical else "mtf_joint"
        curves[name] = curve_of(REPORTED, found.mtf(np.maximum(REPORTED, 1e-6), vertical))
    return Result(
        measurements=tuple(measurements),
        curves=curves,
        evidence={"joint MTF": _figure_data(found, sound)},
    )


def _directions(sound: Sequence[MtfConstraint]) -> list[bool]:
    """Whether rows (False) and columns (True) have targets that tell of them."""
    off = np.concatenate([np.abs((np.rad2deg(one.angle_rad) + 90.0) % 180.0 - 90.0) for one in sound])
    ways = [
        way
        for way, tells in (
            (False, np.any(off < THRESHOLDS.near_axis_deg)),
            (True, np.any(off > 90.0 - THRESHOLDS.near_axis_deg)),
        )
        if tells
    ]
    return ways or [False]


def _fit_and_draw(sound: Sequence[MtfConstraint], bounds: Sequence[MtfConstraint], context: Context) -> JointMtf:
    """Fit every form and draw from those that the data leave open."""
    elliptical = len(_directions(sound)) == 2
    known = KnownCameraTransfer.of(context)
    wide = _halo(sound, context)
    forms = [JointBlurModel(core=core, blurred=blurred, wide=wide, elliptical=elliptical, known=known)
             for core, blurred in CORES]  # fmt: skip
    fits = [fit_joint_model(JointLikelihood(form=form, constraints=sound, bounds=bounds)) for form in forms]
    fits.sort(key=lambda fit: -fit.log_evidence)
    shares = np.exp([fit.log_evidence - fits[0].log_evidence for fit in fits])
    shares /= shares.sum()
    kept = shares > THRESHOLDS.min_model_weight
    fits, shares = [fit for fit, keep in zip(fits, kept, strict=True) if keep], shares[kept] / shares[kept].sum()
    posteriors = [_posterior(fit, context, context.seed + number) for number, fit in enumerate(fits)]
    return JointMtf(fits=fits, shares=shares, posteriors=posteriors, verdict=consistency_test(fits[0]))


def _halo(sound: Sequence[MtfConstraint], context: Context) -> HaloComponent | None:
    """A described intensifier has a halo, which counts where a target saw all of it."""
    if context.sensor is None or all(one.within for one in sound):
        return None
    return HaloComponent(size_px=halo_diameters_px(context, transposed=False))


def _posterior(fit: JointFit, context: Context, seed: int) -> Posterior:
    """Draw from one form's posterior, by importance before a Markov chain.

    Two blurs in a row can be traded for each other along a bent ridge, of which the curvature knows the middle only,
    and along which a Markov chain is slow.
    """
    form = fit.problem.form
    asked = {
        "names": tuple(form.parameters),
        "units": tuple(unit for unit, _ in form.parameters.values()),
        "start": fit.point,
        "covariance": fit.covariance,
        "seed": seed,
        "bounds": form.bounds,
        "draws": DRAWS,
    }
    if context.quick:
        return importance_sample(fit.problem.log_probability, **asked)
    return sample_posterior(fit.problem.log_probability, **asked, max_steps=ACCURACY.chain_steps)


def _flags(found: JointMtf) -> tuple[str, ...]:
    """What is distrusted; a bound that nature sets, no halo or electrons all elastic, is one to lean on."""
    from charact.posterior.diagnostics import crowds_at_bound

    flags = {flag for posterior in found.posteriors for flag in posterior.flags if flag != "prior-bound"}
    for fit, posterior in zip(found.fits, found.posteriors, strict=True):
        chosen = np.array([name not in NATURAL_BOUNDS for name in posterior.names])
        if crowds_at_bound(posterior.draws, fit.problem.form.bounds)[chosen].any():
            flags.add("prior-bound")
    if found.verdict.probability < THRESHOLDS.misfit_p_value or min(
        found.verdict.leave_one_out_p_value
    ) < THRESHOLDS.misfit_p_value / len(found.verdict.targets):
        flags.add("model-misfit")
    return tuple(flags)


def _notes(found: JointMtf) -> tuple[str, ...]:
    test = found.verdict
    notes = [f"Joint fit to {', '.join(dict.fromkeys(test.targets))}; blur model: {_forms(found)}."]
    if test.probability < THRESHOLDS.inconsistent_p_value:
        notes.append(
            f"The targets lie outside their joint 95 % region (chi squared {test.chi2:.1f} for {test.freedom:.1f} "
            f"degrees of freedom, chance {test.probability:.2g}); {test.most_deviating} differs most from the others."
        )
    return tuple(notes)


def _forms(found: JointMtf) -> str:
    named = zip(found.fits, found.shares, strict=True)
    return ", ".join(f"{fit.problem.form.name} {100 * share:.0f} %" for fit, share in named)


def _crossing_frequency(quantity: str, level: float, fine: Array, found: JointMtf, common: dict) -> Measurement:
    """Return the frequency at which the MTF falls to a level; refused where it does not below the last one."""
    draws = crossing_frequency(FINE, fine, level)
    known = np.isfinite(draws)
    if np.mean(~known) > 0.02:
        lost = 100 * np.mean(~known)
        reason = f"the MTF must fall to {level:g} below {FINE[-1]:.1f} cy/px, and {lost:.0f} % of its draws do not"
        return make_refusal(quantity, "cy/px", reason, **common)
    return measurement_from_draws(quantity, "cy/px", draws[known], posterior=found.posteriors[0], **common)


def _figure_data(found: JointMtf, sound: Sequence[MtfConstraint]) -> dict:
    test = found.verdict
    kinds = {one.target: one.kind for one in sound}
    return {
        "figure": "joint-mtf",
        "counts_halo": found.fits[0].problem.form.wide is not None,
        "target": list(test.targets),
        "kind": [kinds.get(target, "noise spectrum") for target in test.targets],
        "values": list(test.values),
        "residuals_sd": [list(one) for one in test.residuals],
        "apart_chi_squared": list(test.leave_one_out_chi2),
        "apart_probability": list(test.leave_one_out_p_value),
        "chi_squared": test.chi2,
        "degrees_of_freedom": test.freedom,
        "probability": test.probability,
        "inside_joint_95_percent_region": bool(test.probability >= THRESHOLDS.inconsistent_p_value),
        "differs_most": test.most_deviating,
        "forms": {fit.problem.form.name: float(share) for fit, share in zip(found.fits, found.shares, strict=True)},
    }
