"""Noise of a bar target's pixels: variance against level, correlation, row noise."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.bars.thresholds import ACCURACY, LIMITS
from charact.frames.rounding import rounding_shifts

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class BarWindowNoise:
    """Noise of the pixels of a window."""

    variance: Array  # Of each pixel, shape (pixel,)
    # Correlation of two pixels by their separation, shape (2 k + 1, 2 k + 1), 1 in the centre
    correlation: Array
    inflation: float = 1.0  # Factor on all variances by image lag
    # Possible shifts of the pixels by quantisation, shape (offset, pixel), DN; the offsets are
    # equally likely
    rounding: Array | None = None
    row_variance: float = 0.0  # Variance of an offset common to the pixels of a row, DN^2

    @property
    def correlation_sum(self) -> float:
        """Ratio of the chi squared of correlated pixels to that of independent ones."""
        return max(float(np.abs(self.correlation).sum()), 1.0)

    def spread(self, estimator: Array, window: Mask) -> Array:
        """Return the covariance of linear estimates by the noise, shape (estimate, estimate).

        `estimator`: weight of each pixel in each estimate, shape (estimate, pixel); `window`:
        pixels, shape (row, col).
        """
        return estimator @ self.covariance_with(estimator, window).T

    def covariance_with(self, estimator: Array, window: Mask) -> Array:
        """Return the covariance of each pixel's noise with linear estimates, shape (estimate,
        pixel).
        """
        from scipy.fft import irfft2, next_fast_len, rfft2

        max_lag = self.correlation.shape[0] // 2
        rows, cols = np.nonzero(window)
        rows, cols = rows - rows.min(), cols - cols.min()
        size = tuple(
            int(next_fast_len(int(side.max()) + 1 + max_lag, True) or 0) for side in (rows, cols)
        )
        scale = np.sqrt(self.variance)
        fields = np.zeros((len(estimator), *size))
        fields[:, rows, cols] = estimator * scale
        kernel = np.zeros(size)
        lags = np.arange(-max_lag, max_lag + 1)
        kernel[np.ix_(lags % size[0], lags % size[1])] = self.correlation
        # Estimated correlations may have negative power at some frequencies, which no noise has.
        power = np.maximum(np.real(np.asarray(rfft2(kernel))), 0.0)
        spectrum = np.asarray(rfft2(fields)) * power
        shared = self.inflation * scale * np.asarray(irfft2(spectrum, size))[:, rows, cols]
        if self.row_variance:
            of_row = np.stack([np.bincount(rows, weights) for weights in estimator])
            shared = shared + self.row_variance * of_row[:, rows]
        if self.rounding is None or not len(self.rounding):
            return shared
        return shared + (estimator @ self.rounding.T) @ self.rounding / len(self.rounding)


def noise_of(
    frames: Array, model: Array, window: Mask, *, ground_dn: float, inflation: float
) -> BarWindowNoise:
    """Return the noise of the mean of frames, from their scatter.

    `frames`: at least two, shape (frame, row, col); integers are taken as quantised; `model`: image
    of the window's pixels, shape (pixel,); `ground_dn`: background level; `inflation`: variance
    factor of the mean by image lag.
    """
    residuals = frames - frames.mean(axis=0)
    fraction = len(frames) / (len(frames) - 1.0)
    variance = variance_of(model, fraction * np.mean(residuals[:, window] ** 2, axis=0))
    field = np.zeros((min(len(frames), 6), *window.shape))
    field[:, window] = residuals[: len(field), window] / np.sqrt(variance)
    return BarWindowNoise(
        variance=variance / len(frames),
        correlation=correlation_of(field, window),
        inflation=inflation,
        rounding=rounding_shifts(model, variance) if frames.dtype.kind in "ui" else None,
        row_variance=fraction
        * row_offset_variance(residuals, np.abs(model - ground_dn), window)
        / len(frames),
    )


def noise_of_one(
    residual: Array, model: Array, absorbed: Array, window: Mask, *, ground_dn: float
) -> BarWindowNoise:
    """Return the noise of one frame from the residuals of a fit.

    `residual`, `model`: pixels less the image, and the image, shape (pixel,); `absorbed`:
    uncertainty of the fit as independent fields, shape (field, pixel): noise that the fit absorbed.
    """
    variance = variance_of(model, residual**2 + np.sum(absorbed**2, axis=0))
    scale = 1.0 / np.sqrt(variance)
    fields = np.zeros((1 + len(absorbed), *window.shape))
    fields[0, window] = residual * scale
    fields[1:, window] = absorbed * scale
    residuals = np.zeros((1, *window.shape))
    residuals[0, window] = residual
    shared = row_offset_variance(residuals, np.abs(model - ground_dn), window)
    return BarWindowNoise(
        variance=variance, correlation=correlation_of(fields, window), row_variance=shared
    )


def row_offset_variance(residuals: Array, height: Array, window: Mask) -> float:
    """Return the variance of an offset common to the pixels of a row, DN^2; 0 where it is not
    significant.

    `residuals`: residuals of frames, shape (frame, row, col), DN; `height`: image above the
    background, shape (pixel,), DN; only background pixels are used; `window`: pixels, shape (row,
    col).

    Notes
    -----
    Distant pixels of a row have only the row offset in common. The mean of each frame's background
    is subtracted.
    """
    background = np.zeros(window.shape, bool)
    background[window] = height <= LIMITS.max_background_height * height.max()
    if np.count_nonzero(background) < ACCURACY.min_background_pixels:
        return 0.0
    residuals = np.where(
        background, residuals - residuals[:, background].mean(axis=1)[:, None, None], 0.0
    )
    products = []
    for lag in (8, 12, 16):
        last = window.shape[1] - lag
        pairs = background[:, :last] & background[:, lag:]
        products.append(np.mean(residuals[:, :, :last] * residuals[:, :, lag:], axis=0)[pairs])
    covariances = np.concatenate(products)
    if covariances.size < ACCURACY.min_background_pixels:
        return 0.0
    mean = float(covariances.mean())
    return (
        mean
        if mean > LIMITS.min_row_noise_sd * float(covariances.std()) / np.sqrt(covariances.size)
        else 0.0
    )


def variance_of(level: Array, square: Array) -> Array:
    """Return the variance of each pixel: a non-decreasing line in its level, at least a tenth of
    the mean.
    """
    mean = float(square.mean())
    spread = float(level.std())
    if not spread > 0 or not mean > 0:
        return np.full(level.shape, max(mean, 1e-12))
    slope, offset = np.polyfit((level - level.mean()) / spread, square, 1)
    line = offset + max(slope, 0.0) * (level - level.mean()) / spread
    return np.maximum(line, 0.1 * mean)


def correlation_of(fields: Array, window: Mask) -> Array:
    """Return the correlation of noise fields (field, row, col) between pixels of a window."""
    short_range = _correlation(fields, window, ACCURACY.correlation_px)
    centre = ACCURACY.correlation_px
    if (
        max(short_range[centre + 1, centre], short_range[centre, centre + 1])
        < LIMITS.long_correlation
    ):
        return short_range
    return _correlation(fields, window, 4)


def _correlation(fields: Array, window: Mask, max_lag: int) -> Array:
    masked = np.where(window, fields, 0.0)
    rows, cols = window.shape
    correlation = np.zeros((2 * max_lag + 1, 2 * max_lag + 1))
    for down in range(min(max_lag + 1, rows)):
        for right in range(-min(max_lag, cols - 1), min(max_lag + 1, cols)):
            origin = (slice(0, rows - down), slice(max(0, -right), cols - max(0, right)))
            shifted = (slice(down, rows), slice(max(0, right), cols + min(0, right)))
            pairs = np.count_nonzero(window[origin] & window[shifted])
            if pairs:
                shared = (
                    float(np.sum(masked[(slice(None), *origin)] * masked[(slice(None), *shifted)]))
                    / pairs
                )
                correlation[max_lag + down, max_lag + right] = correlation[
                    max_lag - down, max_lag - right
                ] = shared
    return correlation / max(correlation[max_lag, max_lag], 1e-30)
