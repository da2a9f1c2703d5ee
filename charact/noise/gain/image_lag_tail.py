"""Image lag beyond the last measurable lag, for an exponential decay.

Centring few exposures removes light common to all of them, which lowers every temporal covariance; the sum over lags
lacks the rest once more. Chance errors are common to all lags too, like slow decay, so the correction is weighted
against no decay by its likelihood.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from charact.noise.stack.stack_statistics import StackStatistics
from charact.noise.stack.temporal import truncation_bias
from charact.noise.thresholds import GAIN

Array = NDArray[np.float64]

# Fraction of the light left one exposure later, uniform prior.
KEPT = np.linspace(0.02, 0.9, 45)


def untruncated_lag_sum(
    flats: Sequence[StackStatistics], share: Array, lags: NDArray[np.int64], correlation: Array, covariance: Array
) -> tuple[float, Array]:
    """Return the missing part of the correlation sum over all lags, and its derivative by the correlations.

    Parameters
    ----------
    flats
        The pooled levels.
    share
        Weight of each flat in the pooled covariances, sum 1, shape (flat,).
    lags
        Common lags from 0, exposures, shape (lag + 1,).
    correlation, covariance
        Correlation at the lags from 1, shape (lag,), and the covariance of its errors.

    Notes
    -----
    Beyond the first lag the correlation is b r^(lag - 2), r the fraction of the light left one exposure later; centring
    lowers it at each lag, see `truncation_bias`. The result is the mean over uniform b and r, and over no decay with
    equal total weight, weighted by the likelihood exp(-chi^2/2). Its derivative by the correlations is the posterior
    covariance of the missing part with the model, times the inverse covariance of the errors.
    """
    none = np.zeros(len(correlation))
    use = lags[1:] >= GAIN.first_lag
    if use.sum() < GAIN.min_decay_lags:
        return 0.0, none
    last, taken = KEPT ** (lags[-1] - GAIN.first_lag), _truncation_biases(flats, share, lags)
    form = (KEPT[:, None] ** (lags[1:] - GAIN.first_lag) + last[:, None] * taken[:, 1:])[:, use]
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
    """Return the amplitudes for each decay, shape (height, kept), and their spacing, shape (kept,)."""
    weighed = form @ precision
    information = np.einsum("rk,rk->r", weighed, form)
    height = weighed @ correlation / information
    width = GAIN.amplitude_sd / np.sqrt(information)
    low, high = np.clip(height - width, 0.0, 1.0), np.clip(np.maximum(height, 0.0) + width, 0.0, 1.0)
    parts = (np.arange(GAIN.amplitudes) + 0.5) / GAIN.amplitudes
    return low + (high - low) * parts[:, None], (high - low) / GAIN.amplitudes


def _truncation_biases(flats: Sequence[StackStatistics], share: Array, lags: NDArray[np.int64]) -> Array:
    """Return the bias of each pooled covariance per covariance at the last lag, shape (kept, lag + 1); negative."""
    out = np.zeros((len(KEPT), len(lags)))
    for weight, flat in zip(share, flats, strict=True):
        distance, added = truncation_bias(flat.time, flat.parity, flat.many.lags)
        out += weight * KEPT[:, None] ** (distance - lags[-1]) @ added[: len(lags)].T
    return out
