"""Posterior draws by importance sampling, or by MCMC where the effective sample size is too
small.
"""

from dataclasses import replace

from numpy.typing import ArrayLike

from charact.inference.chain import sample
from charact.inference.diagnostics import has_several_peaks
from charact.inference.importance import FIRST_DRAWS, importance_sample
from charact.inference.laplace import Vectorised
from labdata.measurement import Posterior

# Requested effective sample size: 95 % intervals of a hundred edges are within 0.5 % of those at
# nine thousand. Below the second number the posterior is not determined.
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
    """Draw from a posterior of one mode, or of several close ones, by importance sampling where
    sufficient.

    Parameters
    ----------
    log_probability, names, units, start, covariance, seed, bounds, draws
        As of `importance_sample`.
    max_steps
        Maximum number of steps of each ensemble of the Markov chain.
    effort
        Fraction of the first draws and of the requested effective sample size: low for models of
        small weight.

    Returns
    -------
    Posterior
        Its sampler is recorded; `several-modes` if its draws have several modes.

    Notes
    -----
    Importance sampling finds the modes near the first one. Distant modes are found only by the
    optimisations of a Markov chain.
    """
    asked = {
        "names": names,
        "units": units,
        "start": start,
        "covariance": covariance,
        "seed": seed,
        "bounds": bounds,
        "draws": draws,
    }
    posterior = importance_sample(
        log_probability, **asked, enough=WANTED * effort, first_draws=round(FIRST_DRAWS * effort)
    )
    if posterior.effective_sample_size.min() < ENOUGH * effort:
        return sample(log_probability, **asked, max_steps=max_steps)
    return (
        replace(posterior, flags=(*posterior.flags, "several-modes"))
        if has_several_peaks(posterior.draws)
        else posterior
    )
