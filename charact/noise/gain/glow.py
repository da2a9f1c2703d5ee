"""Light that glows on beyond the last lag that the frames can tell: as much as a screen that decays evenly leaves.

Pixels are measured about their mean over few exposures. Light that all of these share goes with the mean, so that
every covariance in time reads low by what lies beyond the last lag, and the sum over lags lacks it once more.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from charact.noise.stack.level import Level
from charact.noise.stack.temporal import beyond

Array = NDArray[np.float64]

# Share of the light that is left one exposure later, each as likely as the next.
KEPT = np.linspace(0.02, 0.9, 45)
# The first lag holds fast parts of the decay that later ones have not; fewer lags than this tell no decay.
FIRST, LEAST = 2, 3
# Standard errors on either side of the likeliest height that are looked at.
REACH = 5.0


def unseen(flats: Sequence[Level], share: Array, lags: NDArray[np.int64], correlation: Array, sd: Array
           ) -> tuple[float, Array]:  # fmt: skip
    """Return what the sum of the correlation over all lags, earlier and later, lacks, and its change with each lag's.

    Parameters
    ----------
    flats
        The pooled levels.
    share
        Weight of each in the pooled covariances, of sum 1, shape (flat,).
    lags
        Lags from 0 that all of them have, exposures, shape (lag + 1,).
    correlation, sd
        Covariance at the lags from 1 over that at lag 0 as measured, and standard errors, shape (lag,).

    Notes
    -----
    Beyond the first lag the correlation is b r^(lag - 2), r the share of the light that is left one exposure later.
    About the mean of the exposures the lag k reads less, see `beyond`. The mean over all b and r, each as likely as
    the next, weighed by the likelihood exp(-chi^2/2); it changes with the correlation c_k, known to s_k, by the
    covariance of what is lacking with the form at k over s_k^2.
    """
    use = lags[1:] >= FIRST
    if use.sum() < LEAST:
        return 0.0, np.zeros(len(correlation))
    last, taken = KEPT ** (lags[-1] - FIRST), _taken(flats, share, lags)
    form = KEPT[:, None] ** (lags[1:] - FIRST) + last[:, None] * taken[:, 1:]
    lacking = last * (2.0 * KEPT / (1.0 - KEPT) - taken[:, 0] - 2.0 * taken[:, 1:].sum(axis=1))
    weight = use / sd**2
    information = form**2 @ weight
    height = form @ (weight * correlation) / information
    width = REACH / np.sqrt(information)
    low, high = np.clip(height - width, 0.0, 1.0), np.clip(np.maximum(height, 0.0) + width, 0.0, 1.0)
    heights = low + (high - low) * np.linspace(0.0, 1.0, 33)[:, None]
    chi2 = ((correlation - heights[:, :, None] * form) ** 2) @ weight
    likely = np.exp(-0.5 * (chi2 - chi2.min())) * (high - low)
    likely /= likely.sum()
    value = heights * lacking
    mean = float(np.sum(likely * value))
    return mean, weight * np.einsum("br,br,rk->k", likely * (value - mean), heights, form)


def _taken(flats: Sequence[Level], share: Array, lags: NDArray[np.int64]) -> Array:
    """What each pooled covariance reads too much (below zero) per covariance at the last lag, shape (kept, lag + 1)."""
    out = np.zeros((len(KEPT), len(lags)))
    for weight, flat in zip(share, flats, strict=True):
        distance, added = beyond(flat.time, flat.parity, flat.many.lags)
        out += weight * KEPT[:, None] ** (distance - lags[-1]) @ added[: len(lags)].T
    return out
