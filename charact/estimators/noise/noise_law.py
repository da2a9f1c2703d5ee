"""Noise law of one gain setting: variance against signal.

One exposure less the mean dark obeys `charact.frames.noise_law`. For a pixel g is (K + k F^2) times
the blur factor, for an area (K + k F^2) over its number of pixels.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.gain.pooled_noise import ImageLag
from charact.estimators.noise.gain.series import CLIPPED_SHARE, FlatSeries
from charact.estimators.noise.illumination import signal_sd
from charact.estimators.noise.linear_fit import linear_fit
from charact.estimators.noise.thresholds import SNR
from charact.frames.noise_law import NoiseLaw
from charact.frames.rounding import rounding_sd
from charact.frames.stack_statistics import (
    StackStatistics,
    area_variance,
    shares_of,
)
from charact.frames.temporal import n_effective_samples, same_row_lags
from labdata.measurement import Posterior

Array = NDArray[np.float64]
NAMES = ("read_variance", "shot_gain", "bend", "pattern_variance")
UNITS = ("DN2", "DN", "1", "1")


@dataclass(frozen=True, kw_only=True)
class SignalNoiseSeries:
    """Signal and temporal noise of one exposure at every level of one gain, of a pixel or an area
    mean.
    """

    # signal_dn, signal_sd_dn: signal above the dark and its standard error, shape (flat,), DN
    signal_dn: Array
    signal_sd_dn: Array
    # variance_dn2, variance_sd_dn2: variance and its standard error, shape (flat,), DN^2
    variance_dn2: Array
    variance_sd_dn2: Array
    dark: NDArray[np.int64]  # index of the dark of each flat, shape (flat,)
    # dark_variance_dn2, dark_variance_sd_dn2: variance of every dark and its standard error, shape
    # (dark,), DN^2
    dark_variance_dn2: Array
    dark_variance_sd_dn2: Array
    fitted: NDArray[np.bool_]  # whether each level is in the linear range, shape (flat,)
    # pattern, pattern_sd: squared PRNU and its standard error, dimensionless; 0 and 0 for none
    pattern: float = 0.0
    pattern_sd: float = 0.0

    @property
    def is_illuminated(self) -> NDArray[np.bool_]:
        """Whether each level is significantly brighter than its dark, shape (flat,)."""
        return self.signal_dn > SNR.lit_sd * self.signal_sd_dn

    @property
    def snr(self) -> Array:
        """SNR (temporal noise) of each level, shape (flat,)."""
        return self.signal_dn / self._noise_dn

    @property
    def snr_sd(self) -> Array:
        """Standard error of the SNR, shape (flat,)."""
        relative = 0.5 * self.variance_sd_dn2 / self._noise_dn**2
        return np.hypot(self.signal_sd_dn / self._noise_dn, self.snr * relative)

    @property
    def _noise_dn(self) -> Array:
        return np.sqrt(np.maximum(self.variance_dn2, 1e-12))


@dataclass(frozen=True, kw_only=True)
class FittedNoiseLaw:
    """Noise law fitted to levels."""

    posterior: Posterior  # draws of `NAMES`
    misfit: str | None  # note on deviations from the law, or None

    @property
    def law(self) -> NoiseLaw:
        """The law of every draw, shape (draw, 1)."""
        read, shot, bend, pattern = (self.posterior[name][:, None] for name in NAMES)
        return NoiseLaw(read_dn=np.sqrt(read), gain_dn=shot, bend=bend, pattern=pattern)


def fit_noise_law(
    levels: SignalNoiseSeries, rng: np.random.Generator, *, reference: int
) -> FittedNoiseLaw:
    """Fit the noise law to the levels of the linear range.

    `levels`: the levels; at least one is fitted; `reference`: index of the dark that gives the read
    noise.

    The law is linear in its parameters, so the posterior is normal, truncated at zero read and shot
    noise. If the levels scatter by more than their errors, the errors are scaled to the scatter
    (Birge, Phys. Rev. 40, 207 (1932)).
    """
    design, data, sd = _equations(levels)
    best, covariance, chi2 = linear_fit(list(design.T), data, sd)
    residual = data - design @ best
    freedom = int(levels.fitted.sum()) - 1
    stretch = max(1.0, chi2 / freedom) if freedom else 1.0
    drawn = _positive(rng, best, covariance * stretch, (reference, len(best) - 2))
    pattern = _above_zero(rng, levels.pattern, levels.pattern_sd)
    brightest = float(levels.signal_dn[levels.fitted].max())
    draws = np.stack(
        [drawn[:, reference], drawn[:, -2], drawn[:, -1] / brightest**2, pattern], axis=1
    )
    posterior = Posterior(names=NAMES, units=UNITS, draws=draws, sampler="laplace")
    return FittedNoiseLaw(posterior=posterior, misfit=_misfit(residual, levels, chi2, freedom))


def _equations(levels: SignalNoiseSeries) -> tuple[Array, Array, Array]:
    """Return design, data and errors: darks, fitted flats, and the prior of the nonlinearity at the
    brightest flat.
    """
    chosen = np.flatnonzero(levels.fitted)
    darks, signal = len(levels.dark_variance_dn2), levels.signal_dn[chosen]
    dark_columns = np.eye(darks)[levels.dark[chosen]]
    bend = (signal / signal.max()) ** 2
    shot = levels.variance_dn2[chosen] - levels.dark_variance_dn2[levels.dark[chosen]]
    brightest = max(
        float(shot[signal.argmax()]), float(levels.variance_sd_dn2[chosen][signal.argmax()])
    )
    design = np.vstack(
        [
            np.hstack([np.eye(darks), np.zeros((darks, 2))]),
            np.column_stack([dark_columns, signal, bend]),
            np.eye(darks + 2)[-1:],
        ]
    )
    data = np.concatenate([levels.dark_variance_dn2, levels.variance_dn2[chosen], [0.0]])
    sd = [
        levels.dark_variance_sd_dn2,
        levels.variance_sd_dn2[chosen],
        [SNR.nonlinearity_sd * brightest],
    ]
    return design, data, np.maximum(np.concatenate(sd), 1e-12)


def _misfit(residual: Array, levels: SignalNoiseSeries, chi2: float, freedom: int) -> str | None:
    """Return the note on a significant deviation of the levels from the law, or None."""
    from scipy.special import chdtrc

    flats = residual[len(levels.dark_variance_dn2) : -1] / levels.variance_dn2[levels.fitted]
    if (
        freedom < 1
        or chdtrc(freedom, chi2) > SNR.min_p_value
        or np.abs(flats).max() < SNR.misfit_fraction
    ):
        return None
    return (
        f"the noise deviates from read and shot noise by up to {100 * np.abs(flats).max():.2g} "
        f"% of its variance"
    )


def _positive(
    rng: np.random.Generator, mean: Array, covariance: Array, which: tuple[int, int]
) -> Array:
    """Return normal draws with some parameters not negative."""
    drawn = rng.multivariate_normal(mean, covariance, 4 * SNR.draws, method="eigh")
    positive = drawn[(drawn[:, which] >= 0).all(axis=1)]
    if len(positive) >= SNR.draws:
        return positive[: SNR.draws]
    drawn[:, which] = np.abs(drawn[:, which])
    return drawn[: SNR.draws]


def _above_zero(rng: np.random.Generator, mean: float, sd: float) -> Array:
    """Return draws of a normal distribution truncated at zero."""
    from scipy.special import ndtr, ndtri

    if sd <= 0:
        return np.full(SNR.draws, max(mean, 0.0))
    low = ndtr(-mean / sd)
    return np.maximum(
        mean + sd * ndtri(low + (1.0 - low) * rng.uniform(1e-9, 1.0 - 1e-9, SNR.draws)), 0.0
    )


def pixel_levels(series: FlatSeries, lag: ImageLag) -> SignalNoiseSeries:
    """Return the levels of a pixel, corrected for the correlation of few frames by image lag."""
    pattern, pattern_sd = pattern_of(series)
    return _levels(
        series,
        [_pixel(level, lag) for level in _stacks(series)],
        pattern=pattern,
        pattern_sd=pattern_sd,
    )


def area_levels(series: FlatSeries, lag: ImageLag) -> SignalNoiseSeries:
    """Return the levels of the mean of a square of pixels, see
    `charact.frames.stack_statistics`.
    """
    shares = shares_of(series.flats[0].bins)

    def of(level: StackStatistics) -> tuple[float, float]:
        spectrum = level.many_lags if lag.is_detected else level.few_lags
        correlation = lag.correlation if lag.is_detected else np.empty(0)
        count = level.runs * n_effective_samples(
            level.time, level.parity, spectrum.lags, correlation
        )
        return area_variance(level, spectrum, shares, count)

    return _levels(series, [of(level) for level in _stacks(series)])


def flats_without_clipping(series: FlatSeries) -> NDArray[np.bool_]:
    """Return which flats have unclipped noise: neither at full scale nor beyond the variance
    peak.
    """
    is_unclipped = np.array([flat.high_fraction <= CLIPPED_SHARE for flat in series.flats])
    return is_unclipped & (
        np.arange(len(is_unclipped)) <= (len(is_unclipped) if series.peak is None else series.peak)
    )


def pattern_of(series: FlatSeries) -> tuple[float, float]:
    """Return the squared PRNU and its standard error, from all fitted flats."""
    chosen = np.flatnonzero(series.fitted)
    pairs = [(series.flats[i], series.darks[i]) for i in chosen]
    square = series.signal_dn[chosen] ** 2
    value = np.array([f.spatial_variance_dn2 - d.spatial_variance_dn2 for f, d in pairs]) / square
    sd = np.array([np.hypot(f.spatial_sd_dn2, d.spatial_sd_dn2) for f, d in pairs]) / square
    known = np.isfinite(sd) & (sd > 0)
    if not known.any():
        return 0.0, 0.0
    fit = linear_fit([np.ones(known.sum())], value[known], sd[known])
    return float(fit.best[0]), float(np.sqrt(fit.covariance[0, 0])) * fit.stretch(known.sum())


def _stacks(series: FlatSeries) -> list[StackStatistics]:
    """Return the darks of the flats without repetition, then the flats."""
    return [*{dark.label: dark for dark in series.darks}.values(), *series.flats]


def _levels(series: FlatSeries, known: list[tuple[float, float]], **fields) -> SignalNoiseSeries:
    """Combine the variances of darks and flats with the signals."""
    labels = list(dict.fromkeys(dark.label for dark in series.darks))
    variance, sd = np.array(known, float).T
    darks = len(labels)
    return SignalNoiseSeries(
        signal_dn=series.signal_dn,
        signal_sd_dn=np.array(
            [signal_sd(f, d) for f, d in zip(series.flats, series.darks, strict=True)]
        ),
        variance_dn2=variance[darks:],
        variance_sd_dn2=sd[darks:],
        dark=np.array([labels.index(dark.label) for dark in series.darks]),
        dark_variance_dn2=variance[:darks],
        dark_variance_sd_dn2=sd[:darks],
        fitted=series.fitted,
        **fields,
    )


def _pixel(level: StackStatistics, lag: ImageLag) -> tuple[float, float]:
    """Return the temporal variance of a pixel and its standard error, DN^2."""
    steps = rounding_sd(level.variance_dn2)[1]
    if not lag.is_detected:
        return level.variance_dn2, float(np.hypot(level.variance_sd_dn2, steps))
    correlation = lag.correlation
    same = same_row_lags(level.many_lags.lags, level.parity)
    known, plain = (
        n_effective_samples(level.time, level.parity, lags, correlation, within_parity=True)
        for lags in (same, same[:1])
    )
    stretch = np.sqrt(max(1.0, plain / known))
    return level.many_lags.variance_dn2, float(np.hypot(level.variance_sd_dn2 * stretch, steps))
