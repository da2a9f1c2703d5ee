"""The one wrapper around emcee: independent ensembles that run until they agree, or a flag that
they did not.

Moves are differential evolution and an independence proposal, a Student t of the covariance given:
where the posterior is nearly Gaussian most steps are then nearly independent, and where it is not
the other moves do the work. Both keep the posterior invariant.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from charact.inference.diagnostics import (
    autocorrelation_time,
    crowds_at_bound,
    ensemble_r_hat,
    has_several_peaks,
    mixes_well,
    split_r_hat,
)
from charact.inference.ensembles import Ensembles, first_places, walker_moves
from charact.inference.laplace_approximation import (
    Vectorised,
    bounds_of,
    covariance_root,
    draw_truncated_gaussian,
    find_maximum,
    laplace,
)
from charact.inference.probit_transform import NormalScores, ProbitTransform
from labdata import BadInput, Posterior

STEPS_PER_TAU = 50
TAU_CHANGE = 0.1
R_HAT = 1.01
# Single walkers have only some tens of autocorrelation times each: this bound tells those that
# never leave a peak.
WALKER_R_HAT = 1.15
# Number of optimisations in search of other modes, divided by the number of parameters: the cost of
# each is quadratic.
CLIMBS = 30
# Steps of the first round of learning, how alike two rounds must be, and the steps before the first
# judgement.
LEARNING_STEPS = 60
ALIKE = 1.5
FIRST_STEPS = 150
# Differences of fewer walkers than these, four in each half, are too few to choose from.
LEAST_WALKERS = 8
# A second mode is further than this from the first and not lower than this in log-probability.
FAR_SD = 6.0
LOWEST_PEAK = 8.0
# Distance from the start at which optimisations begin where a parameter has no bound.
FAR_AROUND_SD = 50.0


def sample(
    log_probability: Vectorised,
    *,
    names: tuple[str, ...],
    units: tuple[str, ...],
    start: ArrayLike,
    covariance: ArrayLike,
    seed: int,
    bounds: ArrayLike | None = None,
    draws: int = 1000,
    ensembles: int = 2,
    max_steps: int = 20000,
    walkers: int | None = None,
) -> Posterior:
    """Draw from a posterior with independent ensembles of walkers until they have converged.

    Parameters
    ----------
    log_probability
        Vectorised: points (n, parameter) -> (n,), -inf outside the bounds, never NaN.
    names, units
        Name and unit of each parameter.
    start
        The peak, shape (parameter,), or several places to start from, shape (place, parameter).
    covariance
        Covariance at the peak, shape (parameter, parameter); it shapes the start and one of the
        moves.
    seed
        Seed of every draw.
    bounds
        Lower and upper bound of each parameter, shape (parameter, 2), infinite where there is none.
        A few climbs from anywhere between them, or within 50 standard deviations of the start, look
        for peaks besides it.
    draws
        Number of draws kept, picked at random from the chains.
    ensembles
        Independent ensembles, at least 2.
    max_steps
        Steps of each ensemble after which it is given up.
    walkers
        Walkers of an ensemble, at least 8 and two for each parameter; None: two for each parameter,
        at least 32.

    Returns
    -------
    Posterior
        With `not-converged` its draws come from the curvature; `prior-bound` and `several-modes`
        say what was seen.

    Raises
    ------
    BadInput
        If there are too few walkers.
    ValueError
        If no point near the start has a finite log-probability.

    Notes
    -----
    Converged: more than 50 autocorrelation times after the burn-in, by this judgement and the last
    one, the time not grown by 10 % while the chain grew by a third, split R-hat between ensembles
    below 1.01, an acceptance as of a chain that moves, and no walker that stays where it began.
    Peaks that neither the walkers nor the climbs met are unknown to any chain, and a chain knows
    nothing of a wrong model: that is for `predictive_check`.
    """
    spread = np.asarray(covariance, float)
    walls = bounds_of(bounds, len(spread))
    count = _walkers(walkers, len(spread))
    starts = _peaks(log_probability, np.atleast_2d(np.asarray(start, float)), spread, walls, seed)
    open_space = ProbitTransform(walls)

    def log_probability_of_scores(points: NDArray) -> NDArray:
        return log_probability(open_space.inside(points)) + open_space.log_volume(points)

    running = _start_ensembles(
        log_probability,
        log_probability_of_scores,
        open_space,
        starts,
        spread,
        (max(2, ensembles), count),
        seed,
    )
    _learn(running, log_probability_of_scores, max_steps)
    chains, trust = _run(running, max_steps)
    chains = open_space.inside(chains)
    sampled = _pick_draws(chains, 4000, seed)
    several = ("several-modes",) if has_several_peaks(sampled) else ()
    if not trust.converged:
        return laplace(
            log_probability,
            names=names,
            units=units,
            start=starts[0],
            covariance=spread,
            seed=seed,
            bounds=bounds,
            draws=draws,
            flags=("not-converged", *several),
        )
    leaning = ("prior-bound",) if crowds_at_bound(sampled, walls).any() else ()
    return Posterior(
        names=names,
        units=units,
        draws=_pick_draws(chains, draws, seed),
        autocorrelation_time=trust.tau,
        acceptance=float(np.mean(running.acceptance)),
        r_hat=trust.r_hat,
        effective_sample_size=chains.shape[0] * chains.shape[1] * chains.shape[2] / trust.tau,
        seed=seed,
        flags=(*leaning, *several),
    )


def _walkers(asked: int | None, parameters: int) -> int:
    """Return the number of walkers of an ensemble; too few would stay in the subspace in which they
    began.
    """
    minimum = max(2 * parameters, LEAST_WALKERS)
    if asked is None:
        return max(32, 2 * parameters)
    if asked < minimum:
        raise BadInput(
            f"walkers must be at least twice the parameters and {LEAST_WALKERS}, {minimum} here, "
            f"got {asked}"
        )
    return asked


def _start_ensembles(
    log_probability: Vectorised,
    unbounded: Vectorised,
    open_space: ProbitTransform,
    starts: NDArray,
    covariance: NDArray,
    shape: tuple[int, int],
    seed: int,
) -> Ensembles:
    """Start the ensembles around their places, in coordinates without walls."""
    ensembles, walkers = shape
    generators = [
        np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(ensembles)
    ]
    first = [
        first_places(log_probability, starts, covariance, open_space.walls, walkers, rng)
        for rng in generators
    ]
    if len(starts) == 1:
        cloud = open_space.outside(
            draw_truncated_gaussian(generators[0], starts[0], covariance, open_space.walls, 500)
        )
        moves = walker_moves(cloud.mean(axis=0)[None], np.atleast_2d(np.cov(cloud.T)), ensembles)
    else:
        stretch = open_space.stretch(starts[0])
        moves = walker_moves(
            open_space.outside(starts), covariance * np.outer(stretch, stretch), ensembles
        )
    return Ensembles(
        unbounded, moves, open_space.outside(np.array(first)), int(generators[0].integers(2**31))
    )


def _learn(running: Ensembles, log_probability: Vectorised, max_steps: int) -> None:
    """Let the ensembles run for a while and shape the independence proposal after what they saw
    together.

    Rounds grow until what is seen no longer changes. What is learnt stays fixed from then on, and
    these steps are forgotten, so that the chains proper are Markov.
    """
    steps, spent, last = LEARNING_STEPS, 0, None
    while spent < max_steps:
        running.advance(steps)
        sampled = running.chains()[:, steps // 2 :]
        sampled = sampled.reshape(-1, sampled.shape[-1])
        covariance = np.atleast_2d(np.cov(sampled.T)) + 1e-12 * np.diag(sampled.var(axis=0))
        running.restart(log_probability, _learnt(sampled, running.shape[0]))
        if last is not None and _alike(last, covariance):
            return
        steps, spent, last = steps * 4 // 3, spent + steps, covariance


def _learnt(draws: NDArray, ensembles: int) -> list:
    """Return moves shaped after draws: each margin made normal first, so that what is left to fit
    is a covariance.
    """
    scores = NormalScores(draws)
    normal, _ = scores.of(draws)
    covariance = np.atleast_2d(np.cov(normal.T)) + 1e-12 * np.diag(normal.var(axis=0))
    return walker_moves(normal.mean(axis=0)[None], covariance, ensembles, scores)


def _alike(first: NDArray, other: NDArray) -> bool:
    """Tell whether the variance in every direction is alike within `ALIKE`."""
    inverse = np.linalg.pinv(covariance_root(first))
    ratios = np.linalg.eigvalsh(inverse @ other @ inverse.T)
    return bool(ratios.max() < ALIKE and ratios.min() > 1.0 / ALIKE)


@dataclass(frozen=True, kw_only=True)
class _Trust:
    """What the chains say of themselves."""

    tau: NDArray[np.float64]
    r_hat: NDArray[np.float64]
    converged: bool


def _run(running: Ensembles, max_steps: int) -> tuple[NDArray[np.float64], _Trust]:
    """Advance all ensembles until they are trusted or the steps run out; return the chains after
    the burn-in.
    """
    steps, block, last = 0, min(FIRST_STEPS, max_steps), np.inf
    while True:
        running.advance(block)
        steps += block
        chains = running.chains()[:, steps // 4 :]
        trust = _trust(chains, last, running)
        if trust.converged or steps >= max_steps:
            return chains, trust
        last = trust.tau
        block = int(min(max(steps // 3, 50), max_steps - steps))


def _trust(
    chains: NDArray[np.float64], last_tau: NDArray[np.float64] | float, running: Ensembles
) -> _Trust:
    """Judge chains (ensemble, step, walker, parameter) against the rule."""
    ensembles, steps, walkers, parameters = chains.shape
    merged = np.moveaxis(chains, 0, 1).reshape(steps, ensembles * walkers, parameters)
    tau = autocorrelation_time(merged)
    r_hat = ensemble_r_hat(chains)
    with np.errstate(invalid="ignore"):
        grown = tau - last_tau > TAU_CHANGE * tau + 0.05
        known = np.isfinite(last_tau) & ~grown | (tau < steps / 400.0)
    longest = np.where(np.isfinite(last_tau), np.maximum(tau, last_tau), tau)
    converged = (
        bool(np.all(steps > STEPS_PER_TAU * longest))
        and bool(np.all(known))
        and mixes_well(running.acceptance, running.local_acceptance)
        and bool(np.all(r_hat < R_HAT))
        and bool(np.all(split_r_hat(merged) < WALKER_R_HAT))
    )
    return _Trust(tau=tau, r_hat=r_hat, converged=converged)


def _pick_draws(chains: NDArray[np.float64], draws: int, seed: int) -> NDArray[np.float64]:
    """Return draws picked at random from all steps, walkers and ensembles.

    An even stride would fall in step with the walkers and keep a few of them at every step.
    """
    flat = chains.reshape(-1, chains.shape[-1])
    picked = np.random.default_rng([seed, 2]).choice(
        len(flat), min(draws, len(flat)), replace=False
    )
    return flat[picked]


def _peaks(
    log_probability: Vectorised, peaks: NDArray, covariance: NDArray, walls: NDArray, seed: int
) -> NDArray[np.float64]:
    """Return the places and every other peak of comparable height that climbs from far around
    reach.
    """
    scattered = _far_around(peaks[0], covariance, walls, np.random.default_rng([seed, 1]))
    possible = scattered[np.isfinite(log_probability(scattered))][: max(2, CLIMBS // len(walls))]
    inverse = np.linalg.pinv(covariance_root(covariance))
    for begin in possible:
        peak, _ = find_maximum(log_probability, begin, walls, iterations=15)
        height = log_probability(np.concatenate([peak[None], peaks]))
        is_distant = np.sum(((peaks - peak) @ inverse.T) ** 2, axis=1).min() > FAR_SD**2
        if is_distant and height[0] > height[1:].max() - LOWEST_PEAK:
            peaks = np.concatenate([peaks, peak[None]])
    return peaks


def _far_around(
    start: NDArray, covariance: NDArray, walls: NDArray, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return start points: anywhere between bounds, or within `FAR_AROUND_SD` of the start without
    bounds.
    """
    distance = FAR_AROUND_SD * np.sqrt(np.diag(covariance))
    low = np.where(np.isfinite(walls[:, 0]), walls[:, 0], start - distance)
    high = np.where(np.isfinite(walls[:, 1]), walls[:, 1], start + distance)
    return rng.uniform(low, np.maximum(high, low), (64, len(walls)))
