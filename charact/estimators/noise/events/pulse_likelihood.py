"""Likelihood of the pulses of dark frames, and its optimum.

    chi2 = |W (ln phi_measured - ln phi(theta))|^2 + sum ((theta - m) / s)^2

phi: characteristic functions of filtered pixels, see `event_distribution`; W: root of the inverse
covariance; m, s: means and standard deviations of the priors. Positive parameters are logarithms.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from charact.estimators.noise.events.event_distribution import (
    CharacteristicFunctionData,
    PulsePopulation,
)
from charact.estimators.noise.thresholds import EVENT_ACCURACY
from charact.inference import laplace
from labdata import Array, Posterior

UNITS = {
    "density": "1/px",
    "height_dn": "DN",
    "relative_variance": "1",
    "noise_dn2": "DN2",
    "line_1": "1",
    "line_2": "1",
    "column_px": "px",
    "row_px": "px",
    "wings": "1",
    "exponent": "1",
    "glow": "1",
    "glow_exposures": "exposures",
    "fast_exposures": "exposures",
}
# Positive parameters, fitted as logarithms.
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
# Normal priors of weakly constrained parameters: mean and standard deviation.
PRIORS: Priors = {
    "line_1": (0.0, 0.2),
    "line_2": (0.0, 0.1),
    "exponent": (1.3, 0.2),
    "wings": (0.0, 1.0),
}


@dataclass(frozen=True, kw_only=True)
class PulseOptimum:
    """Optimum of the pulse likelihood."""

    pulses: PulsePopulation  # them
    point: Array  # parameter vector, with logarithms of positive parameters, shape (parameter,)
    # derivative of the model by the parameters, shape (value, parameter)
    derivative: Array
    covariance: Array  # covariance of the parameters, shape (parameter, parameter)
    # chi2, freedom: squared residuals over their variance, and degrees of freedom
    chi2: float
    freedom: int

    @property
    def chance(self) -> float:
        """p-value of chi2."""
        from scipy.special import gammaincc

        return float(gammaincc(0.5 * self.freedom, 0.5 * self.chi2))


@dataclass(frozen=True, kw_only=True)
class PulseLikelihood:
    """Likelihood of pulse parameters."""

    observed: CharacteristicFunctionData  # the data
    names: tuple[str, ...]  # free parameters
    priors: Priors  # priors of some of them
    fixed: PulsePopulation  # values of the other parameters

    @cached_property
    def walls(self) -> Array:
        """Bounds of every parameter, shape (parameter, 2)."""
        limits = [(name, *BOUNDS.get(name, (1e-12, 1e12))) for name in self.names]
        return np.array([np.log(pair) if name in LOGARITHMIC else pair for name, *pair in limits])

    @cached_property
    def prior(self) -> tuple[Array, Array]:
        """Prior means and inverse standard deviations, 0 without a prior."""
        prior = [self.priors.get(name, (0.0, np.inf)) for name in self.names]
        return np.array([mean for mean, _ in prior]), np.array([1.0 / sd for _, sd in prior])

    def pulses(self, point: Array) -> PulsePopulation:
        """Return the pulses of a parameter vector."""
        value = {
            name: float(np.exp(x)) if name in LOGARITHMIC else float(x)
            for name, x in zip(self.names, point, strict=True)
        }
        return replace(self.fixed, **value)

    def point(self, pulses: PulsePopulation) -> Array:
        """Return the parameter vector of pulses, inside the bounds."""
        value = [getattr(pulses, name) for name in self.names]
        point = [
            np.log(x) if name in LOGARITHMIC else x
            for name, x in zip(self.names, value, strict=True)
        ]
        return np.clip(np.array(point), self.walls[:, 0], self.walls[:, 1])

    def model(self, point: Array) -> Array:
        """Return the model at a parameter vector, shape (value,)."""
        return self.observed.model(self.pulses(point))

    def derivative(self, point: Array, at: Array) -> Array:
        """Return the derivatives of the model by inward steps, shape (value, parameter)."""
        columns = []
        for index in range(len(point)):
            size = EVENT_ACCURACY.derivative_step
            step = size if point[index] + size < self.walls[index, 1] else -size
            stepped = point.copy()
            stepped[index] += step
            columns.append((self.model(stepped) - at) / step)
        return np.stack(columns, axis=1)

    def noise_alone(self) -> Array:
        """Return the model of noise of unit variance without pulses."""
        return self.observed.model(replace(self.fixed, density=0.0, noise_dn2=1.0))


def whitening(observed: CharacteristicFunctionData, covariance: Array) -> Array:
    """Return the whitening matrix of the residuals.

    A difference of exposures is symmetric except at the ends of the stack, so its imaginary part
    has no weight.
    """
    count, times = observed.frequency.shape
    real, imaginary = np.abs(observed.value).reshape(2, count, times)
    balanced = np.array([abs(sum(matched.times)) < 1e-9 for matched in observed.filters])[:, None]
    model_sd = EVENT_ACCURACY.model_relative_sd
    unknown = np.stack([model_sd * real, np.where(balanced, real, model_sd * imaginary)])
    covariance = covariance + np.diag(unknown.ravel() ** 2 + 1e-24)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), np.float64)


def noise_only_chi2(problem: PulseLikelihood, covariance: Array) -> float:
    """Return the smallest chi2 of noise alone."""
    root = whitening(problem.observed, covariance)
    white, target = root @ problem.noise_alone(), root @ problem.observed.value
    residual = target - max(float(white @ target / (white @ white)), 0.0) * white
    return float(residual @ residual)


def best_guess(
    problem: PulseLikelihood, covariance: Array, pixel_noise_dn: float
) -> PulsePopulation:
    """Return the best of a grid of start values; density and noise are linear and solved for
    each.
    """
    root, best = whitening(problem.observed, covariance), None
    target, noise = root @ problem.observed.value, root @ problem.noise_alone()
    for width in EVENT_ACCURACY.start_widths_px:
        for height in EVENT_ACCURACY.start_heights:
            guess = replace(
                problem.fixed,
                density=1.0,
                noise_dn2=0.0,
                height_dn=height * pixel_noise_dn,
                column_px=width,
                row_px=max(width / problem.fixed.row_pitch, 0.1),
            )
            design = np.stack([root @ problem.observed.model(guess), noise], axis=1)
            density, white = np.maximum(np.linalg.lstsq(design, target, rcond=None)[0], 0.0)
            density, white = max(density, 1e-9), max(white, 1e-3 * pixel_noise_dn**2)
            misfit = float(np.sum((target - design @ [density, white]) ** 2))
            if best is None or misfit < best[0]:
                best = misfit, replace(guess, density=density, noise_dn2=white)
    assert best is not None
    return best[1]


def optimise_pulses(
    problem: PulseLikelihood,
    covariance: Array,
    start: PulsePopulation,
    derivative: Array | None = None,
    *,
    rough: bool,
) -> PulseOptimum:
    """Return the optimum near a start by damped Gauss-Newton steps.

    Derivatives, optionally given from nearby, are updated after each step (Broyden) and recomputed
    when progress stops, unless `rough`.
    """
    root, (mean, precision) = whitening(problem.observed, covariance), problem.prior

    def residual(point: Array, predicted: Array) -> Array:
        return np.concatenate(
            [root @ (predicted - problem.observed.value), (point - mean) * precision]
        )

    point, damping = problem.point(start), 1e-3
    enough = EVENT_ACCURACY.rough_chi2_tolerance if rough else EVENT_ACCURACY.chi2_tolerance
    predicted = problem.model(point)
    fresh = derivative is None
    derivative = problem.derivative(point, predicted) if derivative is None else derivative
    at = residual(point, predicted)
    for _ in range(EVENT_ACCURACY.max_iterations):
        slope = np.concatenate([root @ derivative, np.diag(precision)])
        step = _step(slope, at, damping, point, problem.walls)
        trial = np.clip(point + np.clip(step, -1.0, 1.0), problem.walls[:, 0], problem.walls[:, 1])
        reached, way = problem.model(trial), trial - point
        trial_residual = residual(trial, reached)
        gain = float(at @ at - trial_residual @ trial_residual)
        if gain > EVENT_ACCURACY.chi2_tolerance:
            change = reached - predicted - derivative @ way
            derivative = derivative + np.outer(change, way) / (way @ way)
            point, predicted, at, damping = trial, reached, trial_residual, damping / 5.0
            fresh = False
        elif not fresh and not (rough and abs(gain) < enough):
            derivative, fresh = problem.derivative(point, predicted), True
        elif abs(gain) <= enough or damping > 1e4:
            break
        else:
            damping *= 10.0
    slope = np.concatenate([root @ derivative, np.diag(precision)])
    data = at[: len(predicted)]
    return PulseOptimum(
        pulses=problem.pulses(point),
        point=point,
        derivative=derivative,
        covariance=np.asarray(np.linalg.pinv(slope.T @ slope), np.float64),
        chi2=float(data @ data),
        freedom=len(data) - len(point) + int(np.count_nonzero(precision)),
    )


def _step(slope: Array, at: Array, damping: float, point: Array, walls: Array) -> Array:
    """Return a damped step that keeps parameters inside their bounds."""
    free = np.ones(len(point), bool)
    while True:
        step, free_slope = np.zeros(len(point)), slope[:, free]
        curvature = free_slope.T @ free_slope
        step[free] = np.linalg.solve(
            curvature + damping * np.diag(np.diag(curvature) + 1e-12), -free_slope.T @ at
        )
        blocked = free & (
            ((point <= walls[:, 0]) & (step < 0.0)) | ((point >= walls[:, 1]) & (step > 0.0))
        )
        if not blocked.any():
            return step
        free &= ~blocked


def laplace_draws(problem: PulseLikelihood, peak: PulseOptimum, *, seed: int) -> Posterior:
    """Return draws of the Laplace approximation, in logarithms for positive parameters.

    For the coverage of its intervals see `benchmarks.studies.dark_events_coverage`.
    """
    units = tuple(UNITS[name] for name in problem.names)
    posterior = laplace(
        None,  # pyright: ignore[reportArgumentType]
        names=problem.names,
        units=units,
        start=peak.point,
        covariance=peak.covariance,
        seed=seed,
        bounds=problem.walls,
    )
    draws = posterior.draws.copy()
    for index, name in enumerate(problem.names):
        if name in LOGARITHMIC:
            draws[:, index] = np.exp(draws[:, index])
    # Absent wings and an unmeasurable phosphor decay lie at their bounds and are harmless.
    flags = tuple(flag for flag in posterior.flags if flag != "prior-bound")
    return replace(posterior, draws=draws, flags=flags)
