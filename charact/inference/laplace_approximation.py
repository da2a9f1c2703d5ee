"""Maximum of a log-probability, and draws of its Laplace approximation."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

from charact.inference.diagnostics import crowds_at_bound
from labdata.measurement import Posterior

Array = NDArray[np.float64]

# Bases of the sequence's columns; further parameters are drawn at random, since large bases are
# correlated.
BASES = (2, 3, 5, 7, 11, 13)
# Length of the sequence; further points are the same with another shift.
LONGEST = 8192


def quasi_random_normals(rng: np.random.Generator, count: int, parameters: int) -> Array:
    """Return quasi-random standard normal numbers, shape (count, parameter), most uniform in the
    first columns.

    Parameters
    ----------
    rng
        Generator of the shift of each column and of the random columns.

    Notes
    -----
    Halton's sequence (Halton 1960, doi 10.1007/BF01386213), shifted modulo one (Cranley & Patterson
    1976, doi 10.1137/0713071), through the inverse of the normal distribution. Any initial part of
    it is quasi-random as well.
    """
    if count > LONGEST:
        parts = [
            quasi_random_normals(rng, min(LONGEST, count - done), parameters)
            for done in range(0, count, LONGEST)
        ]
        return np.concatenate(parts)
    dimensions = min(parameters, len(BASES))
    shares = (_halton()[:count, :dimensions] + rng.random(dimensions)) % 1.0
    normal = ndtri(np.maximum(shares, np.finfo(float).tiny))
    return np.concatenate([normal, rng.standard_normal((count, parameters - dimensions))], axis=1)


@lru_cache(maxsize=1)
def _halton() -> Array:
    """Return the sequence, shape (point, base): the digits of 1, 2, 3... in a base, mirrored at the
    point.
    """
    bases = np.array(BASES)[:, None]
    places = np.arange(LONGEST.bit_length())
    digits = np.arange(1, LONGEST + 1)[:, None, None] // bases**places % bases
    return np.sum(digits / bases ** (places + 1.0), axis=2)


Vectorised = Callable[[NDArray[np.float64]], NDArray[np.float64]]

# Span of a finite difference in standard deviations: small against the optimum's width, large
# against rounding.
STENCIL_SD = 0.1
DAMPINGS = np.concatenate([[0.0], 10.0 ** np.arange(-4.0, 7.0)])


def find_maximum(
    log_probability: Vectorised,
    start: ArrayLike,
    bounds: ArrayLike | None = None,
    *,
    iterations: int = 60,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Find the maximum of a log-probability near a start.

    Parameters
    ----------
    log_probability
        Vectorised: points (n, parameter) -> (n,), -inf outside the bounds.
    start
        Start point, shape (parameter,); must have a finite log-probability.
    bounds
        Lower and upper bound of each parameter, shape (parameter, 2), infinite where there is none.
    iterations
        Maximum number of Newton steps.

    Returns
    -------
    point
        Optimum, shape (parameter,); on a bound if the probability still rises there.
    covariance
        Inverse of the negative curvature at the optimum, shape (parameter, parameter).

    Raises
    ------
    ValueError
        If the start has no finite log-probability.
    """
    point = np.array(start, float)
    walls = bounds_of(bounds, point.size)
    point = np.clip(point, walls[:, 0], walls[:, 1])
    best = float(log_probability(point[None])[0])
    if not np.isfinite(best):
        raise ValueError(
            f"the start must have a finite log-probability, got {best} at {point.tolist()}"
        )
    steps = _steps(log_probability, point, best, walls, np.full(point.size, np.nan))
    for _ in range(iterations):
        gradient, hessian = _derivatives(log_probability, point, steps, walls)
        candidates = _candidates(point, gradient, hessian, steps, walls)
        values = log_probability(candidates)
        values = np.where(np.isnan(values), -np.inf, values)
        top = int(np.argmax(values))
        gain = float(values[top]) - best
        if gain > 0:
            point, best = candidates[top], float(values[top])
        if gain < 1e-6:
            break
        steps = _rescale_steps(steps, hessian, walls)
    steps = _steps(log_probability, point, best, walls, steps)
    _, hessian = _derivatives(log_probability, point, steps, walls)
    return point, _covariance(hessian, steps, walls)


