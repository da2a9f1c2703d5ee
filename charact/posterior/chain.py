"""The one wrapper around emcee: independent ensembles that run until they agree, or a flag that they did not.

Moves are differential evolution and its snooker (ter Braak 2006, 2008) with an independence proposal, a Student t of
the covariance given: where the posterior is nearly Gaussian every second step is then nearly independent, and where
it is not the other moves do the work. All keep the posterior invariant.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from charact.posterior.curvature import Vectorised, gaussian_within, laplace, maximum, root_of, walls_of
from charact.posterior.diagnostics import (
    autocorrelation_time,
    ensemble_r_hat,
    has_several_peaks,
    leans_on_bound,
    split_r_hat,
)
from charact.posterior.open_space import OpenSpace
from charact.posterior.proposal import mixed_moves
from labdata.measurement import Posterior

STEPS_PER_TAU = 50
TAU_CHANGE = 0.1
R_HAT = 1.01
# Single walkers have only some tens of autocorrelation times each: this bound tells those that never leave a peak.
WALKER_R_HAT = 1.15
# Climbs in search of other peaks, shared out over the parameters: a climb costs as their square.
CLIMBS = 30
# Two rounds of learning, steps.
LEARNING_STEPS = (60, 80)
# A second peak is further than this from the first and not lower than this in log-probability.
FAR_SD = 6.0
LOWEST_PEAK = 8.0


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
        Covariance at the peak, shape (parameter, parameter); it shapes the start and one of the moves.
    seed
        Seed of every draw.
    bounds
        Lower and upper bound of each parameter, shape (parameter, 2); where all are finite, a few climbs from
        anywhere between them look for peaks besides the start.
    draws
        Number of draws kept, evenly thinned.
    ensembles
        Independent ensembles, at least 2.
    max_steps
        Steps of each ensemble after which it is given up.
    walkers
        Walkers of an ensemble; None: four for each parameter, at least 32.

    Returns
    -------
    Posterior
        With `not-converged` its draws come from the curvature; `prior-bound` and `several-modes` say what was seen.

    Notes
    -----
    Converged: more than 50 autocorrelation times after the burn-in, the time itself steady within 10 % while the
    chain grew by a third, split R-hat between ensembles below 1.01, and no walker that stays where it began.
    """
    spread = np.asarray(covariance, float)
    walls = walls_of(bounds, len(spread))
    places = _peaks(log_probability, np.atleast_2d(np.asarray(start, float)), spread, walls, seed)
    count = walkers or max(32, 4 * places.shape[1])
    open_space = OpenSpace(walls)

    def unbounded(points: NDArray) -> NDArray:
        return log_probability(open_space.inside(points)) + open_space.log_volume(points)

    runners = [
        _Runner.started(log_probability, unbounded, open_space, places, spread, count + count % 2, child)
        for child in np.random.SeedSequence(seed).spawn(max(2, ensembles))
    ]
    _learn(runners, unbounded)
    chains, trust = _run(runners, max_steps)
    chains = open_space.inside(chains)
    several = has_several_peaks(_thinned(chains, 4000))
    if not trust.converged:
        flags = ("not-converged", *(("several-modes",) if several else ()))
        return laplace(
            log_probability, names=names, units=units, start=places[0], covariance=spread, seed=seed,
            bounds=bounds, draws=draws, flags=flags,
        )  # fmt: skip
    kept = _thinned(chains, draws)
    leaning = leans_on_bound(_thinned(chains, 4000), walls).any()
    flags = (*(("prior-bound",) if leaning else ()), *(("several-modes",) if several else ()))
    return Posterior(
        names=names,
        units=units,
        draws=kept,
        autocorrelation_time=trust.tau,
        acceptance=float(np.mean([runner.acceptance for runner in runners])),
        r_hat=trust.r_hat,
        effective_sample_size=chains.shape[0] * chains.shape[1] * chains.shape[2] / trust.tau,
        seed=seed,
        flags=flags,
    )


