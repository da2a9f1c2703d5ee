"""Posterior draws by importance sampling, or by MCMC where the effective sample size is too small."""

from dataclasses import replace

from numpy.typing import ArrayLike

from charact.posterior.chain import sample
from charact.posterior.diagnostics import has_several_peaks
from charact.posterior.importance import importance_sample
from charact.posterior.laplace import Vectorised
from labdata.measurement import Posterior

# Effective draws by importance that are wanted: 95 % intervals of a hundred edges are then as wide as at nine thousand,
# within half a percent. Fewer than the others tell no posterior.
WANTED, ENOUGH = 2000.0, 1000.0


def sample_posterior(
    log_probability: Vectorised,
    *,
    names: tuple[str, ...],
    units: tuple[str, ...],
    start: ArrayLike,
    covariance: ArrayLike,
    seed: int,
    bounds: ArrayLike,
    draws: int = 1000,
    max_steps: int = 20000,
    effort: float = 1.0,
) -> Posterior:
    """Draw from a posterior of one mode, or of several close ones, by importance sampling where sufficient.

    Parameters
    ----------
    log_probability, names, units, start, covariance, seed, bounds, draws
        As of `charact.posterior.importance_sample`.
    max_steps
        Steps of each ensemble after which a Markov chain is given up.
    effort
        Share of the effective draws by importance that are wanted: of a form of little evidence few draws count.

    Returns
    -------
    Posterior
        Its sampler says how it was drawn; `several-modes` where its draws have several peaks.

    Notes
    -----
    Importance meets the peaks into which draws from about the first one fall. Others, far away, only a chain's climbs
    look for.
    """
    asked = {
        "names": names, "units": units, "start": start, "covariance": covariance, "seed": seed, "bounds": bounds,
        "draws": draws,
    }  # fmt: skip
    found = importance_sample(log_probability, **asked, enough=WANTED * effort)
    if found.effective_sample_size.min() < ENOUGH * effort:
        return sample(log_probability, **asked, max_steps=max_steps)
    return replace(found, flags=(*found.flags, "several-modes")) if has_several_peaks(found.draws) else found
