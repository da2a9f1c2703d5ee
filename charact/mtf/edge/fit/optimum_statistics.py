"""What the model made linear at a peak says, compiled: how sure its parameters are, how probable the form is."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from charact.mtf.edge.fit.gauss_newton import LINEAR

Array = NDArray[np.float64]

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
