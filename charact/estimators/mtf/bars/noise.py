"""Covariance of a window's pixels by noise: law of one pixel, correlation, row noise, rounding."""

from dataclasses import dataclass

import numpy as np

from charact.estimators.mtf.bars.thresholds import ACCURACY, LIMITS
from charact.frames.noise_law import fit_noise_law, masked_covariance
from charact.frames.rounding import rounding_shifts
from labdata import Array, Mask


@dataclass(frozen=True, kw_only=True)
class WindowCovariance:
    """Covariance of a window's pixels (i, j) in the mean of its frames.

    f sigma_i sigma_j rho(l) + w [i and j in one row] + mean over offsets of d_i d_j
    """

    variance: Array  # Of each pixel, shape (pixel,)
    # Correlation of two pixels by their separation, shape (2 k + 1, 2 k + 1), 1 in the centre
    correlation: Array
    inflation: float = 1.0  # f, by image lag
    # d: possible shifts of the pixels by quantisation, shape (offset, pixel), DN; the offsets are
    # equally likely
    rounding: Array | None = None
    row_variance: float = 0.0  # w: variance of an offset common to the pixels of a row, DN^2

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
) -> WindowCovariance:
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
    return WindowCovariance(
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
) -> WindowCovariance:
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
    return WindowCovariance(
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
    """Return the variance of each pixel by its level, from squared deviations."""
    signal = level - level.min()
    return fit_noise_law(signal, square, float(signal.max()), 1e-12).variance(signal)


def correlation_of(fields: Array, window: Mask) -> Array:
    """Return the correlation of noise fields (field, row, col) between pixels of a window."""
    covariance, _ = masked_covariance(fields, window, ACCURACY.long_correlation_px)
    centre = ACCURACY.long_correlation_px
    correlation = covariance / max(covariance[centre, centre], 1e-30)
    neighbours = correlation[centre + 1, centre], correlation[centre, centre + 1]
    if max(neighbours) >= LIMITS.long_correlation:
        return correlation
    margin = centre - ACCURACY.correlation_px
    return correlation[margin:-margin, margin:-margin]
