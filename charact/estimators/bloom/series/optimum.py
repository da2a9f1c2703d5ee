"""Optimum of a likelihood by bounded least squares; of a series with the amplitudes of every stack
projected out.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from charact.estimators.bloom.series.likelihood import SeriesLikelihood
from charact.inference.gauss_newton import least_squares, linearise_residual
from charact.transfer.form import Parametric
from labdata import Array


@dataclass(frozen=True, kw_only=True)
class BoundedOptimum:
    """Result of an optimisation: point, half the curvature and the range of its parameters, and
    log-probability.
    """

    point: Array
    normal: Array
    width: Array
    log_probability: float

    @property
    def covariance(self) -> Array:
        """Covariance of the parameters; an undetermined one has the variance of its flat prior."""
        normal = self.normal + np.diag(12.0 / self.width**2)
        scale = np.sqrt(np.diag(normal))
        return np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)


def optimise(
    problem: SeriesLikelihood,
    start: Array,
    *,
    fixed: tuple[int, ...] = (),
    iterations: int = 50,
    tolerance: float = 1e-2,
) -> BoundedOptimum:
    """Find the optimum near a start; parameters `fixed` stay fixed."""
    return optimise_parameters(
        problem.form, partial(whitened, problem), start, fixed, iterations, tolerance
    )


def optimise_parameters(
    form: Parametric,
    residual_and_slopes: Callable[[Array], tuple[Array, Array]],
    start: Array,
    fixed: tuple[int, ...],
    iterations: int,
    tolerance: float,
) -> BoundedOptimum:
    """Find the optimum of whitened residuals near a start.

    `residual_and_slopes`: data less model at a point, shape (datum,), and the model's Jacobian,
    shape (datum, parameter).
    """
    bounds = form.bounds.copy()
    for index in fixed:
        bounds[index] = start[index]
    mean, sd = form.prior

    def linearise(point: Array):
        residual, slopes = residual_and_slopes(point)
        return linearise_residual(residual, slopes.T, mean - point, sd**-2.0)

    optimum = least_squares(
        linearise,
        start,
        bounds,
        iterations=iterations,
        tolerance=tolerance,
        damping=1e-2,
        max_step=1.0,
    )
    return BoundedOptimum(
        point=optimum.point,
        normal=optimum.at.normal,
        width=np.ptp(form.bounds, axis=1),
        log_probability=-0.5 * optimum.at.cost,
    )


def whitened(problem: SeriesLikelihood, point: Array) -> tuple[Array, Array]:
    """Whitened residuals of the rings, shape (datum,), and the model's Jacobian, shape (datum,
    parameter).

    Amplitudes stay at their optimum while a parameter moves; their effect is projected out
    afterwards (variable projection, Kaufman 1975, doi 10.1007/BF01932995).
    """
    solved = problem.solve_amplitudes(point[None])
    low, high = problem.form.bounds.T
    step = 1e-5 * (high - low)
    step = np.where(point + step > high, -step, step)
    shifted_residual, _ = problem.whiten(
        problem.parts(point + np.diag(step)), np.repeat(solved.amplitudes, len(point), axis=2)
    )
    fall = (solved.residual - shifted_residual) / step
    first, second = solved.slopes
    for slope in (
        first,
        second - first * (first * second).sum(axis=1, keepdims=True) / _square(first),
    ):
        fall = fall - slope * (slope * fall).sum(axis=1, keepdims=True) / _square(slope)
    return solved.residual.ravel(), fall.reshape(-1, len(point))


def _square(of: Array) -> Array:
    return (of**2).sum(axis=1, keepdims=True) + 1e-300
