"""Climbing to the peak of one form on an edge's profile, compiled: damped Gauss-Newton on whitened bins."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from charact.mtf.blur_models.model_jacobian import Tables, model_and_jacobian

Array = NDArray[np.float64]

LINEAR = 4  # step, level and a slope on either side
# A shift turns the phase of the nodes, which carry it while it is small; beyond, the maps are made anew around it.
LARGEST_TURN_PX = 0.25
# Gain in -2 ln of the posterior from which on a step is not worth another.
MIN_GAIN = 2e-3
MAX_DAMPING = 1e9


@njit(cache=True)
def transfer_and_jacobian(
    kind: tuple, point: Array, centre_px: float, grid: Array, fixed: Array, tables: Tables
) -> Array:
    """Return the transfer of a form at a point, its slope with the shift and with the form's parameters.

    Shape (parameter + 1, 2 node), real and imaginary parts side by side; `fixed` is the known part, shape (2, node).
    """
    forms = model_and_jacobian(kind, point[1:], grid, tables)
    size = grid.size
    out = np.empty((point.size + 1, 2 * size))
    for j in range(size):
        turn = 2.0 * np.pi * (point[0] - centre_px) * grid[j]
        cosine, sine = np.cos(turn), np.sin(turn)
        real = fixed[0, j] * cosine + fixed[1, j] * sine
        imaginary = fixed[1, j] * cosine - fixed[0, j] * sine
        out[0, j], out[0, size + j] = forms[0, j] * real, forms[0, j] * imaginary
        out[1, j] = 2.0 * np.pi * grid[j] * out[0, size + j]
        out[1, size + j] = -2.0 * np.pi * grid[j] * out[0, j]
        for k in range(1, forms.shape[0]):
            out[k + 1, j], out[k + 1, size + j] = forms[k, j] * real, forms[k, j] * imaginary
    return out


@njit(cache=True)
def linearise(
    transfers: Array, point: Array, white: Array, levels: Array, data: Array, mean: Array, precision: Array
) -> tuple[Array, Array, Array, Array, float]:
    """Return the model at a point, the best linear parameters in it.

    Parameters
    ----------
    transfers
        As `transfer_at_nodes` gives them.
    white, levels, data
        Map from nodes to whitened bins, shape (2 node, bin); whitened levels and slopes, shape (3, bin); data.
    mean, precision
        Of the Gaussian part of every parameter's prior, linear ones last.

    Returns
    -------
    residual, design, amplitude, pull, cost
        What is left of the data, shape (bin,); the change of the model with every parameter, linear ones last, shape
        (parameter, bin); step, level and slopes; the prior's pull on every parameter; -2 ln of the posterior.
    """
    size = point.size
    shapes = np.dot(transfers, white)
    design = np.empty((size + LINEAR, data.size))
    design[size] = shapes[0]
    design[size + 1 :] = levels
    linear = design[size:]
    normal = np.dot(linear, linear.T)
    for k in range(LINEAR):
        normal[k, k] += precision[size + k]
    amplitude = np.linalg.solve(normal, np.dot(linear, data))
    residual = data - np.dot(amplitude, linear)
    cost = np.dot(residual, residual)
    pull = np.empty(size + LINEAR)
    for k in range(size + LINEAR):
        away = point[k] - mean[k] if k < size else amplitude[k - size]
        pull[k] = -away * precision[k]
        cost += away * away * precision[k]
    design[:size] = shapes[1:] * amplitude[0]
    return residual, design, amplitude, pull, cost


@njit(cache=True)
def _gauss_newton_step(here: tuple, precision: Array, point: Array, bounds: Array, damping: float) -> Array:
    """Return the damped Gauss-Newton step of the parameters that are not linear, those held by a bound left out."""
    residual, design, _, pull, _ = here
    size, total = point.size, design.shape[0]
    gradient = np.dot(design, residual) + pull
    normal = np.dot(design, design.T)
    for k in range(total):
        diagonal = max(normal[k, k] + precision[k], 1e-300)
        normal[k, k] = diagonal + damping * diagonal
        if k < size and (
            (point[k] <= bounds[k, 0] and gradient[k] < 0) or (point[k] >= bounds[k, 1] and gradient[k] > 0)
        ):
            normal[k, :], normal[:, k], gradient[k], normal[k, k] = 0.0, 0.0, 0.0, 1.0
    scale = np.sqrt(np.diag(normal) / (1.0 + damping))
    for k in range(total):
        normal[k] /= scale[k] * scale
        normal[k, k] += 1e-12
    step = np.linalg.solve(normal, gradient / scale) / scale
    out = np.empty(size)
    for k in range(size):
        most = 0.25 * (bounds[k, 1] - bounds[k, 0])
        out[k] = min(max(step[k], -most), most)
    return out


@njit(cache=True)
def gauss_newton(
    kind: tuple,
    start: Array,
    damping: float,
    iterations: int,
    bounds: Array,
    prior: tuple,
    maps: tuple,
    tables: Tables,
) -> tuple[Array, float, int, tuple, Array]:
    """Return where so many steps lead from a point.

    Parameters
    ----------
    kind, tables
        As of `model_and_jacobian`.
    start, damping
        Where to begin, shift first, and with how much damping.
    prior
        Mean and precision as of `linearise`.
    maps
        Nodes, known part of the transfer, shift around which the maps are made, map to whitened bins, whitened levels
        and whitened data.

    Returns
    -------
    point, damping, iterations
        The point reached, the damping there and the steps left.
    here
        The model there, as `linearise` gives it.
    beyond
        A point that the next step would reach and these maps do not; empty where they serve.
    """
    grid, fixed, centre_px, white, levels, data = maps
    mean, precision = prior
    point = start
    here = linearise(
        transfer_and_jacobian(kind, point, centre_px, grid, fixed, tables), point, white, levels, data, mean, precision
    )
    nowhere = np.empty(0)
    while iterations > 0:
        trial = point + _gauss_newton_step(here, precision, point, bounds, damping)
        for k in range(trial.size):
            trial[k] = min(max(trial[k], bounds[k, 0]), bounds[k, 1])
        if abs(trial[0] - centre_px) > LARGEST_TURN_PX and abs(point[0] - centre_px) <= LARGEST_TURN_PX:
            return point, damping, iterations, here, trial
        iterations -= 1
        transfers = transfer_and_jacobian(kind, trial, centre_px, grid, fixed, tables)
        there = linearise(transfers, trial, white, levels, data, mean, precision)
        gain = here[4] - there[4]
        if gain >= 0:
            point, here, damping = trial, there, max(damping * 0.1, 1e-9)
            if gain < MIN_GAIN:
                break
        else:
            damping *= 30.0
            if damping > MAX_DAMPING:
                break
    return point, damping, iterations, here, nowhere


# Share of a normal equation's largest eigenvalue below which a direction is not felt.
UNFELT = 1e-12
LEAST = 1e-300


@njit(cache=True)
def normal_of(design: Array, precision: Array) -> tuple[Array, Array]:
    """Return the curvature of all parameters, shape (parameter, parameter), in units of its roots, and these."""
    normal = np.dot(design, design.T)
    for k in range(precision.size):
        normal[k, k] += precision[k]
    scale = np.sqrt(np.maximum(np.diag(normal), LEAST))
    for k in range(scale.size):
        normal[k] /= scale[k] * scale
    return normal, scale


@njit(cache=True)
def covariance_and_ln_volume(design: Array, precision: Array, point: Array, bounds: Array) -> tuple[Array, float]:
    """Return the covariance of a form's parameters, and ln of the volume of its peak, linear parameters included.

    Parameters
    ----------
    design, precision
        As of `charact.mtf.edge.fit.gauss_newton.linearise`; the last two precisions are those of the slopes' prior.
    point, bounds
        The peak, shift first, and its bounds, shape (parameter, 2).
    """
    size = point.size
    normal, scale = normal_of(design, precision)
    values, vectors = np.linalg.eigh(normal)
    covariance = np.zeros((size, size))
    for k in range(values.size):
        if abs(values[k]) > UNFELT * values[-1]:
            along = vectors[:size, k] / scale[:size]
            covariance += np.outer(along, along) / values[k]
    # A parameter that the data do not feel spreads over its bounds.
    shrink = np.empty(size)
    for k in range(size):
        widest = (bounds[k, 1] - bounds[k, 0]) / np.sqrt(12.0)
        shrink[k] = min(1.0, widest / np.sqrt(max(covariance[k, k], LEAST)))
    covariance *= np.outer(shrink, shrink)
    linear = -0.5 * np.linalg.slogdet(normal[size:, size:])[1] - np.sum(np.log(scale[size:]))
    linear += 0.5 * np.sum(np.log(precision[-2:]))
    form = 0.5 * np.linalg.slogdet(2.0 * np.pi * covariance)[1] + _ln_inside(point, covariance, bounds)
    return covariance, linear + form


@njit(cache=True)
def _ln_inside(point: Array, covariance: Array, bounds: Array) -> float:
    """Return about ln of the share of the Gaussian at a peak that lies inside the bounds: the rest is no evidence."""
    out = 0.0
    for k in range(point.size):
        sd = np.sqrt(max(covariance[k, k], LEAST))
        share = _normal((bounds[k, 1] - point[k]) / sd) - _normal((bounds[k, 0] - point[k]) / sd)
        out += np.log(max(share, 1e-3))
    return out


@njit(cache=True)
def _normal(z: float) -> float:
    """Return about the normal distribution function, within 2e-4."""
    return 1.0 / (1.0 + np.exp(-min(max(1.5976 * z + 0.07056 * z**3, -500.0), 500.0)))


@njit(cache=True)
def ln_evidence_nearby(residual: Array, design: Array, off: Array, precision: Array) -> float:
    """Return ln of the evidence of the model made linear at a fit under another prior of the illumination's slopes.

    Up to what all such priors share; `off` is the prior's mean less the parameters, linear ones last.
    """
    normal, scale = normal_of(design, precision)
    for k in range(scale.size):
        normal[k, k] += 1e-9
    pull = (np.dot(design, residual) + precision * off) / scale
    cost = np.dot(residual, residual) + np.sum(precision * off**2) - np.dot(pull, np.linalg.solve(normal, pull))
    volume = np.linalg.slogdet(normal)[1] + 2.0 * np.sum(np.log(scale))
    return -0.5 * (cost + volume - np.sum(np.log(precision[-2:])))


@njit(cache=True)
def chi2_explained(residual: Array, design: Array, off: Array, precision: Array) -> float:
    """Return how much of chi squared and of the priors' pull the design explains, to first order."""
    normal, scale = normal_of(design, precision)
    for k in range(scale.size):
        normal[k, k] += 1e-12
    pull = (np.dot(design, residual) + precision * off) / scale
    return np.dot(pull, np.linalg.solve(normal, pull))


@njit(cache=True)
def amplitudes(
    residual: Array, design: Array, off: Array, precision: Array, shapes: Array
) -> tuple[Array, Array, Array]:
    """Return the amplitude of each whitened shape (shape, bin) added alone to a fit, to first order, and its precision.

    Also what it moves of every parameter, shape (shape, parameter).
    """
    normal, scale = normal_of(design, precision)
    for k in range(scale.size):
        # A parameter that the data do not feel keeps the columns apart by a trifle.
        normal[k, k] += 1e-12
    inverse = np.linalg.inv(normal)
    pull = (np.dot(design, residual) + precision * off) / scale
    onto = np.dot(shapes, design.T) / scale
    through = np.dot(onto, inverse)
    own = np.sum(shapes * shapes, axis=1)
    # What the fit can do itself all but for rounding has no amplitude of its own.
    power = np.maximum(own - np.sum(through * onto, axis=1), UNFELT * own + LEAST)
    overlap = np.dot(shapes, residual) - np.dot(through, pull)
    amplitude = overlap / power
    moved = (np.dot(inverse, pull) - through * amplitude.reshape(-1, 1)) / scale
    return amplitude, power, moved[:, : precision.size - LINEAR].copy()
