"""Bounded least squares (damped Gauss-Newton), Laplace's evidence, and weights of models by
evidence.

A model hands in its cost, gradient and curvature at a point as a `Linearisation`;
`linearise_residual` makes one of a residual and a Jacobian. Amplitudes that are linear in the model
either follow the parameters (the gradient and the curvature then have more entries than there are
bounds) or are projected out by the model itself.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# Smallest curvature, and eigenvalue over the largest one below which a direction is undetermined.
LEAST_CURVATURE = 1e-300
UNDETERMINED = 1e-12
LEAST_PART = 1e-3  # Of a direction in the parameters that have bounds, if they are not felt


class Linearisation(NamedTuple):
    """A model made linear at a point.

    Parameters
    ----------
    cost
        -2 ln of likelihood and Gaussian priors: sum of squared whitened residuals.
    gradient
        J' r + P (prior mean - parameters), minus half the slope of the cost, shape (parameter,).
    normal
        J' J + P, half the curvature of the cost, shape (parameter, parameter).
    model
        Whatever else the caller needs of the model there.
    """

    cost: float
    gradient: Array
    normal: Array
    model: Any = None


class Optimum(NamedTuple):
    """Result of an optimisation: the point, shape (parameter,), and the model there."""

    point: Array
    at: Linearisation


def linearise_residual(
    residual: Array,
    jacobian: Array,
    off: ArrayLike = 0.0,
    precision: ArrayLike = 0.0,
    model: Any = None,
) -> Linearisation:
    """Return the linearisation of whitened data less their model.

    Parameters
    ----------
    residual
        Data less model, whitened, shape (datum,).
    jacobian
        Change of the whitened model with each parameter, shape (parameter, datum).
    off, precision
        Mean of each Gaussian prior less the parameter, and its precision, shape (parameter,);
        precision 0: flat.
    model
        Passed on.
    """
    off, precision = np.broadcast_to(off, len(jacobian)), np.broadcast_to(precision, len(jacobian))
    cost = float(residual @ residual + precision @ off**2)
    normal = jacobian @ jacobian.T + np.diag(precision)
    return Linearisation(cost, jacobian @ residual + precision * off, normal, model)


def least_squares(
    linearise: Callable[[Array], Linearisation],
    start: ArrayLike,
    bounds: ArrayLike,
    *,
    iterations: int = 50,
    tolerance: float = 1e-5,
    relative_tolerance: float = 0.0,
    damping: float = 1e-3,
    shrink: float = 0.1,
    grow: float = 10.0,
    min_damping: float = 1e-9,
    max_damping: float = 1e9,
    max_step: ArrayLike = 0.25,
) -> Optimum:
    """Minimise a sum of squares within bounds by damped Gauss-Newton steps.

    Parameters
    ----------
    linearise
        Point, shape (parameter,) -> model there; entries after the parameters are those of linear
        amplitudes, which the model keeps at their optimum.
    start, bounds
        Shapes (parameter,) and (parameter, 2); infinite: no bound; equal: the parameter is held.
    iterations
        Maximum number of steps tried.
    tolerance, relative_tolerance
        Gain of the cost, absolute and as a fraction of it, below which a step is the last one.
    damping, shrink, grow, min_damping, max_damping
        First damping in units of each parameter's curvature, its factors after a step that lowers
        the cost and after one that does not, its least value, and that above which the search ends.
    max_step
        Largest step, as a fraction of the range between the bounds, of all parameters or of each.

    Notes
    -----
    (N + d diag N) step = gradient (Levenberg 1944, Marquardt 1963); a parameter at a bound does not
    move outwards.
    """
    bounds = np.ascontiguousarray(bounds, float)
    point = np.clip(np.asarray(start, float), bounds[:, 0], bounds[:, 1])
    max_change = np.asarray(max_step, float) * (bounds[:, 1] - bounds[:, 0])
    model = linearise(point)
    for _ in range(iterations):
        step = damped_step(model.gradient, model.normal, point, bounds, damping, max_change)
        trial = np.clip(point + step, bounds[:, 0], bounds[:, 1])
        trial_model = linearise(trial)
        gain = model.cost - trial_model.cost
        if gain >= 0:
            # Near the optimum a step gains at least as much as all later ones, unless damping
            # shortens it.
            is_whole = damping < 1.0
            point, model, damping = trial, trial_model, max(damping * shrink, min_damping)
            if is_whole and gain < max(tolerance, relative_tolerance * model.cost):
                break
        else:
            damping *= grow
            if not damping <= max_damping:
                break
    return Optimum(point, model)


def damped_step(
    gradient: Array, normal: Array, point: Array, bounds: Array, damping: float, max_change: Array
) -> Array:
    """Return the damped Gauss-Newton step of the parameters that have bounds, at most so large,
    shape (parameter,).
    """
    low, high = bounds.T
    pull = gradient[: point.size]
    free = np.ones(gradient.size, dtype=bool)
    free[: point.size] = (
        ((point > low) | (pull >= 0.0)) & ((point < high) | (pull <= 0.0)) & (low != high)
    )
    scale = np.sqrt(np.maximum(normal.diagonal()[free], LEAST_CURVATURE))
    matrix = normal[np.ix_(free, free)] / (scale[:, None] * scale)
    np.fill_diagonal(matrix, 1.0 + damping + UNDETERMINED)
    step = np.zeros(gradient.size)
    step[free] = np.linalg.solve(matrix, gradient[free] / scale) / scale
    return np.clip(step[: point.size], -max_change, max_change)


def covariance_at(normal: Array, bounds: Array) -> Array:
    """Return the covariance of the parameters that have bounds, all others marginalised, shape
    (parameter, parameter).

    An undetermined combination has the variance of a flat density between its bounds.
    """
    size = len(bounds)
    scale = np.sqrt(np.maximum(np.diag(normal), LEAST_CURVATURE))
    values, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    felt = np.abs(values) > UNDETERMINED * values[-1]
    along = vectors[:size] / scale[:size, None]
    covariance = (along[:, felt] / values[felt]) @ along[:, felt].T
    widest = (bounds[:, 1] - bounds[:, 0]) / np.sqrt(12.0)
    shrink = np.minimum(1.0, widest / np.sqrt(np.maximum(np.diag(covariance), LEAST_CURVATURE)))
    # Directions that data do not feel end where one of their parameters does.
    flat = along[:, ~felt & (np.abs(vectors[:size]).max(axis=0) > LEAST_PART)]
    flat = flat * np.min(widest[:, None] / np.maximum(np.abs(flat), LEAST_CURVATURE), axis=0)
    return covariance * np.outer(shrink, shrink) + flat @ flat.T


def ln_evidence(
    ln_height: float,
    covariance: Array,
    point: Array | None = None,
    bounds: Array | None = None,
    gradient: Array | None = None,
) -> float:
    """Return ln of the evidence of a model by Laplace's approximation: the volume of its posterior.

    Parameters
    ----------
    ln_height
        ln of likelihood times prior density at the optimum.
    covariance
        Of the parameters there, shape (parameter, parameter).
    point, bounds
        The optimum and bounds, shapes (parameter,) and (parameter, 2), if volume beyond the bounds
        is to be left out.
    gradient
        As of `Linearisation`: at a bound that the posterior presses on, its Gaussian's optimum lies
        z standard deviations beyond and exp(z^2 / 2) higher.
    """
    volume = ln_height + 0.5 * float(np.linalg.slogdet(2.0 * np.pi * covariance)[1])
    if point is None or bounds is None:
        return volume
    sd = np.sqrt(np.maximum(np.diag(covariance), LEAST_CURVATURE))
    low, high = (point - bounds[:, 0]) / sd, (bounds[:, 1] - point) / sd
    ln_mass = np.log(np.maximum(scipy.special.ndtr(high) - scipy.special.ndtr(-low), 1e-3))
    if gradient is not None:
        pull = sd * np.where(
            low < 1e-6, np.maximum(-gradient, 0.0), (high < 1e-6) * np.maximum(gradient, 0.0)
        )
        ln_mass = np.where(pull > 0.0, 0.5 * pull**2 + scipy.special.log_ndtr(-pull), ln_mass)
    return volume + float(np.sum(ln_mass))


def weigh_by_evidence(
    ln_evidences: ArrayLike, *, power: float = 1.0, min_weight: float = 0.0
) -> list[tuple[int, float]]:
    """Return index and weight of each model that counts, the most probable first.

    Parameters
    ----------
    ln_evidences
        ln of evidence times prior probability of each model, shape (model,).
    power
        Power of the evidence that weighs; below 1 where evidences are approximate.
    min_weight
        Weight that a model must exceed.
    """
    values = np.asarray(ln_evidences, float)
    weight = np.exp(power * (values - values.max()))
    weight /= weight.sum()
    return [(int(i), float(weight[i])) for i in np.argsort(-weight) if weight[i] > min_weight]
