"""The posterior of pulses in dark frames, from the characteristic functions of filtered pixels."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.noise.events.event_distribution import CharacteristicFunctionData, PulsePopulation
from charact.posterior import laplace
from labdata.measurement import Posterior

Array = NDArray[np.float64]

UNITS = {"density": "1/px", "height_dn": "DN", "relative_variance": "1", "noise_dn2": "DN2", "line_1": "1",
         "line_2": "1", "column_px": "px", "row_px": "px", "wings": "1", "exponent": "1", "glow": "1",
         "glow_exposures": "exposures", "fast_exposures": "exposures"}  # fmt: skip
SLOW, FAST = ("glow", "glow_exposures"), ("fast_exposures",)
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
    "glow_exposures": (0.3, 15.0),
    "fast_exposures": (0.0, 0.6),
}
Priors = dict[str, tuple[float, float]]
# Parameters that data alone leave open: mean and standard deviation of a normal prior, of the logarithm where positive.
PRIORS: Priors = {"line_1": (0.0, 0.2), "line_2": (0.0, 0.1), "exponent": (1.3, 0.2), "wings": (0.0, 1.0)}
# Share by which the law itself may be wrong: places and amplitudes are finite, and no spot is quite of its form.
TOLERANCE = 1e-3
# Places from which a fit starts: spots, px, and heights over the noise of a pixel.
START_WIDTHS_PX = (0.3, 0.7, 1.3, 2.2)
START_HEIGHTS = (2.0, 5.0, 12.0, 30.0, 80.0, 200.0)
# Step by which derivatives are taken.
STEP = 4e-3
ITERATIONS = 60
# Fall of chi2 at which a climb ends, and at which a rough one does.
ENOUGH, ROUGHLY = 0.01, 0.5


@dataclass(frozen=True, kw_only=True)
class PulseOptimum:
    """The best pulses.

    Parameters
    ----------
    pulses
        Them.
    point
        Their place, logarithms where positive, shape (parameter,).
    predicted, derivative
        What they predict and its derivative by the point, shapes (value,) and (value, parameter).
    covariance
        Covariance of the point, shape (parameter, parameter).
    chi2, freedom
        Squared residuals over their variance, and degrees of freedom.
    """

    pulses: PulsePopulation
    point: Array
    predicted: Array
    derivative: Array
    covariance: Array
    chi2: float
    freedom: int

    @property
    def chance(self) -> float:
        """Probability of a larger chi2 by chance."""
        from scipy.special import gammaincc

        return float(gammaincc(0.5 * self.freedom, 0.5 * self.chi2))


@dataclass(frozen=True, kw_only=True)
class PulseLikelihood:
    """Which parameters of pulses are to be found, from what.

    Parameters
    ----------
    observed
        What the frames show.
    names
        Parameters to be found.
    priors
        What is known of some of them.
    fixed
        Pulses whose other parameters hold.
    """

    observed: CharacteristicFunctionData
    names: tuple[str, ...]
    priors: Priors
    fixed: PulsePopulation

    @cached_property
    def walls(self) -> Array:
        """Bounds of every parameter, shape (parameter, 2)."""
        limits = [(name, *BOUNDS.get(name, (1e-12, 1e12))) for name in self.names]
        return np.array([np.log(pair) if name in LOGARITHMIC else pair for name, *pair in limits])

    @cached_property
    def known(self) -> tuple[Array, Array]:
        """Means of the parameters' priors and one over their standard deviations, 0 where there is none."""
        prior = [self.priors.get(name, (0.0, np.inf)) for name in self.names]
        return np.array([mean for mean, _ in prior]), np.array([1.0 / sd for _, sd in prior])

    def pulses(self, point: Array) -> PulsePopulation:
        """Pulses of a point."""
        value = {name: float(np.exp(x)) if name in LOGARITHMIC else float(x)
                 for name, x in zip(self.names, point, strict=True)}  # fmt: skip
        return replace(self.fixed, **value)

    def point(self, pulses: PulsePopulation) -> Array:
        """Point of pulses, inside the walls."""
        value = [getattr(pulses, name) for name in self.names]
        point = [np.log(x) if name in LOGARITHMIC else x for name, x in zip(self.names, value, strict=True)]
        return np.clip(np.array(point), self.walls[:, 0], self.walls[:, 1])

    def predicted(self, point: Array) -> Array:
        """Return what the pulses of a point predict, shape (value,)."""
        return self.observed.predicted(self.pulses(point))

    def derivative(self, point: Array, at: Array) -> Array:
        """Derivatives of the prediction by steps into the inside, shape (value, parameter)."""
        columns = []
        for index in range(len(point)):
            step = STEP if point[index] + STEP < self.walls[index, 1] else -STEP
            moved = point.copy()
            moved[index] += step
            columns.append((self.predicted(moved) - at) / step)
        return np.stack(columns, axis=1)

    def noise_alone(self) -> Array:
        """Return what noise of unit variance without pulses predicts."""
        return self.observed.predicted(replace(self.fixed, density=0.0, noise_dn2=1.0))


def whitening(observed: CharacteristicFunctionData, covariance: Array) -> Array:
    """Return the matrix that makes residuals independent, each of unit variance.

    A difference of exposures is as often below zero as above it, but for pulses that the run's ends cut: its imaginary
    part tells nothing and has no weight.
    """
    count, times = observed.frequency.shape
    real, imaginary = np.abs(observed.value).reshape(2, count, times)
    balanced = np.array([abs(sum(one.times)) < 1e-9 for one in observed.filters])[:, None]
    unknown = np.stack([TOLERANCE * real, np.where(balanced, real, TOLERANCE * imaginary)])
    covariance = covariance + np.diag(unknown.ravel() ** 2 + 1e-24)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), np.float64)


