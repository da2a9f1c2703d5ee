"""Draws of a posterior of many parameters by elliptical slice sampling of many chains about an
adapted normal law.

For posteriors of some 25 parameters with narrow curved ridges, of which importance sampling keeps
few effective draws.
"""

from collections.abc import Callable

import numpy as np

from charact.fitting.thresholds import SAMPLING
from labdata import Array
from labdata.measurement import Posterior

LogProbability = Callable[[Array], Array]


def slice_sample(
    log_probability: LogProbability,
    *,
    names: tuple[str, ...],
    point: Array,
    covariance: Array,
    bounds: Array,
    seed: int,
) -> Posterior:
    """Return one draw of each of many independent chains.

    Parameters
    ----------
    log_probability
        Points (n, parameter) -> (n,), -inf outside the bounds.
    names
        Name of each parameter.
    point, covariance
        The peak, shape (parameter,), and covariance there, shape (parameter, parameter).
    bounds
        Lowest and highest value of each parameter, shape (parameter, 2).
    seed
        Seed of every draw.

    Returns
    -------
    Posterior
        Flag `not-converged` if the chains' distribution still changes at the largest number of
        steps: mean or standard deviation of a parameter over the chains differ between half of the
        steps and all.

    Notes
    -----
    The density is continued beyond each bound by reflection, since of many parameters at a bound
    hardly any proposal were inside; the draws are reflected back. Generalised elliptical slice
    sampling (Nishihara, Murray & Adams, JMLR 15, 2087 (2014)): with the normal law N of mean m and
    covariance C, a proposal m + (x - m) cos t + v sin t with v ~ N(0, C) is accepted above the
    slice of p(x)/N(x); the bracket of t shrinks towards 0 until one is. Chains start from weighted
    draws of the adaptation; each doubling of the steps begins with their own mean and covariance.
    """
    rng = np.random.default_rng(seed)

    def continuation(points: Array) -> Array:
        return log_probability(_reflect(points, bounds))

    point, covariance, chains = adapt(continuation, point, covariance, rng)
    before, steps, flags = chains, 0, ("not-converged",)
    while steps < SAMPLING.most_steps:
        target = max(SAMPLING.least_steps, 2 * steps)
        chains = _run(continuation, point, SAMPLING.wider * covariance, chains, target - steps, rng)
        steps, point, covariance = target, chains.mean(axis=0), np.atleast_2d(np.cov(chains.T))
        if steps > SAMPLING.least_steps and not _differ(before, chains):
            flags = ()
            break
        before = chains
    return Posterior(
        names=names,
        units=("1",) * len(names),
        draws=_reflect(chains, bounds),
        sampler="slice",
        seed=seed,
        flags=flags,
        effective_sample_size=np.full(len(names), float(len(chains))),
    )


