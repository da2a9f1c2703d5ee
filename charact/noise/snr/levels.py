"""Signal and temporal noise of one exposure at every level of one gain: of a pixel, and of an area mean."""

import numpy as np
from numpy.typing import NDArray

from charact.noise.gain.pooled_noise import ImageLag
from charact.noise.gain.series import CLIPPED_SHARE, FlatSeries
from charact.noise.snr.area import area_variance, shares_of
from charact.noise.snr.noise_law import SignalNoiseSeries
from charact.noise.snr.rounding import rounding_sd
from charact.noise.snr.stated_illumination import signal_sd
from charact.noise.stack.stack_statistics import BlockSpectrum, StackStatistics, rows_lags
from charact.noise.stack.temporal import n_effective_samples

Array = NDArray[np.float64]

# Images too small for a spectrum, in which image lag is measured.
NO_LAG = ImageLag(
    lag=np.empty(0, np.int64),
    correlation=np.empty(0),
    correlation_sd=np.empty(0),
    seen=False,
    factor=1.0,
    factor_sd=0.0,
    freedom=np.inf,
    tested=False,
    open=False,
)


def pixel_levels(series: FlatSeries, lag: ImageLag) -> SignalNoiseSeries:
    """Return the levels of a pixel, corrected for the correlation of few frames by image lag."""
    pattern, pattern_sd = pattern_of(series)
    return _levels(series, [_pixel(level, lag) for level in _stacks(series)], pattern=pattern, pattern_sd=pattern_sd)


def area_levels(series: FlatSeries, lag: ImageLag) -> SignalNoiseSeries:
    """Return the levels of the mean of a square of pixels, see `charact.noise.snr.area`."""
    shares = shares_of(series.flats[0].bins)

    def of(level: StackStatistics) -> tuple[float, float]:
        spectrum, count = _spectrum(level, lag)
        return area_variance(level, spectrum, shares, count)

    return _levels(series, [of(level) for level in _stacks(series)])


def unclipped_flats(series: FlatSeries) -> NDArray[np.bool_]:
    """Return which flats have unclipped noise: neither at full scale nor beyond the variance peak."""
    whole = np.array([flat.high_fraction <= CLIPPED_SHARE for flat in series.flats])
    return whole & (np.arange(len(whole)) <= (len(whole) if series.peak is None else series.peak))


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
    weight = 1.0 / sd[known] ** 2
    mean = float(weight @ value[known] / weight.sum())
    excess = float(weight @ (value[known] - mean) ** 2) / max(1, known.sum() - 1)
    return mean, float(np.sqrt(max(1.0, excess) / weight.sum()))


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
        signal_sd_dn=np.array([signal_sd(f, d) for f, d in zip(series.flats, series.darks, strict=True)]),
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
    if not lag.seen:
        return level.variance_dn2, float(np.hypot(level.variance_sd_dn2, steps))
    correlation = lag.correlation
    same = rows_lags(level.many.lags, level.parity)
    known, plain = (
        n_effective_samples(level.time, level.parity, lags, correlation, within_parity=True)
        for lags in (same, same[:1])
    )
    stretch = np.sqrt(max(1.0, plain / known))
    return level.many.variance_dn2, float(np.hypot(level.variance_sd_dn2 * stretch, steps))


def _spectrum(level: StackStatistics, lag: ImageLag) -> tuple[BlockSpectrum, float]:
    """Return the spectrum with enough lags, and its independent exposures."""
    spectrum = level.many if lag.seen else level.few
    correlation = lag.correlation if lag.seen else np.empty(0)
    return spectrum, level.runs * n_effective_samples(level.time, level.parity, spectrum.lags, correlation)