def laplace(
    log_probability: Vectorised,
    *,
    names: tuple[str, ...],
    units: tuple[str, ...],
    start: ArrayLike,
    covariance: ArrayLike | None = None,
    seed: int,
    bounds: ArrayLike | None = None,
    draws: int = 1000,
    flags: tuple[str, ...] = (),
) -> Posterior:
    """Draw from the Laplace approximation of a posterior, truncated at the bounds.

    Parameters
    ----------
    log_probability
        Vectorised: points (n, parameter) -> (n,); used where no covariance is given.
    names, units
        Name and unit of each parameter.
    start
        Optimum, shape (parameter,).
    covariance
        Covariance there, shape (parameter, parameter); None: the inverse of the negative curvature.
    seed
        Seed of the draws.
    bounds
        Shape (parameter, 2); draws outside are repeated.
    draws
        Number of draws.
    flags
        Known flags.

    Notes
    -----
    The posterior is Gaussian as far as its logarithm is parabolic over a few standard deviations.
    """
    peak = np.asarray(start, float)
    walls = bounds_of(bounds, peak.size)
    if covariance is None:
        peak, covariance = find_maximum(log_probability, peak, bounds)
    rng = np.random.default_rng(seed)
    chosen = draw_truncated_gaussian(
        rng, peak, np.asarray(covariance, float), walls, draws, quasi_random=True
    )
    leaning = ("prior-bound",) if crowds_at_bound(chosen, walls).any() else ()
    return Posterior(
        names=names,
        units=units,
        draws=chosen,
        sampler="laplace",
        seed=seed,
        flags=tuple({*flags, *leaning}),
    )


def draw_truncated_gaussian(
    rng: np.random.Generator,
    peak: NDArray,
    covariance: NDArray,
    walls: NDArray,
    draws: int,
    *,
    quasi_random: bool = False,
) -> NDArray[np.float64]:
    """Draw from a Gaussian truncated at its bounds, shape (draw, parameter).

    Quasi-random draws, most uniform in the first parameters, give quantiles from few draws; others
    are independent.
    """
    root = covariance_root(covariance)
    if quasi_random:
        # Lower triangular: the first parameters depend on the first columns alone.
        root = np.asarray(np.linalg.qr(root.T, mode="r"), np.float64).T
    accepted = np.empty((0, peak.size))
    for _ in range(200):
        normal = (
            quasi_random_normals(rng, 2 * draws, peak.size)
            if quasi_random
            else rng.standard_normal((2 * draws, peak.size))
        )
        fresh = peak + normal @ root.T
        is_inside = np.all((fresh >= walls[:, 0]) & (fresh <= walls[:, 1]), axis=1)
        accepted = np.concatenate([accepted, fresh[is_inside]])
        if len(accepted) >= draws:
            return accepted[:draws]
    short = peak + rng.standard_normal((draws - len(accepted), peak.size)) @ root.T
    return np.concatenate([accepted, np.clip(short, walls[:, 0], walls[:, 1])])


def bounds_of(bounds: ArrayLike | None, parameters: int) -> NDArray[np.float64]:
    """Return bounds of shape (parameter, 2), infinite where there are none."""
    if bounds is None:
        return np.tile([-np.inf, np.inf], (parameters, 1))
    return np.asarray(bounds, float).reshape(parameters, 2)


def _steps(
    log_probability: Vectorised, point: NDArray, value: float, walls: NDArray, last: NDArray
) -> NDArray[np.float64]:
    """Return the step of each parameter that lowers the log-probability as `STENCIL_SD` standard
    deviations would.
    """
    ranges = walls[:, 1] - walls[:, 0]
    largest = np.where(np.isfinite(ranges), 0.2 * ranges, np.maximum(1.0, np.abs(point)) * 10.0)
    factors = (
        10.0 ** np.arange(-10.0, 0.5, 0.5)
        if np.isnan(last).any()
        else 10.0 ** np.arange(-2.0, 2.25, 0.5)
    )
    scale = largest if np.isnan(last).any() else last
    sizes = np.minimum(scale[:, None] * factors, largest[:, None])  # (parameter, factor)
    offsets = np.einsum("pf,pq->pfq", sizes, np.eye(point.size)).reshape(-1, point.size)
    neighbours = np.concatenate([point + offsets, point - offsets])
    change = log_probability(np.clip(neighbours, walls[:, 0], walls[:, 1])) - value
    # The mean of both sides is the curvature; at a bound only one side changes, which is
    # sufficient.
    bend = np.abs(change.reshape(2, *sizes.shape).mean(0))
    bend = np.where(np.isfinite(bend), bend, np.inf)
    wanted = 0.5 * STENCIL_SD**2
    index = np.argmax(bend >= wanted, axis=1)
    index = np.where((bend >= wanted).any(1), index, sizes.shape[1] - 1)
    return sizes[np.arange(point.size), index]


