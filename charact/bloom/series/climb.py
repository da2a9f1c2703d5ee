"""The best point of a form: Levenberg-Marquardt on whitened rings, all dampings tried at once."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.bloom.series.likelihood import Problem

Array = NDArray[np.float64]

DAMPINGS = 10.0 ** np.array([-6.0, -2.0, 0.0, 2.0, 4.0])
ITERATIONS = 25
# Gain of the log-probability below which a climb ends, and step of a difference as a share of a parameter's range.
ENOUGH = 1e-3
STEP = 1e-5


@dataclass(frozen=True, kw_only=True)
class Peak:
    """Where a climb ended: point, covariance of its parameters, and the log-probability there."""

    point: Array
    covariance: Array
    log_probability: float


def climb(problem: Problem, start: Array, *, held: tuple[int, ...] = (), iterations: int = ITERATIONS) -> Peak:
    """Climb to the best point near a start; parameters `held` stay where they are."""
    bounds = problem.form.bounds
    point = np.clip(start, bounds[:, 0], bounds[:, 1])
    residual, slopes = _linear(problem, point)
    best = -0.5 * float(residual @ residual)
    for _ in range(iterations):
        free = _free(slopes.T @ residual, point, bounds, held)
        candidates = np.array([_moved(point, residual, slopes, free, damping, bounds) for damping in DAMPINGS])
        values = _values(problem, candidates)
        top = int(np.argmax(values))
        gain = float(values[top]) - best
        if gain <= 0:
            break
        point, best = candidates[top], float(values[top])
        residual, slopes = _linear(problem, point)
        if gain < ENOUGH:
            break
    # A parameter that the rings say nothing of is known as its flat prior knows it.
    normal = slopes.T @ slopes + np.diag(12.0 / (bounds[:, 1] - bounds[:, 0]) ** 2)
    scale = np.sqrt(np.diag(normal))
    covariance = np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)
    return Peak(point=point, covariance=covariance, log_probability=best)


def slopes_at(problem: Problem, point: Array) -> Array:
    """How the whitened rings follow the parameters at a point, shape (datum, parameter)."""
    return _linear(problem, point)[1]


def _residuals(problem: Problem, points: Array) -> Array:
    """Whitened residuals of rings and priors, shape (datum, point)."""
    rings = problem.solved(points).residual.reshape(-1, len(points))
    mean, sd = (np.array([getattr(one, name) for one in problem.form.parameters]) for name in ("mean", "sd"))
    known = np.isfinite(sd)
    return np.concatenate([rings, ((points[:, known] - mean[known]) / sd[known]).T])


def _values(problem: Problem, points: Array) -> Array:
    values = -0.5 * (_residuals(problem, points) ** 2).sum(axis=0)
    return np.where(np.isfinite(values), values, -np.inf)


def _linear(problem: Problem, point: Array) -> tuple[Array, Array]:
    """Residuals at a point, shape (datum,), and how they fall with the parameters, shape (datum, parameter)."""
    bounds = problem.form.bounds
    step = STEP * (bounds[:, 1] - bounds[:, 0])
    step = np.where(point + step > bounds[:, 1], -step, step)
    residual = _residuals(problem, np.concatenate([point[None], point + np.diag(step)]))
    return residual[:, 0], (residual[:, :1] - residual[:, 1:]) / step


def _free(gradient: Array, point: Array, bounds: Array, held: tuple[int, ...]) -> NDArray[np.bool_]:
    """Parameters that may move: not held, and not pressed against a bound."""
    pressed = ((point <= bounds[:, 0]) & (gradient < 0)) | ((point >= bounds[:, 1]) & (gradient > 0))
    pressed[list(held)] = True
    return ~pressed


def _moved(
    point: Array, residual: Array, slopes: Array, free: NDArray[np.bool_], damping: float, bounds: Array
) -> Array:
    """One damped step, cut at the bounds."""
    out = point.copy()
    if free.any():
        use = slopes[:, free]
        normal = use.T @ use
        own = np.diag(normal) + 1e-12 * np.trace(normal) + 1e-300
        out[free] += np.linalg.solve(normal + damping * np.diag(own) + 1e-12 * np.diag(own), use.T @ residual)
    return np.clip(out, bounds[:, 0], bounds[:, 1])
