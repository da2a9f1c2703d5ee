"""Levenberg-Marquardt optimisation of whitened rings, with several starts and all dampings at once."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.bloom.series.likelihood import AmplitudeSolution, SeriesLikelihood

Array = NDArray[np.float64]

# Factors on the last successful damping.
NEAR = 10.0 ** np.array([-2.0, 0.0, 2.0])
ITERATIONS = 25
# Gain in log-probability below which an optimisation ends.
ENOUGH = 1e-3


@dataclass(frozen=True, kw_only=True)
class SeriesOptimum:
    """Result of an optimisation: point, covariance of its parameters, and log-probability."""

    point: Array
    covariance: Array
    log_probability: float


def optimise(
    problem: SeriesLikelihood, start: Array, *, held: tuple[int, ...] = (), iterations: int = ITERATIONS
) -> SeriesOptimum:
    """Find the optimum near a start; parameters `held` stay fixed."""
    return optimise_from_starts(problem, start[None], held=held, iterations=iterations)[0]


def optimise_from_starts(
    problem: SeriesLikelihood, starts: Array, *, held: tuple[int, ...] = (), iterations: int = ITERATIONS
) -> tuple[SeriesOptimum, ...]:
    """Optimise from several starts, shape (start, parameter), in parallel."""
    bounds = problem.form.bounds
    points = np.clip(starts, bounds[:, 0], bounds[:, 1])
    best, solved = _values(problem, points)
    residuals, slopes = _linear(problem, points, solved)
    damping, failed = np.full(len(points), 1e-2), np.zeros(len(points), int)
    going = np.arange(len(points))
    for _ in range(iterations):
        moves = [_moves(points[i], residuals[i], slopes[i], bounds, held, damping[i] * NEAR) for i in going]
        values, solved = _values(problem, np.concatenate(moves))
        which = values.reshape(len(going), -1).argmax(axis=1)
        top = which + len(NEAR) * np.arange(len(going))
        gain = values[top] - best[going]
        damping[going] *= np.where(gain > 0, NEAR[which], NEAR[-1] ** 2)
        failed[going] += gain <= 0
        better, top = going[gain > 0], top[gain > 0]
        if len(better):
            points[better], best[better] = np.concatenate(moves)[top], values[top]
            residuals[better], slopes[better] = _linear(problem, points[better], solved.at(top))
        going = going[(gain >= ENOUGH) | ((gain <= 0) & (failed[going] < 2))]
        if not len(going):
            break
    return tuple(
        SeriesOptimum(point=point, covariance=_covariance(of, bounds), log_probability=float(value))
        for point, of, value in zip(points, slopes, best, strict=True)
    )


def slopes_at(problem: SeriesLikelihood, point: Array) -> Array:
    """Jacobian of the whitened rings at a point, shape (datum, parameter)."""
    return _linear(problem, point[None], problem.solve_amplitudes(point[None]))[1][0]


def _covariance(slopes: Array, bounds: Array) -> Array:
    """Covariance of the parameters; an undetermined one has the variance of its flat prior."""
    normal = slopes.T @ slopes + np.diag(12.0 / (bounds[:, 1] - bounds[:, 0]) ** 2)
    scale = np.sqrt(np.diag(normal))
    return np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)


def _priors(problem: SeriesLikelihood, points: Array) -> tuple[Array, Array]:
    """Residuals of the normal priors, shape (point, prior), and their Jacobian, shape (prior, parameter)."""
    mean, sd = (np.array([getattr(one, name) for one in problem.form.parameters]) for name in ("mean", "sd"))
    known = np.isfinite(sd)
    return (points[:, known] - mean[known]) / sd[known], -np.diag(1.0 / sd)[known]


def _values(problem: SeriesLikelihood, points: Array) -> tuple[Array, AmplitudeSolution]:
    """Log-probability at points within the bounds, shape (point,), and the amplitudes there."""
    solved = problem.solve_amplitudes(points)
    values = -0.5 * (solved.chi2.sum(axis=0) + (_priors(problem, points)[0] ** 2).sum(axis=1))
    return np.where(np.isfinite(values), values, -np.inf), solved


def _linear(problem: SeriesLikelihood, points: Array, solved: AmplitudeSolution) -> tuple[Array, Array]:
    """Residuals, shape (point, datum), and their Jacobian, shape (point, datum, parameter).

    Amplitudes stay at their optimum while a parameter moves; their effect is projected out afterwards (variable
    projection, Kaufman 1975, doi 10.1007/BF01932995).
    """
    bounds = problem.form.bounds
    width = len(bounds)
    step = np.broadcast_to(1e-5 * (bounds[:, 1] - bounds[:, 0]), points.shape)
    step = np.where(points + step > bounds[:, 1], -step, step)
    moved = (points[:, None] + step[:, None] * np.eye(width)).reshape(-1, width)
    there, _ = problem.whiten(problem.parts(moved), np.repeat(solved.amplitudes, width, axis=2))
    fall = solved.residual[..., None] - there.reshape(*solved.residual.shape, width)
    fall = _project_out_amplitudes(solved, fall / step)
    prior, prior_fall = _priors(problem, points)
    rings = np.moveaxis(solved.residual, -1, 0).reshape(len(points), -1)
    of_rings = np.moveaxis(fall, 2, 0).reshape(len(points), -1, width)
    of_priors = np.broadcast_to(prior_fall, (len(points), *prior_fall.shape))
    return np.concatenate([rings, prior], axis=1), np.concatenate([of_rings, of_priors], axis=1)


def _project_out_amplitudes(solved: AmplitudeSolution, fall: Array) -> Array:
    """Jacobian with the amplitudes of each stack projected out, shape (level, ring, point, parameter)."""
    source, even = (one[..., None] for one in solved.slopes)
    length = np.sqrt((source**2).sum(axis=1, keepdims=True)) + 1e-300
    first = source / length
    second = even - first * (first * even).sum(axis=1, keepdims=True)
    second = second / (np.sqrt((second**2).sum(axis=1, keepdims=True)) + 1e-300)
    for one in (first, second):
        fall = fall - one * (one * fall).sum(axis=1, keepdims=True)
    return fall


def _free(gradient: Array, point: Array, bounds: Array, held: tuple[int, ...]) -> NDArray[np.bool_]:
    """Parameters that may move: not held, and not blocked by a bound."""
    pressed = ((point <= bounds[:, 0]) & (gradient < 0)) | ((point >= bounds[:, 1]) & (gradient > 0))
    pressed[list(held)] = True
    return ~pressed


def _moves(
    point: Array, residual: Array, slopes: Array, bounds: Array, held: tuple[int, ...], dampings: Array
) -> Array:
    """One step for each damping, clipped at the bounds, shape (damping, parameter)."""
    right = slopes.T @ residual
    free = _free(right, point, bounds, held)
    out = np.repeat(point[None], len(dampings), axis=0)
    if free.any():
        normal = (slopes.T @ slopes)[np.ix_(free, free)]
        own = np.diag(np.diag(normal) + 1e-12 * np.trace(normal) + 1e-300)
        out[:, free] += np.linalg.solve(normal + (dampings[:, None, None] + 1e-12) * own, right[free][:, None])[..., 0]
    return np.clip(out, bounds[:, 0], bounds[:, 1])
