"""Elliptical slice sampling of many chains about a normal law that follows them.

For posteriors of some 25 parameters with narrow curved ridges, of which importance sampling keeps
few effective draws.
"""

from collections.abc import Callable, Iterator

import numpy as np

from charact.fitting.thresholds import SAMPLING
from labdata import Array

LogProbability = Callable[[Array], Array]


def slice_rounds(
    log_probability: LogProbability, start: Array, covariance: Array, rng: np.random.Generator
) -> Iterator[Array]:
    """Yield all steps of chains after the burn-in, shape (step, chain, parameter), after each
    round of steps.

    Parameters
    ----------
    log_probability
        Points (n, parameter) -> (n,).
    start, covariance
        Mean, shape (parameter,), and covariance, shape (parameter, parameter), of the normal law
        that the chains start from.
    rng
        Generator of every draw.

    Notes
    -----
    Generalised elliptical slice sampling (Nishihara, Murray & Adams, JMLR 15, 2087 (2014)): with
    the normal law N of mean m and covariance C, a proposal m + (x - m) cos t + v sin t with v ~
    N(0, C) is accepted above the slice of p(x)/N(x); the bracket of t shrinks towards 0 until one
    is. Each round begins with mean and covariance of the second half of the one before.
    """
    chains = start + rng.standard_normal((SAMPLING.chains, start.size)) @ root_of(covariance).T
    rounds: list[Array] = []
    for count, steps in enumerate((*SAMPLING.burn_in_steps, *SAMPLING.steps)):
        steps_of_round = _run(
            log_probability, start, SAMPLING.wider * covariance, chains, steps, rng
        )
        chains = steps_of_round[-1]
        later = steps_of_round[steps // 2 :].reshape(-1, start.size)
        start, covariance = later.mean(axis=0), np.atleast_2d(np.cov(later.T))
        if count >= len(SAMPLING.burn_in_steps):
            rounds.append(steps_of_round)
            yield np.concatenate(rounds)


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
    """Return chains after each of a number of steps with a normal law of a mean and covariance,
    shape (step, chain, parameter).

    Chains do not wait for each other: one whose proposal is accepted begins its next step.
    """
    root = root_of(covariance)
    inverse = np.linalg.inv(root)

    def excess(points: Array) -> Array:
        return log_probability(points) + 0.5 * np.sum(((points - point) @ inverse.T) ** 2, axis=1)

    count, chains, height = len(chains), chains.copy(), excess(chains)
    states, taken = np.empty((steps, *chains.shape)), np.zeros(count, int)
    ahead, (level, angle, low, high) = np.empty_like(chains), np.empty((4, count))
    active = beginning = np.arange(count)
    while active.size:
        ahead[beginning] = rng.standard_normal((beginning.size, point.size)) @ root.T
        level[beginning] = height[beginning] + np.log(rng.random(beginning.size))
        high[beginning] = angle[beginning] = 2.0 * np.pi * rng.random(beginning.size)
        low[beginning] = angle[beginning] - 2.0 * np.pi
        turn = angle[active, None]
        tried = point + (chains[active] - point) * np.cos(turn) + ahead[active] * np.sin(turn)
        densities = excess(tried)
        is_accepted = densities > level[active]
        accepted, refused = active[is_accepted], active[~is_accepted]
        chains[accepted], height[accepted] = tried[is_accepted], densities[is_accepted]
        is_below = angle[refused] < 0.0
        low[refused[is_below]] = angle[refused[is_below]]
        high[refused[~is_below]] = angle[refused[~is_below]]
        bracket = high[refused] - low[refused]
        angle[refused] = low[refused] + bracket * rng.random(refused.size)
        # An empty bracket leaves a chain in its place.
        ended = np.concatenate([accepted, refused[bracket <= SAMPLING.least_angle]])
        states[taken[ended], ended] = chains[ended]
        taken[ended] += 1
        beginning = ended[taken[ended] < steps]
        active = np.flatnonzero(taken < steps)
    return states
