"""Draws of a posterior about its mode, and the rule by which chains are believed.

Slice sampling, and where its chains do not converge an ensemble of emcee. Of a normal posterior of
d parameters ln p(mode) - ln p(draw) is half a chi squared of d degrees of freedom, of mean d/2.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from charact.fitting.slice_sampling import LogProbability, root_of, slice_rounds
from charact.fitting.thresholds import CONVERGENCE, SAMPLING
from charact.inference.diagnostics import autocorrelation_time
from labdata import Array
from labdata.measurement import Posterior

Sampler = Literal["slice", "emcee"]


def draw_posterior(
    log_probability: LogProbability,
    *,
    names: tuple[str, ...],
    point: Array,
    covariance: Array,
    seed: int,
) -> Posterior:
    """Draw from a posterior about a mode.

    Parameters
    ----------
    log_probability
        Points (n, parameter) -> (n,).
    names
        Name of each parameter.
    point, covariance
        The mode, shape (parameter,), and covariance there, shape (parameter, parameter).
    seed
        Seed of every draw.

    Returns
    -------
    Posterior
        Flag `not-converged` if the chains of neither sampler meet the rule of `Convergence`.
    """
    peak = float(log_probability(point[None])[0])
    samplers: dict[Sampler, Iterator[Array]] = {
        "slice": slice_rounds(log_probability, point, covariance, np.random.default_rng(seed)),
        "emcee": ensemble_rounds(log_probability, point, covariance, seed),
    }
    # Where all steps are not believed, the first half may still be on its way from the mode.
    attempts: Iterator[tuple[Sampler, Array]] = (
        (name, later_steps)
        for name, rounds in samplers.items()
        for chains in rounds
        for later_steps in (chains, chains[len(chains) // 2 :])
    )
    sampler: Sampler = "slice"
    for sampler, chains in attempts:  # noqa: B007  # the last one is that of the draws
        draws = _draws_of(chains)
        state = Convergence.of(chains, peak - log_probability(draws))
        if state.is_reached:
            break
    return Posterior(
        names=names,
        units=("1",) * len(names),
        draws=draws,
        sampler=sampler,
        seed=seed,
        flags=() if state.is_reached else ("not-converged",),
        effective_sample_size=state.effective,
    )


@dataclass(frozen=True, kw_only=True)
class Convergence:
    """What chains say of themselves."""

    shift_sd: Array  # means of their halves apart, standard deviations, shape (parameter,)
    effective: Array  # effective number of draws, shape (parameter,)
    chains: int
    depth: float  # mean of ln p(mode) - ln p(draw)
    depth_range: tuple[float, float]  # what that is of a nearly normal posterior

    @classmethod
    def of(cls, chains: Array, depths: Array) -> "Convergence":
        """Judge chains (step, chain, parameter) and ln p(mode) - ln p(draw) of draws, shape
        (draw,).
        """
        half, (steps, count, parameters) = len(chains) // 2, chains.shape
        draws = chains.reshape(-1, parameters)
        early, late = chains[:half].mean(axis=(0, 1)), chains[half:].mean(axis=(0, 1))
        tolerance, slack = CONVERGENCE.depth_tolerance, CONVERGENCE.depth_slack
        return cls(
            shift_sd=np.abs(late - early) / np.maximum(draws.std(axis=0), 1e-300),
            effective=steps * count / autocorrelation_time(chains),
            chains=count,
            depth=float(depths.mean()),
            depth_range=(
                (1.0 - tolerance) * parameters / 2.0 - slack,
                (1.0 + tolerance) * parameters / 2.0 + slack,
            ),
        )

    @property
    def is_reached(self) -> bool:
        """Whether the chains are believed."""
        low, high = self.depth_range
        # Chains of a few autocorrelation times do not show how far they have yet to go.
        least_effective = max(CONVERGENCE.least_effective, CONVERGENCE.least_of_chain * self.chains)
        return bool(
            self.shift_sd.max() <= CONVERGENCE.most_shift_sd
            and self.effective.min() >= least_effective
            and low <= self.depth <= high
        )


def ensemble_rounds(
    log_probability: LogProbability, start: Array, covariance: Array, seed: int
) -> Iterator[Array]:
    """Yield all steps of emcee's walkers after the burn-in, shape (step, walker, parameter), after
    each round of steps: moves by differential evolution and independent draws, whose law follows
    the walkers during the burn-in.
    """
    from charact.inference.ensembles import Ensembles, walker_moves

    walkers = SAMPLING.walkers_per_parameter * start.size + SAMPLING.walkers_per_parameter
    normal = np.random.default_rng([seed, 3]).standard_normal((1, walkers, start.size))
    running = Ensembles(
        log_probability,
        walker_moves(start[None], covariance, 1),
        start + normal @ root_of(covariance).T,
        seed,
    )
    for steps in SAMPLING.walkers_burn_in_steps:
        running.advance(steps)
        sampled = running.chains()[0, steps // 2 :].reshape(-1, start.size)
        law = np.atleast_2d(np.cov(sampled.T))
        running.restart(log_probability, walker_moves(sampled.mean(axis=0)[None], law, 1))
    for steps in SAMPLING.walkers_steps:
        running.advance(steps)
        yield running.chains()[0]


def _draws_of(chains: Array) -> Array:
    """Return `SAMPLING.chains` draws of chains: of each its last point, of few chains also points
    evenly before it.
    """
    steps, count, parameters = chains.shape
    picked = np.linspace(steps - 1, 0, -(-SAMPLING.chains // count)).round().astype(int)
    return chains[picked].reshape(-1, parameters)[: SAMPLING.chains]
