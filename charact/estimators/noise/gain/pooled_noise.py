"""Pooled noise spectrum over signal of all flats of one setting, with its errors and image lag."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from charact.estimators.noise.gain.model import PixelReadoutModel
from charact.estimators.noise.gain.series import FlatSeries, dark_shares
from charact.estimators.noise.gain.white_floor import OuterBand, outer_band_of
from charact.estimators.noise.thresholds import GAIN
from charact.frames.stack_statistics import StackStatistics
from charact.frames.temporal import (
    error_correlation,
    n_effective_samples,
    same_row_lags,
    truncation_bias,
)
from labdata.camera.description import Camera

Array = NDArray[np.float64]
# Fraction of the light left one exposure later, uniform prior.
KEPT = np.linspace(0.02, 0.9, 45)


def lag_sum_correction(
    flats: Sequence[StackStatistics],
    flat_weight: Array,
    lags: NDArray[np.int64],
    correlation: Array,
    covariance: Array,
) -> tuple[float, Array]:
    """Return the missing part of the correlation sum over all lags, and its derivative by the
    correlations.

    `flats`: the pooled levels; `flat_weight`: weight of each flat in the pooled covariances, sum
    1, shape (flat,); `lags`: common lags from 0, exposures, shape (lag + 1,); `correlation`,
    `covariance`: correlation at the lags from 1, shape (lag,), and the covariance of its errors.

    Beyond the first lag the correlation is b r^(lag - 2), r the fraction of the light left one
    exposure later; centring lowers it at each lag, see `truncation_bias`. The result is the mean
    over uniform b and r, and over no decay with equal total weight, weighted by the likelihood
    exp(-chi^2/2). Its derivative by the correlations is the posterior covariance of the missing
    part with the model, times the inverse covariance of the errors.
    """
    none = np.zeros(len(correlation))
    use = lags[1:] >= GAIN.first_lag
    if use.sum() < GAIN.min_decay_lags:
        return 0.0, none
    last, biases = KEPT ** (lags[-1] - GAIN.first_lag), _truncation_biases(flats, flat_weight, lags)
    form = (KEPT[:, None] ** (lags[1:] - GAIN.first_lag) + last[:, None] * biases[:, 1:])[:, use]
    lacking = last * (2.0 * KEPT / (1.0 - KEPT) - biases[:, 0] - 2.0 * biases[:, 1:].sum(axis=1))
    precision = np.asarray(np.linalg.inv(covariance[np.ix_(use, use)]), np.float64)
    measured = correlation[use]
    heights, step = _heights(form, measured, precision)
    residual = measured - heights[:, :, None] * form
    chi2 = np.einsum("brk,kl,brl->br", residual, precision, residual)
    chi2_none = measured @ precision @ measured
    lowest = min(chi2.min(), chi2_none)
    likely = np.exp(-0.5 * (chi2 - lowest)) * step / len(KEPT)
    likely /= likely.sum() + np.exp(-0.5 * (chi2_none - lowest))
    value = heights * lacking
    mean = float(np.sum(likely * value))
    change = none.copy()
    change[use] = precision @ np.einsum("br,br,rk->k", likely * (value - mean), heights, form)
    return mean, change


def _heights(form: Array, correlation: Array, precision: Array) -> tuple[Array, Array]:
    """Return the amplitudes for each decay, shape (height, kept), and their spacing, shape
    (kept,).
    """
    weighted = form @ precision
    information = np.einsum("rk,rk->r", weighted, form)
    height = weighted @ correlation / information
    width = GAIN.amplitude_sd / np.sqrt(information)
    low, high = (
        np.clip(height - width, 0.0, 1.0),
        np.clip(np.maximum(height, 0.0) + width, 0.0, 1.0),
    )
    parts = (np.arange(GAIN.amplitudes) + 0.5) / GAIN.amplitudes
    return low + (high - low) * parts[:, None], (high - low) / GAIN.amplitudes


def _truncation_biases(
    flats: Sequence[StackStatistics], flat_weight: Array, lags: NDArray[np.int64]
) -> Array:
    """Return the bias of each pooled covariance per covariance at the last lag, shape (kept, lag +
    1); negative.
    """
    out = np.zeros((len(KEPT), len(lags)))
    for weight, flat in zip(flat_weight, flats, strict=True):
        distance, added = truncation_bias(flat.time, flat.parity, flat.many_lags.lags)
        out += weight * KEPT[:, None] ** (distance - lags[-1]) @ added[: len(lags)].T
    return out


@dataclass(frozen=True, kw_only=True)
class ImageLag:
    """Image lag: correlation of exposures in time."""

    lag: NDArray[np.int64]  # lags, exposures, shape (lag,), from 1
    # correlation, correlation_sd: correlation of the modes at the lags and standard errors, shape
    # (lag,)
    correlation: Array
    correlation_sd: Array
    is_detected: bool  # whether image lag is detected
    # factor, factor_sd: sum of the correlation over all lags, positive and negative, and its
    # standard error: 1 without lag
    factor: float
    factor_sd: float
    freedom: float  # degrees of freedom of the standard error
    tested: bool  # whether there were enough frames for the test
    open: bool  # whether image lag extends beyond the last lag, so that its sum is too small


# Images too small for a spectrum, or too few frames for lags.
NO_LAG = ImageLag(
    lag=np.empty(0, np.int64),
    correlation=np.empty(0),
    correlation_sd=np.empty(0),
    is_detected=False,
    factor=1.0,
    factor_sd=0.0,
    freedom=np.inf,
    tested=False,
    open=False,
)


@dataclass(frozen=True, kw_only=True)
class PooledNoise:
    """Noise per DN of signal."""

    # column_cy_per_px, row_cy_per_px: frequencies of the bins, cycles per column pitch, shape
    # (bin,)
    column_cy_per_px: Array
    row_cy_per_px: Array
    reading: PixelReadoutModel  # pixel readout
    # variance of the frequencies mixed into one mode, along rows and along columns
    leak_cy2_per_px2: tuple[float, float]
    modes: Array  # independent modes of each bin over all exposures, shape (bin,)
    # power_dn, power_sd_dn: noise power over signal, both above the dark's, shape (bin,), DN
    power_dn: Array
    power_sd_dn: Array
    # variance_dn, variance_sd_dn: variance of a pixel over signal, DN
    variance_dn: float
    variance_sd_dn: float
    height_sd: float  # common relative standard error of all bins by the pulse-height distribution
    lag: ImageLag  # temporal correlation
    outer: OuterBand | None = None  # integrals beyond the band; None if no white floor is possible


def pool_noise(series: FlatSeries, sensor: Camera | None, *, floor: bool = False) -> PooledNoise:
    """Pool the fitted flats of a series, weighted by their information.

    `series`: the flats of one setting with their darks; `sensor`: sensor description for the
    readout model; None if unknown; `floor`: whether a white floor is possible; includes the
    integrals beyond the band.
    """
    chosen, weight = pooling(series)
    pairs = [(series.flats[i], series.darks[i]) for i in chosen]
    exposures = np.array([_exposures(flat) for flat, _ in pairs])
    bins = pairs[0][0].bins
    dark = weight @ np.array([d.many_lags.power_dn2[:, 0] for _, d in pairs])
    flat_weight = weight * series.signal_dn[chosen]
    lag = lag_of(
        *_power(pairs, weight, "many_lags"), dark, [flat for flat, _ in pairs], flat_weight
    )
    name = "many_lags" if lag.is_detected else "few_lags"
    power, _ = _power(pairs, weight, name)
    variance = np.array(
        [getattr(f, name).variance_dn2 - getattr(d, name).variance_dn2 for f, d in pairs]
    )
    by_heights = np.array(
        [_by_heights(flat, count) for (flat, _), count in zip(pairs, exposures, strict=True)]
    )
    known = np.array([_independent(flat, name, lag) for flat, _ in pairs])
    return PooledNoise(
        column_cy_per_px=bins.column_cy_per_px,
        row_cy_per_px=bins.row_cy_per_px,
        reading=PixelReadoutModel.of(bins.row_pitch, sensor),
        leak_cy2_per_px2=bins.leak_cy2_per_px2,
        modes=bins.modes * bins.efficiency * known[:, 0].sum(),
        power_dn=power[:, 0],
        power_sd_dn=_power_sd(pairs, weight, name, known[:, 0], lag),
        variance_dn=float(weight @ variance),
        variance_sd_dn=_variance_sd(pairs, weight, exposures / known[:, 1]),
        height_sd=float(np.sqrt(weight**2 @ by_heights) / max(weight @ variance, 1e-12)),
        lag=lag,
        outer=outer_band_of(pairs, weight, series.signal_dn[chosen], known[:, 0], name)
        if floor
        else None,
    )


def pooling(series: FlatSeries) -> tuple[NDArray[np.int64], Array]:
    """Return the flats to pool and the weight of each above its dark, shape (flat,), 1/DN.

    Weighted sums of variances are variances over signal.
    """
    chosen = np.flatnonzero(series.fitted)
    signal, flats = series.signal_dn[chosen], [series.flats[i] for i in chosen]
    weight = np.array([_exposures(flat) / flat.variance_dn2**2 for flat in flats]) * signal
    return chosen, weight / (weight @ signal)


def _exposures(level: StackStatistics) -> float:
    """Return the number of independent exposures of a stack."""
    return float(level.runs * (len(level.time) - len(np.unique(level.parity))))


def _by_heights(flat: StackStatistics, exposures: float) -> float:
    """Return the squared standard error of a variance beyond that of normal modes of the same
    spectrum, DN^4.

    A variance v of N pixels is the mean power of N modes, of relative variance 2 sum P^2 / (N v)^2
    from one exposure. The remaining power is distributed evenly over modes beyond the band.
    """
    pixels, power, modes = (
        flat.pixels / len(np.unique(flat.parity)),
        flat.few_lags.power_dn2[:, 0],
        2.0 * flat.bins.modes,
    )
    outer_power2 = max(pixels * flat.variance_dn2 - float(modes @ power), 0.0) ** 2 / (
        pixels - modes.sum()
    )
    normal = 2.0 * (float(modes @ power**2) + outer_power2) / pixels**2 / exposures
    return max(flat.variance_sd_dn2**2 - normal, 0.0)


def _power(pairs, weight: Array, name: str) -> tuple[Array, NDArray[np.int64]]:
    """Return the pooled spectrum above the dark's, shape (bin, lag), and its lags."""
    lags = min((getattr(level, name).lags for pair in pairs for level in pair), key=len)
    excess = [
        getattr(f, name).power_dn2[:, : len(lags)] - getattr(d, name).power_dn2[:, : len(lags)]
        for f, d in pairs
    ]
    return np.tensordot(weight, np.array(excess), 1), lags