def _rescale_steps(steps: NDArray, hessian: NDArray, walls: NDArray) -> NDArray[np.float64]:
    """Return steps of `STENCIL_SD` standard deviations from a Hessian in units of the last ones."""
    bend = np.maximum(np.abs(np.diag(hessian)), 1e-12)
    wanted = steps * np.clip(STENCIL_SD / np.sqrt(bend), 0.1, 10.0)
    ranges = walls[:, 1] - walls[:, 0]
    return np.where(np.isfinite(ranges), np.minimum(wanted, 0.2 * ranges), wanted)


def _derivatives(
    log_probability: Vectorised, point: NDArray, steps: NDArray, walls: NDArray
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return gradient and Hessian at the point in units of the steps, from one call over a central
    stencil.

    At a bound the stencil is moved inside; the Hessian extrapolates the gradient back to the point.
    """
    size = point.size
    centre = np.clip(point, walls[:, 0] + steps, walls[:, 1] - steps)
    unit = np.eye(size)
    first, second = np.triu_indices(size, 1)
    mixed = [
        sign_a * unit[first] + sign_b * unit[second] for sign_a in (1, -1) for sign_b in (1, -1)
    ]
    offsets = np.concatenate([np.zeros((1, size)), unit, -unit, *mixed])
    values = log_probability(np.clip(centre + offsets * steps, walls[:, 0], walls[:, 1]))
    middle, plus, minus = values[0], values[1 : size + 1], values[size + 1 : 2 * size + 1]
    corner = values[2 * size + 1 :].reshape(4, -1)
    with np.errstate(invalid="ignore"):
        hessian = np.diag(plus - 2 * middle + minus)
        hessian[first, second] = hessian[second, first] = (
            corner[0] - corner[1] - corner[2] + corner[3]
        ) / 4.0
        gradient = (plus - minus) / 2.0
    hessian = np.where(np.isfinite(hessian), hessian, 0.0)
    gradient = np.where(np.isfinite(gradient), gradient, 0.0) + hessian @ ((point - centre) / steps)
    return gradient, hessian


def _candidates(
    point: NDArray, gradient: NDArray, hessian: NDArray, steps: NDArray, walls: NDArray
) -> NDArray[np.float64]:
    """Return the points of Newton steps with all dampings, inside the bounds."""
    blocked = ((point <= walls[:, 0]) & (gradient < 0)) | ((point >= walls[:, 1]) & (gradient > 0))
    free = np.flatnonzero(~blocked)
    if not free.size:
        return point[None]
    values, vectors = np.linalg.eigh(-hessian[np.ix_(free, free)])
    along = vectors.T @ gradient[free]
    floor = np.maximum(np.abs(values), 1e-12)
    scale = max(float(np.max(np.abs(values))), 1e-12)
    moves = (along / (floor + DAMPINGS[:, None] * scale)) @ vectors.T * steps[free]
    # Shorter and longer moves along Newton's direction, for optima that are not parabolic.
    moves = np.concatenate([moves, moves[:1] * np.array([[0.5], [0.25], [2.0], [4.0]])])
    reached = np.tile(point, (len(moves), 1))
    reached[:, free] += moves
    return np.clip(reached, walls[:, 0], walls[:, 1])


def _covariance(hessian: NDArray, steps: NDArray, walls: NDArray) -> NDArray[np.float64]:
    """Return the inverse curvature; bounds act as a Gaussian prior where a parameter is
    undetermined.

    Bounds act as a Gaussian with the variance of their range: combinations of parameters remain
    determined.
    """
    values, vectors = np.linalg.eigh(-hessian)
    ranges = (walls[:, 1] - walls[:, 0]) / steps
    widest = np.where(
        np.isfinite(ranges), np.maximum(ranges, 1e-6) / np.sqrt(12.0), 1e3 / STENCIL_SD
    )
    with np.errstate(divide="ignore"):
        known = np.all(values > 0) and np.all(vectors**2 @ (1.0 / values) <= widest**2)
    if not known:
        curved = (vectors * np.maximum(values, 0.0)) @ vectors.T
        values, vectors = np.linalg.eigh(curved + np.diag(1.0 / widest**2))
    return (vectors / values) @ vectors.T * np.outer(steps, steps)


def covariance_root(covariance: NDArray) -> NDArray[np.float64]:
    """Return a square root of a covariance that may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))
