"""Simulation-based calibration: over many truths drawn from a prior, each has a uniform rank among its posterior draws.

An engine or model whose intervals are too narrow puts truths at the ends of the ranks, one too wide in the middle,
one that is off to a side.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.study.harness import Progress
from labdata.errors import BadInput
from labdata.measurement import Posterior

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Ranks of truths among draws from their posteriors.

    Parameters
    ----------
    names
        Of the parameters.
    ranks
        How many of the draws lie below the truth, shape (trial, parameter).
    draws
        Number of draws of each posterior: ranks run from 0 to it.
    flagged
        Trials left out because their posterior was flagged.
    seed
        Seed of the first trial; the others follow.
    """

    names: tuple[str, ...]
    ranks: NDArray[np.int64]
    draws: int
    flagged: int
    seed: int

    def histogram(self, name: str) -> NDArray[np.int64]:
        """Return how many ranks of a parameter fall into each of equal bins, shape (bin,)."""
        bins = self._bins()
        width = (self.draws + 1) // bins
        return np.bincount(self.ranks[:, self.names.index(name)] // width, minlength=bins)

    def band(self, level: float = 0.95) -> tuple[float, float]:
        """Return the counts between which one bin lies with this probability if ranks are uniform."""
        from scipy.stats import binom

        low, high = binom.interval(level, len(self.ranks), 1.0 / self._bins())
        return float(low), float(high)

    def chi_squared(self, name: str) -> tuple[float, float]:
        """Return chi squared of a parameter's histogram against a uniform one, and the probability of one as large."""
        from scipy.stats import chi2

        counts = self.histogram(name)
        expected = counts.sum() / counts.size
        value = float(np.sum((counts - expected) ** 2) / expected)
        return value, float(chi2.sf(value, counts.size - 1))

    @property
    def probability(self) -> float:
        """Probability of the least uniform histogram, allowing for the number of parameters (Bonferroni)."""
        return min(1.0, len(self.names) * min(self.chi_squared(name)[1] for name in self.names))

    def coverage(self, level: float) -> NDArray[np.floating]:
        """Return how often the central interval of a level holds the truth, shape (parameter,)."""
        place = (self.ranks + 0.5) / (self.draws + 1)
        return np.mean(np.abs(place - 0.5) < level / 2, axis=0)

    def _bins(self) -> int:
        """Equal bins of ranks: at most 20, at least 5 trials each on average."""
        most = max(2, min(20, len(self.ranks) // 5))
        return next(bins for bins in range(most, 0, -1) if (self.draws + 1) % bins == 0)


def calibrate(
    prior: Callable[[np.random.Generator], Array],
    data: Callable[[Array, np.random.Generator], Any],
    posterior: Callable[[Any, int], Posterior | Array],
    *,
    names: tuple[str, ...],
    trials: int,
    seed: int,
    draws: int = 119,
    progress: Progress = lambda text, share: None,
) -> Calibration:
    """Draw truths and data, and rank each truth among draws from the posterior of its data.

    Parameters
    ----------
    prior
        Maps a generator to a truth, shape (parameter,).
    data
        Maps a truth and a generator to data.
    posterior
        Maps data and a seed to a `Posterior`, or to nearly independent draws (draw, parameter), at least `draws`
        of them. A flagged one is left out and counted.
    names
        Of the parameters.
    trials
        Number of truths.
    seed
        Trial t is drawn with the seed (seed, t).
    draws
        Draws used of each posterior, evenly thinned; 119 can be put into 20, 15, 12, 10 or fewer equal bins.
    progress
        Called with a sentence and the share done.

    Raises
    ------
    BadInput
        If there are fewer than ten trials, or a posterior gives fewer draws than asked for.

    Notes
    -----
    Talts et al. 2018, arXiv:1804.06788: with truth from the prior and data from the truth, the rank of the truth among
    L independent draws of the posterior is uniform over 0 to L. Leaving out flagged trials keeps that true only as
    far as flags do not depend on the truth, so their number belongs to the result.
    """
    if trials < 10:
        raise BadInput(f"trials must be at least 10, got {trials}")
    ranks, flagged = [], 0
    for trial in range(trials):
        progress("trial", trial / trials)
        rng = np.random.default_rng([seed, trial])
        truth = np.asarray(prior(rng), float)
        found = posterior(data(truth, rng), int(rng.integers(1 << 31)))
        if isinstance(found, Posterior) and found.flags:
            flagged += 1
            continue
        drawn = found.draws if isinstance(found, Posterior) else np.asarray(found, float)
        ranks.append(_rank(drawn, truth, draws))
    progress("trials done", 1.0)
    if len(ranks) < 10:
        raise BadInput(f"at least 10 posteriors must be without flags, got {len(ranks)} of {trials}")
    return Calibration(names=names, ranks=np.array(ranks), draws=draws, flagged=flagged, seed=seed)


def _rank(drawn: Array, truth: Array, wanted: int) -> NDArray[np.int64]:
    """Return how many of the wanted draws lie below the truth, for each parameter."""
    if drawn.ndim != 2 or drawn.shape[1] != truth.size or len(drawn) < wanted:
        raise BadInput(f"a posterior must give ({wanted} or more, {truth.size}) draws, got {drawn.shape}")
    kept = drawn[np.linspace(0, len(drawn) - 1, wanted).round().astype(int)]
    return np.sum(kept < truth, axis=0)
