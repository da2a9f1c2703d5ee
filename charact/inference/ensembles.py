"""Parallel ensembles of walkers in one emcee sampler, and their moves."""

import sys
from math import lgamma, log, sqrt
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.inference.laplace_approximation import (
    Vectorised,
    covariance_root,
    draw_truncated_gaussian,
)
from charact.inference.probit_transform import NormalScores

Array = NDArray[np.float64]

# Weight, degrees of freedom and scale of the Student t densities: body, and tails that prevent
# stuck walkers where the posterior is much denser than the proposal.
BODY_AND_TAILS = ((0.9, 20.0, 1.0), (0.1, 3.0, 1.5))
INDEPENDENT_SHARE = 0.75


def walker_moves(
    centres: Array, covariance: Array, ensembles: int, scores: NormalScores | None = None
) -> list[tuple[Any, float]]:
    """Return the moves of consecutive ensembles with their weights.

    Independent draws scatter around optima, shape (place, parameter), in scores or, without these,
    in the parameters.
    """
    return [
        (DifferentialEvolution(ensembles), 1.0 - INDEPENDENT_SHARE),
        (IndependentDraws(centres, covariance, scores), INDEPENDENT_SHARE),
    ]


class DifferentialEvolution:
    """Move one half of each ensemble's walkers by differences between walkers of the other half.

    Notes
    -----
    x' = x + gamma (a - b), a and b two walkers of the other half, gamma = 2.38 / sqrt(2 d) (ter
    Braak 2006, doi 10.1007/s11222-006-8769-1); symmetric, since a - b is as likely as b - a.
    """

    def __init__(self, ensembles: int) -> None:
        self._ensembles = ensembles
        self.proposed = self.accepted = 0

    def propose(self, model: Any, state: Any) -> tuple[Any, NDArray[np.bool_]]:
        """Move both halves in turn; return the state and which walkers moved."""
        count = len(state.coords) // self._ensembles
        split = np.argsort(model.random.rand(self._ensembles, count), axis=1)
        split += count * np.arange(self._ensembles)[:, None]
        accepted = np.zeros(len(state.coords), bool)
        halves = split[:, : count // 2], split[:, count // 2 :]
        for moving, still in (halves, halves[::-1]):
            fresh = state.coords[moving] + _differences(
                state.coords[still], moving.shape[1], model.random
            )
            fresh = fresh.reshape(moving.size, -1)
            accepted |= _metropolis_step(model, state, moving.ravel(), fresh, np.zeros(moving.size))
        self.proposed, self.accepted = (
            self.proposed + accepted.size,
            self.accepted + int(accepted.sum()),
        )
        return state, accepted


def _differences(walkers: Array, wanted: int, random: np.random.RandomState) -> Array:
    """Return scaled differences of pairs of others (ensemble, walker, parameter), `wanted` for each
    ensemble.
    """
    ensembles, count, parameters = walkers.shape
    first = random.randint(count, size=(ensembles, wanted))
    second = (first + random.randint(1, count, size=(ensembles, wanted))) % count
    row = np.arange(ensembles)[:, None]
    is_jump = random.rand(ensembles, wanted, 1) < 0.1
    gamma = np.where(is_jump, 1.0, 2.38 / np.sqrt(2.0 * parameters))
    return gamma * (walkers[row, first] - walkers[row, second])


class IndependentDraws:
    """Propose draws from a mixture of Student t densities, body and tails around each optimum."""

    def __init__(
        self, centres: Array, covariance: Array, scores: NormalScores | None = None
    ) -> None:
        self._centres = centres
        self._scores = scores
        self._root = covariance_root(covariance)
        self._inverse = np.linalg.pinv(self._root)

    def propose(self, model: Any, state: Any) -> tuple[Any, NDArray[np.bool_]]:
        """Move all walkers; return the state and which walkers moved."""
        random, (count, parameters) = model.random, state.coords.shape
        shares, freedoms, scales = np.array(BODY_AND_TAILS).T
        part = np.searchsorted(np.cumsum(shares)[:-1], random.rand(count), side="right")
        stretch = scales[part] * np.sqrt(freedoms[part] / random.chisquare(freedoms[part]))
        centre = self._centres[random.randint(len(self._centres), size=count)]
        fresh = (
            centre + (random.standard_normal((count, parameters)) * stretch[:, None]) @ self._root.T
        )
        if self._scores is None:
            log_ratio = self._log_density(state.coords) - self._log_density(fresh)
            return state, _metropolis_step(model, state, np.arange(count), fresh, log_ratio)
        now, slope_now = self._scores.of(state.coords)
        points, slope = self._scores.points(fresh)
        log_ratio = self._log_density(now) + slope_now - self._log_density(fresh) - slope
        return state, _metropolis_step(model, state, np.arange(count), points, log_ratio)

    def _log_density(self, points: Array) -> Array:
        """Return the log-density of the mixture up to a constant, shape (point,)."""
        squares = (((points[:, None, :] - self._centres) @ self._inverse.T) ** 2).sum(-1)
        parts = [_log_student_t(squares, points.shape[1], *part) for part in BODY_AND_TAILS]
        return np.logaddexp.reduce(np.concatenate(parts, axis=1), axis=1)


def _log_student_t(
    squares: Array, parameters: int, weight: float, freedom: float, scale: float
) -> Array:
    """Return the log of a weighted Student t density at squared distances, without the common
    constant.
    """
    half = 0.5 * (freedom + parameters)
    norm = lgamma(half) - lgamma(0.5 * freedom) - parameters * log(scale * sqrt(freedom))
    return log(weight) + norm - half * np.log1p(squares / (freedom * scale**2))


def _metropolis_step(
    model: Any, state: Any, index: NDArray[np.intp], fresh: Array, log_ratio: Array
) -> NDArray[np.bool_]:
    """Accept or reject proposals for some walkers (Metropolis-Hastings); return which of all
    walkers moved.
    """
    log_probability, _ = model.compute_log_prob_fn(fresh)
    gain = log_probability - state.log_prob[index] + log_ratio
    accepted = np.log(model.random.rand(len(index))) < gain
    state.coords[index[accepted]] = fresh[accepted]
    state.log_prob[index[accepted]] = log_probability[accepted]
    has_moved = np.zeros(len(state.coords), bool)
    has_moved[index[accepted]] = True
    return has_moved


class Ensembles:
    """Independent ensembles that are advanced together, from walkers of shape (ensemble, walker,
    parameter).
    """

    def __init__(
        self, log_probability: Vectorised, moves: list[tuple[Any, float]], first: Array, seed: int
    ) -> None:
        self.shape = first.shape
        random_state = np.random.RandomState(seed).get_state()
        together = first.reshape(-1, first.shape[-1])
        self._state: Any = _emcee().State(together, random_state=random_state)
        self.restart(log_probability, moves)

    def restart(self, log_probability: Vectorised, moves: list[tuple[Any, float]]) -> None:
        """Continue from here with other moves; previous steps are discarded."""
        count, parameters = np.shape(self._state.coords)
        self._moves = [move for move, _ in moves]
        self._sampler = _emcee().EnsembleSampler(
            count, parameters, log_probability, moves=moves, vectorize=True
        )

    def advance(self, steps: int) -> None:
        """Take steps."""
        self._state = self._sampler.run_mcmc(self._state, steps, skip_initial_state_check=True)

    def chains(self) -> Array:
        """Return all steps so far, shape (ensemble, step, walker, parameter)."""
        chain = np.asarray(self._sampler.get_chain())
        return np.moveaxis(chain.reshape(len(chain), *self.shape), 1, 0)

    @property
    def acceptance(self) -> Array:
        """Fraction of steps in which each walker moved, shape (walker of all ensembles,)."""
        return np.asarray(self._sampler.acceptance_fraction)

    @property
    def local_acceptance(self) -> float:
        """Fraction of accepted differential-evolution proposals; one half before the first."""
        local = [move for move in self._moves if isinstance(move, DifferentialEvolution)]
        proposed = sum(move.proposed for move in local)
        return sum(move.accepted for move in local) / proposed if proposed else 0.5


def first_places(
    log_probability: Vectorised,
    starts: Array,
    covariance: Array,
    walls: Array,
    walkers: int,
    rng: np.random.Generator,
) -> Array:
    """Return the initial walkers of an ensemble around its optima, wider than the curvature.

    A walker at a log-probability that is not finite might never move.
    """
    parts = np.array_split(np.arange(walkers), len(starts))
    first = np.concatenate(
        [
            draw_truncated_gaussian(rng, start, 2.0 * covariance, walls, len(part))
            for start, part in zip(starts, parts, strict=True)
        ]
    )
    for shrink in 2.0 ** -np.arange(1.0, 20.0):
        lost = ~np.isfinite(log_probability(first))
        if not lost.any():
            return first
        first[lost] = draw_truncated_gaussian(
            rng, starts[0], shrink * covariance, walls, int(lost.sum())
        )
    raise ValueError(f"no point near the start {starts[0].tolist()} has a finite log-probability")


def _emcee() -> ModuleType:
    """Import emcee without scipy.stats, at a tenth of the time; only its kernel density move needs
    it.

    If scipy.stats cannot be imported, emcee does without it, and only its kernel density move
    fails; modules that are already loaded are not affected.
    """
    if "emcee" not in sys.modules and "scipy.stats" not in sys.modules:
        sys.modules["scipy.stats"] = None  # pyright: ignore[reportArgumentType]
        try:
            import emcee
        finally:
            del sys.modules["scipy.stats"]
    import emcee

    return emcee