def adapt(
    log_probability: LogProbability, point: Array, covariance: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Return mean and covariance of a posterior, of a maximum and the curvature there, and draws to
    start chains from.

    Population Monte Carlo: weighted draws of a Student t give the mean and covariance of the next
    one. Weights are limited to their mean times the root of the number of draws, so that no single
    draw dominates (Ionides 2008, doi 10.1198/106186008X320456).
    """
    count, freedom = SAMPLING.round_draws, SAMPLING.freedom
    points, weight = point[None], np.ones(1)
    for _ in range(SAMPLING.rounds):
        normal = rng.standard_normal((count, point.size))
        stretch = np.sqrt(freedom / rng.chisquare(freedom, count))
        points = point + (normal * stretch[:, None]) @ root_of(covariance).T
        tail = (
            -0.5 * (freedom + point.size) * np.log1p((normal**2).sum(axis=1) * stretch**2 / freedom)
        )
        log_weight = log_probability(points) - tail
        weight = np.exp(log_weight - log_weight.max())
        weight = np.minimum(weight, weight.mean() * np.sqrt(count))
        effective = weight.sum() ** 2 / (weight**2).sum()
        if effective < SAMPLING.least_effective:
            # The normal law is too wide for the posterior: its mean, the peak, is kept.
            covariance = covariance / 4.0
            continue
        point = np.average(points, axis=0, weights=weight)
        # Few effective draws change the covariance by little.
        new_weight = effective / (effective + SAMPLING.prior_draws * point.size)
        covariance = (1.0 - new_weight) * covariance + new_weight * np.atleast_2d(
            np.cov(points.T, aweights=weight)
        )
    return (
        point,
        covariance,
        points[rng.choice(len(points), SAMPLING.chains, p=weight / weight.sum())],
    )


def _reflect(points: Array, bounds: Array) -> Array:
    """Return points (n, parameter) with those beyond a bound reflected at it."""
    low, high = bounds.T
    points = np.where(points < low, 2.0 * low - points, points)
    return np.where(points > high, 2.0 * high - points, points)


def root_of(covariance: Array) -> Array:
    """Return a root of a covariance; a direction of less than the least relative variance, as by
    rounding, gets that.

    Examples
    --------
    >>> root = root_of(np.array([[4.0, 2.0], [2.0, 1.0]]))
    >>> np.allclose(root @ root.T, [[4.0, 2.0], [2.0, 1.0]])
    True
    """
    scale = np.sqrt(np.diag(covariance))
    value, vector = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(
        scale[:, None] * vector * np.sqrt(np.maximum(value, SAMPLING.least_variance)), np.float64
    )


def _run(
    log_probability: LogProbability,
    point: Array,
    covariance: Array,
    chains: Array,
    steps: int,
    rng: np.random.Generator,
) -> Array:
    """Return the chains after a number of steps with a normal law of a mean and covariance."""
    root = root_of(covariance)
    inverse = np.linalg.inv(root)

    def excess(points: Array) -> Array:
        return log_probability(points) + 0.5 * np.sum(((points - point) @ inverse.T) ** 2, axis=1)

    height = excess(chains)
    for _ in range(steps):
        chains, height = _step(excess, point, root, chains, height, rng)
    return chains


def _step(
    excess: LogProbability,
    point: Array,
    root: Array,
    chains: Array,
    height: Array,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Return the next point of every chain, and p/N at it."""
    count = len(chains)
    chains, height = chains.copy(), height.copy()
    ahead = rng.standard_normal(chains.shape) @ root.T
    level = height + np.log(rng.random(count))
    angle = 2.0 * np.pi * rng.random(count)
    low, high, active = angle - 2.0 * np.pi, angle.copy(), np.arange(count)
    # An empty bracket leaves a chain in its place.
    while active.size:
        turn = angle[active, None]
        tried = point + (chains[active] - point) * np.cos(turn) + ahead[active] * np.sin(turn)
        densities = excess(tried)
        is_accepted = densities > level[active]
        chains[active[is_accepted]], height[active[is_accepted]] = (
            tried[is_accepted],
            densities[is_accepted],
        )
        active = active[~is_accepted]
        is_below = angle[active] < 0.0
        low[active[is_below]], high[active[~is_below]] = (
            angle[active[is_below]],
            angle[active[~is_below]],
        )
        angle[active] = low[active] + (high[active] - low[active]) * rng.random(active.size)
        active = active[high[active] - low[active] > SAMPLING.least_angle]
    return chains, height


def _differ(before: Array, after: Array) -> bool:
    """Whether mean or standard deviation of a parameter differ between two sets of draws."""
    sd = np.maximum(before.std(axis=0), 1e-300)
    shift = np.abs(after.mean(axis=0) - before.mean(axis=0)) / sd * np.sqrt(len(before) / 2.0)
    change = np.abs(np.log(np.maximum(after.std(axis=0), 1e-300) / sd)) * np.sqrt(len(before))
    return bool(max(shift.max(), change.max()) > SAMPLING.most_change_se)