def noise_only_chi2(problem: PulseLikelihood, covariance: Array) -> float:
    """Return chi2 of the noise alone, at its best."""
    root = whitening(problem.observed, covariance)
    white, target = root @ problem.noise_alone(), root @ problem.observed.value
    rest = target - max(float(white @ target / (white @ white)), 0.0) * white
    return float(rest @ rest)


def best_guess(problem: PulseLikelihood, covariance: Array, pixel_noise_dn: float) -> PulsePopulation:
    """Return the best of a few guesses; density and noise enter linearly and follow for each."""
    root, best = whitening(problem.observed, covariance), None
    target, noise = root @ problem.observed.value, root @ problem.noise_alone()
    for width in START_WIDTHS_PX:
        for height in START_HEIGHTS:
            guess = replace(problem.fixed, density=1.0, noise_dn2=0.0, height_dn=height * pixel_noise_dn,
                            column_px=width, row_px=max(width / problem.fixed.row_pitch, 0.1))  # fmt: skip
            design = np.stack([root @ problem.observed.predicted(guess), noise], axis=1)
            density, white = np.maximum(np.linalg.lstsq(design, target, rcond=None)[0], 0.0)
            density, white = max(density, 1e-9), max(white, 1e-3 * pixel_noise_dn**2)
            misfit = float(np.sum((target - design @ [density, white]) ** 2))
            if best is None or misfit < best[0]:
                best = misfit, replace(guess, density=density, noise_dn2=white)
    assert best is not None
    return best[1]


def optimise_pulses(problem: PulseLikelihood, covariance: Array, start: PulsePopulation, derivative: Array | None = None, *, rough: bool
            ) -> PulseOptimum:  # fmt: skip
    """Return the peak near a start by damped Gauss-Newton steps.

    Derivatives, which may be given as they were nearby, are brought up to date by what each step tells (Broyden), and
    taken anew where that leads nowhere, unless a rough peak will do.
    """
    root, (mean, precision) = whitening(problem.observed, covariance), problem.known

    def residual(point: Array, predicted: Array) -> Array:
        return np.concatenate([root @ (predicted - problem.observed.value), (point - mean) * precision])

    point, damping = problem.point(start), 1e-3
    predicted = problem.predicted(point)
    fresh = derivative is None
    derivative = problem.derivative(point, predicted) if derivative is None else derivative
    at = residual(point, predicted)
    for _ in range(ITERATIONS):
        slope = np.concatenate([root @ derivative, np.diag(precision)])
        step = _step(slope, at, damping, point, problem.walls)
        moved = np.clip(point + np.clip(step, -1.0, 1.0), problem.walls[:, 0], problem.walls[:, 1])
        reached, way = problem.predicted(moved), moved - point
        there = residual(moved, reached)
        gain = float(at @ at - there @ there)
        if gain > ENOUGH:
            derivative = derivative + np.outer(reached - predicted - derivative @ way, way) / (way @ way)
            point, predicted, at, damping, fresh = moved, reached, there, damping / 5.0, False
        elif not fresh and not (rough and abs(gain) < ROUGHLY):
            derivative, fresh = problem.derivative(point, predicted), True
        elif abs(gain) <= (ROUGHLY if rough else ENOUGH) or damping > 1e4:
            break
        else:
            damping *= 10.0
    slope = np.concatenate([root @ derivative, np.diag(precision)])
    data = at[: len(predicted)]
    return PulseOptimum(
        pulses=problem.pulses(point),
        point=point,
        predicted=predicted,
        derivative=derivative,
        covariance=np.asarray(np.linalg.pinv(slope.T @ slope), np.float64),
        chi2=float(data @ data),
        freedom=len(data) - len(point) + int(np.count_nonzero(precision)),
    )


def _step(slope: Array, at: Array, damping: float, point: Array, walls: Array) -> Array:
    """A damped step in which parameters at a wall that would go beyond it stay."""
    free = np.ones(len(point), bool)
    while True:
        step, own = np.zeros(len(point)), slope[:, free]
        curvature = own.T @ own
        step[free] = np.linalg.solve(curvature + damping * np.diag(np.diag(curvature) + 1e-12), -own.T @ at)
        held = free & (((point <= walls[:, 0]) & (step < 0.0)) | ((point >= walls[:, 1]) & (step > 0.0)))
        if not held.any():
            return step
        free &= ~held


def laplace_draws(problem: PulseLikelihood, peak: PulseOptimum, *, seed: int) -> Posterior:
    """Return the posterior by its curvature, of the logarithms where parameters are positive, then turned back.

    How often its intervals hold is measured, see `benchmarks.studies.dark_events_coverage`.
    """
    units = tuple(UNITS[name] for name in problem.names)
    found = laplace(None, names=problem.names, units=units, start=peak.point,  # type: ignore[arg-type]
                    covariance=peak.covariance, seed=seed, bounds=problem.walls)  # fmt: skip
    draws = found.draws.copy()
    for index, name in enumerate(problem.names):
        if name in LOGARITHMIC:
            draws[:, index] = np.exp(draws[:, index])
    # Spots without wings, and a screen whose glow cannot be timed, lean on their bounds and harm nothing.
    flags = tuple(flag for flag in found.flags if flag != "prior-bound")
    return replace(found, draws=draws, flags=flags)
