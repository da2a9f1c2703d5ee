"""The fit of one transfer to all that targets told, and the test whether they told of one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, log_ndtr, ndtr

from charact.mtf.session.constraints import MtfConstraint
from charact.mtf.session.joint_model import JointBlurModel
from charact.posterior import find_maximum

Array = NDArray[np.float64]

# Newton steps of a climb: along a ridge, where two blurs are traded, more of them gain nothing that can be told.
STEPS = 20


@dataclass(frozen=True, kw_only=True)
class JointLikelihood:
    """One form and what it has to explain.

    Parameters
    ----------
    form
        Form of the transfer.
    told
        What the targets say of the MTF.
    bounds
        What the noise of flats says of the part behind the gain: no less than the whole.
    """

    form: JointBlurModel
    told: Sequence[MtfConstraint]
    bounds: Sequence[MtfConstraint] = ()

    def residual(self, theta: Array) -> Array:
        """Return all whitened residuals, shape (n, combination)."""
        return self._residuals(theta)[:, : self._combinations]

    def below_bounds(self, theta: Array) -> Array:
        """Return by how many standard deviations the MTF lies below each bound, shape (n, bound)."""
        return self._residuals(theta)[:, self._combinations :]

    @cached_property
    def _combinations(self) -> int:
        return sum(one.value.size for one in self.told)

    @cached_property
    def _places(self) -> tuple[Array, Array, NDArray[np.bool_], Array, Array | None]:
        """Frequencies of all targets, one after the other, along rows and columns; whether within; what is known."""
        every = (*self.told, *self.bounds)
        frequency, angle = (np.concatenate(of) for of in zip(*((o.frequency, o.angle_rad) for o in every), strict=True))
        within = np.concatenate([np.full(one.frequency.size, one.within) for one in every])
        fx, fy = np.abs(frequency * np.cos(angle)), np.abs(frequency * np.sin(angle))
        return fx, fy, within, self.form.known(fx, fy), self.form.known.bend(fx)

    def _residuals(self, theta: Array) -> Array:
        """Return whitened residuals of targets and bounds; each MTF is needed at all its places together."""
        fx, fy, within, known, bend = self._places
        mtf = known * self.form.unknown(theta, fx, fy, bend=bend, within=within)
        last, parts = 0, []
        for one in (*self.told, *self.bounds):
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
    """Climb from the best of many half frequencies and return the peak, with its curvature by Gauss and Newton."""
    walls = problem.form.bounds
    start = np.tile(problem.form.start, (24, 1))
    start[:, 0] = np.linspace(walls[0, 0], walls[0, 1], 26)[1:-1]
    begun = start[int(np.argmax(problem.log_probability(start)))]
    point, _ = find_maximum(problem.log_probability, begun, walls, iterations=STEPS)
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
        Name of each target and how many numbers it told.
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
    freedom, and r_t (1 - H_tt)^-1 r_t is that of target t, with as many as it told numbers, against the curve of the
    others, whose error it contains
    (leave-one-out in linear theory). A bound broken by z standard deviations adds z^2, a kept one nothing.
    """
    problem, point = fit.problem, fit.point
    residual = problem.residual(point[None])[0]
    taken = fit.taken
    below = problem.below_bounds(point[None])[0]
    total = float(residual @ residual + np.sum(np.minimum(below, 0.0) ** 2))
    freedom = float(max(residual.size - np.trace(taken), 0.0))
    apart, chances, parts, first = [], [], [], 0
    for one in problem.told:
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
        targets=(*(one.target for one in problem.told), *(one.target for one in problem.bounds)),
        values=(*(one.value.size for one in problem.told), *(1 for _ in problem.bounds)),
        leave_one_out_chi2=(*apart, *(np.minimum(below, 0.0) ** 2).tolist()),
        leave_one_out_p_value=(*chances, *ndtr(below).tolist()),
        residuals=(*parts, *((float(min(z, 0.0)),) for z in below)),
    )


# A combination that is known from one target alone has no others to be compared with.
ALONE = 0.02


def _leave_one_out_chi2(residual: Array, left: Array) -> tuple[float, int]:
    """Return chi squared of one target against the others and its degrees of freedom."""
    variance, axes = np.linalg.eigh(0.5 * (left + left.T))
    compared = variance > ALONE
    along = axes[:, compared].T @ residual
    return float(np.sum(along**2 / variance[compared])), int(compared.sum())
