"""The posterior of pulses in dark frames, from the characteristic functions of filtered pixels."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from charact.noise.events_law import Observed, Pulses
from charact.posterior import laplace, sample
from charact.posterior.curvature import root_of
from labdata.measurement import Posterior

Array = NDArray[np.float64]

NAMES = ("density", "height_dn", "relative_variance", "noise_dn2", "line_1", "line_2", "column_px", "row_px",
         "wings", "exponent", "glow", "glow_exposures")  # fmt: skip
UNITS = ("1/px", "DN", "1", "DN2", "1", "1", "px", "px", "1", "1", "1", "exposures")
# These are positive and fitted by their logarithms.
LOGARITHMIC = ("density", "height_dn", "noise_dn2", "column_px", "row_px", "glow_exposures")
BOUNDS = {
    "relative_variance": (0.01, 6.0),
    "line_1": (-0.3, 0.45),
    "line_2": (-0.3, 0.3),
    "column_px": (0.05, 6.0),
    "row_px": (0.05, 6.0),
    "wings": (-0.5, 4.0),
    "exponent": (0.7, 2.5),
    "glow": (0.0, 0.98),
    "glow_exposures": (0.15, 30.0),
}
Priors = dict[str, tuple[float, float]]
# Parameters that data alone leave open: mean and standard deviation of a normal prior.
PRIORS: Priors = {"line_1": (0.0, 0.2), "line_2": (0.0, 0.1), "exponent": (1.3, 0.2), "wings": (0.0, 1.0)}
# Share by which the law itself may be wrong: places and amplitudes are finite, and no spot is quite of its form.
TOLERANCE = 3e-4
# Where light lingers: a screen's decay is of one exponential only roughly.
LINGERING_TOLERANCE = 5e-3
# Places from which a fit starts: spots, px, and heights over the noise of a pixel.
START_WIDTHS_PX = (0.3, 0.7, 1.3, 2.2)
START_HEIGHTS = (2.0, 5.0, 12.0, 30.0, 80.0, 200.0)
ITERATIONS = 40
# Longest step of the expansion of the residuals in any parameter.
WIDEST = 0.5


@dataclass(frozen=True, kw_only=True)
class Peak:
    """The best pulses.

    Parameters
    ----------
    pulses
        Them.
    names
        Parameters that were fitted.
    point, covariance
        Place of the peak and its covariance, logarithms where positive, shape (parameter,) and (parameter, parameter).
    chi2, freedom
        Squared residuals over their variance, and degrees of freedom.
    """

    pulses: Pulses
    names: tuple[str, ...]
    point: Array
    covariance: Array
    chi2: float
    freedom: int

    @property
    def chance(self) -> float:
        """Probability of a larger chi2 by chance."""
        from scipy.special import gammaincc

        return float(gammaincc(0.5 * self.freedom, 0.5 * self.chi2))


class Problem:
    """Residuals of pulses against what was observed, whitened, with those of the priors behind them."""

    def __init__(self, observed: Observed, covariance: Array, *, lag: bool, priors: Priors,
                 row_pitch: float = 1.0) -> None:  # fmt: skip
        self.observed, self.row_pitch = observed, row_pitch
        self.names = NAMES if lag else NAMES[:-2]
        self.priors = dict(priors)
        size, tolerance = np.abs(observed.value), LINGERING_TOLERANCE if lag else TOLERANCE
        covariance = covariance + np.diag((tolerance * size) ** 2 + 1e-24)
        self.root = np.linalg.inv(np.linalg.cholesky(covariance))
        self.walls = np.array([self._wall(name) for name in self.names])

    def _wall(self, name: str) -> tuple[float, float]:
        low, high = BOUNDS.get(name, (1e-12, 1e12))
        return (np.log(low), np.log(high)) if name in LOGARITHMIC else (low, high)

    def pulses(self, point: Array) -> Pulses:
        """Pulses of a point."""
        value = {name: float(np.exp(x)) if name in LOGARITHMIC else float(x)
                 for name, x in zip(self.names, point, strict=True)}  # fmt: skip
        return Pulses(**value, row_pitch=self.row_pitch)

    def point(self, pulses: Pulses) -> Array:
        """Point of pulses, inside the walls."""
        value = [getattr(pulses, name) for name in self.names]
        point = [np.log(x) if name in LOGARITHMIC else x for name, x in zip(self.names, value, strict=True)]
        return np.clip(np.array(point), self.walls[:, 0], self.walls[:, 1])

    def residual(self, point: Array) -> Array:
        """Whitened residuals, priors last."""
        data = self.root @ (self.observed.value - self.observed.predicted(self.pulses(point)))
        prior = [(point[self.names.index(name)] - mean) / sd for name, (mean, sd) in self.priors.items()]
        return np.concatenate([data, prior])

    def noise_alone(self) -> Array:
        """Return what noise of unit variance without pulses predicts, whitened."""
        none = Pulses(density=0.0, height_dn=1.0, relative_variance=1.0, noise_dn2=1.0, line_1=0.0, line_2=0.0,
                      column_px=1.0, row_px=1.0, wings=0.0, exponent=1.3)  # fmt: skip
        return self.root @ self.observed.predicted(none)

    def without_pulses(self) -> float:
        """Return chi2 of the noise alone, at its best."""
        white, target = self.noise_alone(), self.root @ self.observed.value
        rest = target - max(float(white @ target / (white @ white)), 0.0) * white
        return float(rest @ rest)

    def jacobian(self, point: Array, at: Array) -> Array:
        """Derivatives of the residuals by steps into the inside."""
        columns = []
        for index in range(len(point)):
            step = 1e-3 if point[index] + 1e-3 < self.walls[index, 1] else -1e-3
            moved = point.copy()
            moved[index] += step
            columns.append((self.residual(moved) - at) / step)
        return np.stack(columns, axis=1)


def started(problem: Problem, pixel_noise_dn: float, glow: tuple[float, float] = (0.0, 1.0)) -> Pulses:
    """Return the best of a few guesses; density and noise enter linearly and follow for each."""
    observed, best = problem.observed, None
    target, noise = problem.root @ observed.value, problem.noise_alone()
    for width in START_WIDTHS_PX:
        for height in START_HEIGHTS:
            guess = Pulses(
                density=1.0,
                height_dn=height * pixel_noise_dn,
                relative_variance=1.0,
                noise_dn2=0.0,
                line_1=0.0,
                line_2=0.0,
                column_px=width,
                row_px=max(width / problem.row_pitch, 0.1),
                wings=0.0,
                exponent=1.3,
                glow=glow[0],
                glow_exposures=glow[1],
                row_pitch=problem.row_pitch,
            )
            design = np.stack([problem.root @ observed.predicted(guess), noise], axis=1)
            density, white = np.maximum(np.linalg.lstsq(design, target, rcond=None)[0], 0.0)
            density, white = max(density, 1e-9), max(white, 1e-3 * pixel_noise_dn**2)
            misfit = float(np.sum((target - design @ [density, white]) ** 2))
            if best is None or misfit < best[0]:
                best = misfit, Pulses(**{**_plain(guess), "density": density, "noise_dn2": white})
    assert best is not None
    return best[1]


def _plain(pulses: Pulses) -> dict[str, float]:
    return {field.name: getattr(pulses, field.name) for field in fields(pulses)}


def climbed(problem: Problem, start: Pulses) -> Peak:
    """Return the peak near a start by damped Gauss-Newton steps."""
    point, damping = problem.point(start), 1e-2
    at = problem.residual(point)
    jacobian = problem.jacobian(point, at)
    for _ in range(ITERATIONS):
        curvature = jacobian.T @ jacobian
        step = np.linalg.solve(curvature + damping * np.diag(np.diag(curvature) + 1e-12), -jacobian.T @ at)
        fresh = np.clip(point + np.clip(step, -1.0, 1.0), problem.walls[:, 0], problem.walls[:, 1])
        there = problem.residual(fresh)
        gain = float(at @ at - there @ there)
        if not gain > 0.0:
            damping *= 10.0
            if damping > 1e6:
                break
            continue
        point, at, damping = fresh, there, damping / 5.0
        jacobian = problem.jacobian(point, at)
        if gain < 1e-3:
            break
    inverse = np.asarray(np.linalg.pinv(jacobian.T @ jacobian), np.float64)
    data = at[: -len(problem.priors)]
    return Peak(pulses=problem.pulses(point), names=problem.names, point=point, covariance=inverse,
                chi2=float(data @ data), freedom=len(data) - len(point) + len(problem.priors))  # fmt: skip


def drawn(problem: Problem, peak: Peak, *, seed: int, quick: bool) -> Posterior:
    """Return the posterior: of the logarithms where parameters are positive, then turned back.

    A chain would ask for the law too often: around the peak the residuals are replaced by their second-order
    expansion, exact enough over the few standard deviations that matter.
    """
    if quick:
        found = laplace(None, names=peak.names, units=UNITS[: len(peak.names)], start=peak.point,  # type: ignore[arg-type]
                        covariance=peak.covariance, seed=seed, bounds=problem.walls)  # fmt: skip
    else:
        found = sample(_expanded(problem, peak), names=peak.names, units=UNITS[: len(peak.names)], start=peak.point,
                       covariance=peak.covariance, seed=seed, bounds=problem.walls)  # fmt: skip
    draws = found.draws.copy()
    for index, name in enumerate(peak.names):
        if name in LOGARITHMIC:
            draws[:, index] = np.exp(draws[:, index])
    # Spots without wings, and a screen whose glow cannot be timed, lean on their bounds and harm nothing.
    flags = tuple(flag for flag in found.flags if flag != "prior-bound")
    return replace(found, draws=draws, flags=flags)


def _expanded(problem: Problem, peak: Peak) -> Callable[[Array], Array]:
    """Log-probability from the residuals' second-order expansion along the axes of the posterior."""
    size, root = len(peak.point), root_of(peak.covariance)
    whole = np.clip(root, *(np.array([[-1.0], [1.0]]) * WIDEST))
    at = problem.residual(peak.point)

    def moved(*steps: tuple[int, float]) -> Array:
        point = peak.point + sum(amount * whole[:, index] for index, amount in steps)
        return problem.residual(np.clip(point, problem.walls[:, 0], problem.walls[:, 1]))

    up, down = ([moved((i, sign)) for i in range(size)] for sign in (1.0, -1.0))
    first = np.stack([0.5 * (u - d) for u, d in zip(up, down, strict=True)])
    second = np.zeros((size, size, len(at)))
    for i in range(size):
        second[i, i] = up[i] + down[i] - 2.0 * at
        for j in range(i):
            both_up = moved((i, 1.0), (j, 1.0))
            second[i, j] = second[j, i] = both_up - up[i] - up[j] + at
    inverse = np.linalg.pinv(whole)
    flat = second.reshape(size * size, -1)

    def log_probability(points: Array) -> Array:
        inner = np.all((points >= problem.walls[:, 0]) & (points <= problem.walls[:, 1]), axis=1)
        step = (points - peak.point) @ inverse.T
        product = (step[:, :, None] * step[:, None, :]).reshape(len(step), -1)
        residual = at + step @ first + 0.5 * product @ flat
        return np.where(inner, -0.5 * np.sum(residual**2, axis=1), -np.inf)

    return log_probability