def _learn(runners: list["_Runner"], log_probability: Vectorised) -> None:
    """Let the ensembles run for a while and shape the independence proposal after what they saw together.

    What is learnt stays fixed from then on, and these steps are forgotten, so that the chains proper are Markov.
    """
    for steps in LEARNING_STEPS:
        for runner in runners:
            runner.advance(steps)
        seen = np.concatenate([runner.chain()[steps // 2 :] for runner in runners], axis=1)
        seen = seen.reshape(-1, seen.shape[-1])
        covariance = np.atleast_2d(np.cov(seen.T)) + 1e-12 * np.diag(seen.var(axis=0))
        for runner in runners:
            runner.restarted(log_probability, mixed_moves(seen.mean(axis=0)[None], covariance))


@dataclass(frozen=True, kw_only=True)
class _Trust:
    """What the chains say of themselves."""

    tau: NDArray[np.float64]
    r_hat: NDArray[np.float64]
    converged: bool


def _run(runners: list["_Runner"], max_steps: int) -> tuple[NDArray[np.float64], _Trust]:
    """Advance all ensembles until they are trusted or the steps run out; return the chains after the burn-in."""
    steps, block, last = 0, 150, np.inf
    while True:
        for runner in runners:
            runner.advance(block)
        steps += block
        chains = np.stack([runner.chain() for runner in runners])
        chains = chains[:, len(chains[0]) // 4 :]
        trust = _trust(chains, last)
        if trust.converged or steps >= max_steps:
            return chains, trust
        last = trust.tau
        block = int(min(max(steps // 3, 50), max_steps - steps))


def _trust(chains: NDArray[np.float64], last_tau: NDArray[np.float64] | float) -> _Trust:
    """Judge chains (ensemble, step, walker, parameter) against the rule."""
    ensembles, steps, walkers, parameters = chains.shape
    merged = np.moveaxis(chains, 0, 1).reshape(steps, ensembles * walkers, parameters)
    tau = autocorrelation_time(merged)
    r_hat = ensemble_r_hat(chains)
    with np.errstate(invalid="ignore"):
        steady = bool(np.all(np.abs(tau - last_tau) < TAU_CHANGE * tau + 0.05)) or bool(np.all(tau < steps / 400.0))
    converged = (
        bool(np.all(steps > STEPS_PER_TAU * tau))
        and steady
        and bool(np.all(r_hat < R_HAT))
        and bool(np.all(split_r_hat(merged) < WALKER_R_HAT))
    )
    return _Trust(tau=tau, r_hat=r_hat, converged=converged)


def _thinned(chains: NDArray[np.float64], draws: int) -> NDArray[np.float64]:
    """Return draws spread evenly over the steps, walkers and ensembles of chains."""
    flat = np.moveaxis(chains, 0, 1).reshape(-1, chains.shape[-1])
    return flat[np.linspace(0, len(flat) - 1, min(draws, len(flat))).round().astype(int)]


class _Runner:
    """One ensemble: its sampler and where it stands."""

    def __init__(self, log_probability: Vectorised, moves: list, first: NDArray, seed: int) -> None:
        import emcee

        self._sampler = emcee.EnsembleSampler(len(first), first.shape[1], log_probability, moves=moves, vectorize=True)
        state = np.random.RandomState(seed).get_state()
        self._state: Any = emcee.State(first, random_state=state)

    @classmethod
    def started(
        cls, log_probability: Vectorised, unbounded: Vectorised, open_space: "OpenSpace", places: NDArray,
        covariance: NDArray, walkers: int, seed: np.random.SeedSequence,
    ) -> "_Runner":  # fmt: skip
        """Start an ensemble around its places, in coordinates without walls."""
        rng = np.random.default_rng(seed)
        first = open_space.outside(_first(log_probability, places, covariance, open_space.walls, walkers, rng))
        if len(places) == 1:
            near = open_space.outside(gaussian_within(rng, places[0], covariance, open_space.walls, 500))
            moves = mixed_moves(near.mean(axis=0)[None], np.atleast_2d(np.cov(near.T)))
        else:
            stretch = open_space.stretch(places[0])
            moves = mixed_moves(open_space.outside(places), covariance * np.outer(stretch, stretch))
        return cls(unbounded, moves, first, int(rng.integers(2**31)))

    def restarted(self, log_probability: Vectorised, moves: list) -> None:
        """Go on from here with other moves, forgetting the steps so far."""
        import emcee

        walkers, parameters = np.shape(self._state.coords)
        self._sampler = emcee.EnsembleSampler(walkers, parameters, log_probability, moves=moves, vectorize=True)

    def advance(self, steps: int) -> None:
        """Take steps."""
        self._state = self._sampler.run_mcmc(self._state, steps, skip_initial_state_check=True)

    def chain(self) -> NDArray[np.float64]:
        """Return all steps so far, shape (step, walker, parameter)."""
        return np.asarray(self._sampler.get_chain())

    @property
    def acceptance(self) -> float:
        return float(np.mean(self._sampler.acceptance_fraction))


def _peaks(
    log_probability: Vectorised, places: NDArray, covariance: NDArray, walls: NDArray, seed: int
) -> NDArray[np.float64]:
    """Return the places and every other peak of comparable height that climbs from between the bounds reach."""
    if not np.isfinite(walls).all():
        return places
    wide = np.random.default_rng([seed, 1]).uniform(walls[:, 0], walls[:, 1], (64, len(walls)))
    possible = wide[np.isfinite(log_probability(wide))][: max(2, CLIMBS // len(walls))]
    inverse = np.linalg.pinv(root_of(covariance))
    for begin in possible:
        peak, _ = maximum(log_probability, begin, walls, iterations=15)
        height = log_probability(np.concatenate([peak[None], places]))
        far = np.sum(((places - peak) @ inverse.T) ** 2, axis=1).min() > FAR_SD**2
        if far and height[0] > height[1:].max() - LOWEST_PEAK:
            places = np.concatenate([places, peak[None]])
    return places


def _first(
    log_probability: Vectorised,
    places: NDArray,
    covariance: NDArray,
    walls: NDArray,
    walkers: int,
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """Return where the walkers begin: around their places, wider than the curvature says."""
    share = np.array_split(np.arange(walkers), len(places))
    first = np.concatenate(
        [
            gaussian_within(rng, place, 2.0 * covariance, walls, len(part))
            for place, part in zip(places, share, strict=True)
        ]
    )
    for shrink in 2.0 ** -np.arange(1.0, 20.0):
        lost = ~np.isfinite(log_probability(first))
        if not lost.any():
            return first
        first[lost] = gaussian_within(rng, places[0], shrink * covariance, walls, int(lost.sum()))
    raise ValueError(f"no point near the start {places[0].tolist()} has a finite log-probability")
