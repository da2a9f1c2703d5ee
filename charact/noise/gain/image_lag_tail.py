"""Light that glows on beyond the last lag that the frames can tell: as much as a screen that decays evenly leaves.

Pixels are measured about their mean over few exposures. Light that all of these share goes with the mean, so that
every covariance in time reads low by what lies beyond the last lag, and the sum over lags lacks it once more. What
chance gives to the covariances of a few exposures it gives to all lags alike, as a slow glow would: glow is put back
so far as it is likelier than none.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from charact.noise.stack.stack_statistics import StackStatistics
from charact.noise.stack.temporal import truncation_bias

Array = NDArray[np.float64]

# Share of the light that is left one exposure later, each as likely as the next.
KEPT = np.linspace(0.02, 0.9, 45)
# The first lag holds fast parts of the decay that later ones have not; fewer lags than this tell no decay.
FIRST, LEAST = 2, 3
# Standard errors on either side of the likeliest height that are looked at.
REACH = 5.0
HEIGHTS = 32


def untruncated_lag_sum(flats: Sequence[StackStatistics], share: Array, lags: NDArray[np.int64], correlation: Array, covariance: Array
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
    correlation, covariance
        Covariance at the lags from 1 over that at lag 0 as measured, shape (lag,), and that of its errors.

    Notes
    -----
    Beyond the first lag the correlation is b r^(lag - 2), r the share of the light that is left one exposure later.
    About the mean of the exposures the lag k reads less, see `truncation_bias`. The mean over all b and r, each as likely as
    the next, and over no glow, as likely as all of them, weighed by the likelihood exp(-chi^2/2); it changes with the
    correlation c by the covariance of what is lacking with the form, over that of the errors.
    """
    none = np.zeros(len(correlation))
    use = lags[1:] >= FIRST
    if use.sum() < LEAST:
        return 0.0, none
    last, taken = KEPT ** (lags[-1] - FIRST), _truncation_biases(flats, share, lags)
    form = (KEPT[:, None] ** (lags[1:] - FIRST) + last[:, None] * taken[:, 1:])[:, use]
    lacking = last * (2.0 * KEPT / (1.0 - KEPT) - taken[:, 0] - 2.0 * taken[:, 1:].sum(axis=1))
    precision = np.asarray(np.linalg.inv(covariance[np.ix_(use, use)]), np.float64)
    measured = correlation[use]
    heights, step = _heights(form, measured, precision)
    rest = measured - heights[:, :, None] * form
    chi2 = np.einsum("brk,kl,brl->br", rest, precision, rest)
    chi2_none = measured @ precision @ measured
    least = min(chi2.min(), chi2_none)
    likely = np.exp(-0.5 * (chi2 - least)) * step / len(KEPT)
    likely /= likely.sum() + np.exp(-0.5 * (chi2_none - least))
    value = heights * lacking
    mean = float(np.sum(likely * value))
    change = none.copy()
    change[use] = precision @ np.einsum("br,br,rk->k", likely * (value - mean), heights, form)
    return mean, change


def _heights(form: Array, correlation: Array, precision: Array) -> tuple[Array, Array]:
    """Heights to look at for each decay, shape (height, kept), and the steps between them, shape (kept,)."""
    weighed = form @ precision
    information = np.einsum("rk,rk->r", weighed, form)
    height = weighed @ correlation / information
    width = REACH / np.sqrt(information)
    low, high = np.clip(height - width, 0.0, 1.0), np.clip(np.maximum(height, 0.0) + width, 0.0, 1.0)
    parts = (np.arange(HEIGHTS) + 0.5) / HEIGHTS
    return low + (high - low) * parts[:, None], (high - low) / HEIGHTS


def _truncation_biases(flats: Sequence[StackStatistics], share: Array, lags: NDArray[np.int64]) -> Array:
    """What each pooled covariance reads too much (below zero) per covariance at the last lag, shape (kept, lag + 1)."""
    out = np.zeros((len(KEPT), len(lags)))
    for weight, flat in zip(share, flats, strict=True):
        distance, added = truncation_bias(flat.time, flat.parity, flat.many.lags)
        out += weight * KEPT[:, None] ** (distance - lags[-1]) @ added[: len(lags)].T
    return out
