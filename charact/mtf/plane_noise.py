"""The noise of a small target's picture, from the differences between frames, and how it is whitened."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.mtf.grain import correlation_of

Array = NDArray[np.float64]

# Fixed pattern that frames share and whose size a session of flats would tell: relative standard deviation.
FIXED_PATTERN = 0.02
LEAST_FRAMES = 4


@dataclass(frozen=True, kw_only=True)
class PlaneNoise:
    """Noise of a mean frame.

    Parameters
    ----------
    dark_variance
        Variance where there is no light, DN^2.
    variance_per_dn
        How much it grows with the signal, DN.
    pattern
        Relative standard deviation of the fixed pattern.
    correlation
        Correlation of neighbouring pixels at lags, odd shape, 1 in the middle.
    from_frames
        Whether frames told it, or only what a fit left over.
    """

    dark_variance: float
    variance_per_dn: float
    pattern: float
    correlation: Array
    from_frames: bool

    def variance(self, signal: Array) -> Array:
        """Return the variance of pixels of a signal above dark, DN^2."""
        light = np.maximum(signal, 0.0)
        return self.dark_variance + self.variance_per_dn * light + (self.pattern * light) ** 2

    def whitened(self, pictures: Array, variance: Array, used: NDArray[np.bool_]) -> Array:
        """Return pictures (pixel, n) divided by the noise's root: scaled, then its correlation undone.

        Parameters
        ----------
        variance
            Of every pixel, shape (row, col).
        used
            Pixels that count, shape (row, col); others are set to nothing.
        """
        rows, cols = variance.shape
        spectrum = _power(self.correlation, rows, cols)
        scale = (used / np.sqrt(variance)).ravel()[:, None]
        block = (pictures * scale).T.reshape(-1, rows, cols)
        return np.fft.irfft2(np.fft.rfft2(block) / np.sqrt(spectrum), (rows, cols)).reshape(len(block), -1).T


def _power(correlation: Array, rows: int, cols: int) -> Array:
    """Return the power spectrum of a correlation on a picture's own frequencies, kept off zero."""
    tall, wide = correlation.shape
    placed = np.zeros((rows, cols))
    for i in range(tall):
        for j in range(wide):
            placed[(i - tall // 2) % rows, (j - wide // 2) % cols] += correlation[i, j]
    return np.maximum(np.real(np.fft.rfft2(placed)), 0.08)


def noise_of_frames(data: NDArray, floor: float) -> PlaneNoise | None:
    """Estimate the noise of the mean of frames from their differences; None for fewer than four frames.

    Notes
    -----
    The variance is a straight line over the signal, fitted to pixels grouped by their mean. Where light of one frame
    stays in the next, averaging helps less: the variance of the mean carries 1 + 2 rho of neighbouring frames.
    """
    frames = data.shape[0]
    if frames < LEAST_FRAMES:
        return None
    values = data.astype(float)
    mean = values.mean(axis=0)
    left = values - mean
    variance = left.var(axis=0) * frames / (frames - 1)
    dark = float(np.median(mean))
    level = np.maximum(mean - dark, 0.0).ravel()
    weight = 1.0 / (np.median(variance) + level) ** 2
    design = np.stack([np.ones_like(level), level], axis=1)
    normal = (design * weight[:, None]).T @ design + 1e-12 * np.eye(2)
    base, slope = np.linalg.solve(normal, (design * weight[:, None]).T @ variance.ravel())
    base, slope = max(float(base), floor), max(float(slope), 0.0)
    standard = left / np.sqrt(base + slope * np.maximum(mean - dark, 0.0))
    tied = float(np.mean(standard[1:] * standard[:-1])) / float(np.mean(standard**2)) + 1.0 / (frames - 1)
    longer = (1.0 + 2.0 * np.clip(tied, 0.0, 0.6)) / frames
    used = np.ones(mean.shape, bool)
    every = max(1, frames // 8)
    correlation = np.mean(_same([correlation_of(frame, used) for frame in standard[::every]]), axis=0)
    return PlaneNoise(
        dark_variance=max(base * longer, floor / frames),
        variance_per_dn=slope * longer,
        pattern=FIXED_PATTERN,
        correlation=correlation,
        from_frames=True,
    )


def noise_of_residual(residual: Array, signal: Array, used: NDArray[np.bool_], floor: float) -> PlaneNoise:
    """Estimate the noise of one picture from what a fit left over."""
    level = np.maximum(signal[used], 0.0)
    square = residual[used] ** 2
    weight = 1.0 / (np.median(square) + level * np.median(square) / max(float(level.max()), 1e-9)) ** 2
    design = np.stack([np.ones_like(level), level], axis=1)
    normal = (design * weight[:, None]).T @ design + 1e-12 * np.eye(2)
    base, slope = np.linalg.solve(normal, (design * weight[:, None]).T @ square)
    base, slope = max(float(base), floor), max(float(slope), 0.0)
    standard = np.where(used, residual / np.sqrt(base + slope * np.maximum(signal, 0.0)), 0.0)
    return PlaneNoise(
        dark_variance=base,
        variance_per_dn=slope,
        pattern=0.0,
        correlation=correlation_of(standard, used),
        from_frames=False,
    )


def _same(fields: list[Array]) -> list[Array]:
    """Return correlations cut to their common size."""
    rows, cols = (min(field.shape[axis] for field in fields) for axis in (0, 1))
    cut = []
    for field in fields:
        top, left = (field.shape[0] - rows) // 2, (field.shape[1] - cols) // 2
        cut.append(field[top : top + rows, left : left + cols])
    return cut