def _independent(level: StackStatistics, name: str, lag: ImageLag) -> tuple[float, float]:
    """Return the independent exposures of the spectrum and of the variance of a stack."""
    lags = getattr(level, name).lags
    correlation = lag.correlation if lag.is_detected else np.empty(0)
    spectrum = n_effective_samples(level.time, level.parity, lags, correlation)
    same = same_row_lags(lags, level.parity)
    variance = n_effective_samples(level.time, level.parity, same, correlation, within_parity=True)
    return level.runs * spectrum, level.runs * variance


def _power_sd(pairs, weight: Array, name: str, known: Array, lag: ImageLag) -> Array:
    """Return the standard error of the pooled spectrum; a common dark is a common error."""
    bins = pairs[0][0].bins
    parts = [(flat, w, count) for w, (flat, _), count in zip(weight, pairs, known, strict=True)]
    parts += [
        (dark, w, _independent(dark, name, lag)[0])
        for dark, w in dark_shares([d for _, d in pairs], weight)
    ]
    square = sum(
        (w * getattr(level, name).power_dn2[:, 0]) ** 2 / count for level, w, count in parts
    )
    return np.sqrt(square / (bins.modes * bins.efficiency))


def _variance_sd(pairs, weight: Array, inflation: Array) -> float:
    """Return the standard error of the pooled variance over signal; `inflation` is the variance
    factor of the lags.
    """
    parts = [(flat, w, more) for w, (flat, _), more in zip(weight, pairs, inflation, strict=True)]
    parts += [(dark, w, 1.0) for dark, w in dark_shares([d for _, d in pairs], weight)]
    return float(np.sqrt(sum((w * level.variance_sd_dn2) ** 2 * more for level, w, more in parts)))


