"""Independent ensembles of walkers, side by side in one sampler of emcee."""

import sys
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.posterior.laplace import Vectorised, truncated_gaussian_draws
from charact.posterior.moves import DifferentialEvolution

Array = NDArray[np.float64]


class Ensembles:
    """Ensembles that take their steps together and never see each other.

    Parameters
    ----------
    log_probability
        Vectorised: points (n, parameter) -> (n,).
    moves
        Moves with their weights, as of `charact.posterior.moves.walker_moves`.
    first
        Where the walkers begin, shape (ensemble, walker, parameter).
    seed
        Seed of all their draws.
    """

    def __init__(self, log_probability: Vectorised, moves: list[tuple[Any, float]], first: Array, seed: int) -> None:
        self.shape = first.shape
        random_state = np.random.RandomState(seed).get_state()
        together = first.reshape(-1, first.shape[-1])
        self._state: Any = _emcee().State(together, random_state=random_state)
        self.restart(log_probability, moves)

    def restart(self, log_probability: Vectorised, moves: list[tuple[Any, float]]) -> None:
        """Go on from here with other moves, forgetting the steps so far."""
        count, parameters = np.shape(self._state.coords)
        self._moves = [move for move, _ in moves]
        self._sampler = _emcee().EnsembleSampler(count, parameters, log_probability, moves=moves, vectorize=True)

    def advance(self, steps: int) -> None:
        """Take steps."""
        self._state = self._sampler.run_mcmc(self._state, steps, skip_initial_state_check=True)

    def chains(self) -> Array:
        """Return all steps so far, shape (ensemble, step, walker, parameter)."""
        chain = np.asarray(self._sampler.get_chain())
        return np.moveaxis(chain.reshape(len(chain), *self.shape), 1, 0)

    @property
    def acceptance(self) -> Array:
        """Share of the steps in which each walker moved, shape (walker of all ensembles,)."""
        return np.asarray(self._sampler.acceptance_fraction)

    @property
    def local_acceptance(self) -> float:
        """Share of the proposals of differential evolution that were taken; one half before there were any."""
        local = [move for move in self._moves if isinstance(move, DifferentialEvolution)]
        proposed = sum(move.proposed for move in local)
        return sum(move.accepted for move in local) / proposed if proposed else 0.5


def first_places(
    log_probability: Vectorised,
    places: Array,
    covariance: Array,
    walls: Array,
    walkers: int,
    rng: np.random.Generator,
) -> Array:
    """Return where the walkers of an ensemble begin: shared out over its places, wider than the curvature says.

    No walker begins where the log-probability is not finite, for it might stay there for ever.
    """
    share = np.array_split(np.arange(walkers), len(places))
    first = np.concatenate(
        [
            truncated_gaussian_draws(rng, place, 2.0 * covariance, walls, len(part))
            for place, part in zip(places, share, strict=True)
        ]
    )
    for shrink in 2.0 ** -np.arange(1.0, 20.0):
        lost = ~np.isfinite(log_probability(first))
        if not lost.any():
            return first
        first[lost] = truncated_gaussian_draws(rng, places[0], shrink * covariance, walls, int(lost.sum()))
    raise ValueError(f"no point near the start {places[0].tolist()} has a finite log-probability")


def _emcee() -> ModuleType:
    """Import emcee, at a tenth of its cost: all but one of its moves do without scipy.stats.

    emcee takes the absence of scipy.stats for granted where it is absent, and only its kernel density move then
    refuses; whoever has loaded scipy.stats or emcee before has them whole.
    """
    if "emcee" not in sys.modules and "scipy.stats" not in sys.modules:
        sys.modules["scipy.stats"] = None  # pyright: ignore[reportArgumentType]
        try:
            import emcee
        finally:
            del sys.modules["scipy.stats"]
    import emcee

    return emcee