def lag_of(
    power: Array,
    lags: NDArray[np.int64],
    dark: Array,
    flats: list[StackStatistics],
    flat_weight: Array,
) -> ImageLag:
    """Return the temporal correlation, pooled over bins by information; errors from their scatter.

    Covariances at different lags use the same frames, so their errors are correlated bin by bin.
    """
    if len(lags) < 2:
        return NO_LAG
    bins = flats[0].bins
    radius = np.hypot(bins.column_cy_per_px, bins.row_cy_per_px)
    smooth = smooth_power(power[:, 0], radius, bins.modes)
    known = bins.modes * (smooth / (smooth + 2.0 * np.maximum(dark, 0.0))) ** 2
    weight = np.repeat(known[:, None], len(lags) - 1, axis=1)
    if len(np.unique(flats[0].parity)) > 1:
        weight *= (bins.row_cy_per_px * bins.row_pitch < GAIN.odd_lag_cy_per_row)[:, None] | (
            lags[1:] % 2 == 0
        )
    weight /= weight.sum(axis=0)
    # Blur differs along rows and columns: each lag is compared with lag 0 in the same bins.
    relative = power / smooth[:, None]
    height = weight.T @ relative[:, 0]
    value = (weight * relative[:, 1:]).sum(axis=0) / height
    square = (weight**2).sum(axis=0)
    # Residuals about a weighted mean underestimate the errors, more so for few bins.
    residual = (
        weight
        * (relative[:, 1:] - value * relative[:, :1])
        / height
        / np.sqrt(np.maximum(1.0 - square, 0.1))
    )
    sd = np.sqrt((residual**2).sum(axis=0))
    freedom = max(2.0, float(1.0 / square.max() - 1.0))
    is_detected = bool((value[:3] > -stdtrit(freedom, GAIN.lag_false_alarm) * sd[:3]).any())
    summed_lags = len(value) if is_detected else min(2, len(value))
    last_correlation = (
        abs(float(value[max(0, summed_lags - 3) : summed_lags].mean())) if is_detected else 0.0
    )
    errors = error_correlation(flats[0].time, flats[0].parity, lags)[1:, 1:] * np.outer(sd, sd)
    errors *= weight.T @ weight / np.sqrt(np.outer(square, square))
    lacking, change = (
        lag_sum_correction(flats, flat_weight, lags, value, errors)
        if is_detected
        else (0.0, np.zeros(len(value)))
    )
    summed = 2.0 * (np.arange(len(value)) < summed_lags)
    scatter_sd = float(np.sqrt(np.sum((residual @ (summed + change)) ** 2)))
    factor = float(1.0 + summed @ value + lacking)
    return ImageLag(
        lag=lags[1:],
        correlation=value,
        correlation_sd=sd,
        is_detected=is_detected,
        factor=factor,
        factor_sd=float(np.hypot(scatter_sd, 2.0 * last_correlation)),
        freedom=max(2.0, float(1.0 / square[:summed_lags].max() - 1.0)),
        tested=True,
        open=is_detected and last_correlation > GAIN.open_lag,
    )


def smooth_power(power: Array, radius: Array, modes: Array) -> Array:
    """Return power as a smooth function of radius: a cubic in the logarithm of ring means."""
    ring = np.round(radius * 100).astype(int)
    where = np.unique(ring, return_inverse=True)[1]
    count = np.bincount(where, modes)
    mean = np.bincount(where, modes * power) / count
    centre = np.bincount(where, modes * radius) / count
    positive = mean > 0
    if positive.sum() < 4:
        return np.full_like(power, max(float(np.average(power, weights=modes)), 1e-12))
    fit = np.polynomial.Polynomial.fit(
        centre[positive], np.log(mean[positive]), 3, w=np.sqrt(count[positive])
    )
    return np.exp(fit(radius))
