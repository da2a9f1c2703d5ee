"""Temporal noise of a pixel against its signal, and with its neighbours: one law for every method.

    sigma^2(mu) = r^2 + g mu + (b + p) mu^2
    cov(i, j) = sigma(mu_i) sigma(mu_j) rho(l),  l the lag (row, col) of pixels i and j

mu: signal above dark; r: noise without light, rounding included; g: covariance gain, K of EMVA 1288
without a tube and K + k F^2 behind one; b: nonlinearity, as of a microchannel plate that saturates;
p: squared PRNU, of frames without flat-field correction; rho: correlation of pixels, 1 at lag 0.
White noise that is blurred after the gain keeps g as its power at low frequency: the variance of a
sum of many pixels exceeds that of as many independent ones by the sum of rho, the correlation
factor.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from charact.frames.thresholds import NOISE
from labdata.errors import check

Array = NDArray[np.float64]
Lags = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class NoiseLaw:
    """Noise law of a camera at one setting; numbers, or draws of shape (draw, 1).

    Parameters
    ----------
    gain_dn, read_dn
        g and r, in the unit of the signal; g is 0 of a thermal imager, whose r is its NETD, and
        negative where noise falls with the signal, as behind a compressive response.
    bend, pattern
        b, per unit of the signal squared, and p, dimensionless.
    blur_px, read_blur_px
        Standard deviation of the Gaussian blur after the gain, and of that of the noise without
        light by a warp, px.
    correlation_factor
        Variance of a sum of many pixels over that of as many independent ones, dimensionless.
    correlation
        rho at lags of rows and columns, shape (2 R + 1, 2 C + 1); 0 beyond.
    is_known
        Whether the law was measured or described, not estimated from the frame that it is used for.
    """

    gain_dn: float | Array
    read_dn: float | Array
    bend: float | Array = 0.0
    pattern: float | Array = 0.0
    blur_px: float = 0.0
    read_blur_px: float = 0.0
    correlation_factor: float = 1.0
    correlation: Array = field(default_factory=lambda: np.ones((1, 1)), compare=False)
    is_known: bool = True

    def __post_init__(self) -> None:
        names = ("read_dn", "blur_px", "read_blur_px")
        numbers = [name for name in names if np.ndim(getattr(self, name)) == 0]
        check(self, not_negative=numbers, of=" of a noise law")

    def variance(self, signal: Array | float, *, pattern: bool = False) -> Array:
        """Return sigma^2 of signals, with or without PRNU; that of none where they are negative."""
        mu = np.maximum(signal, 0.0)
        square = self.bend + self.pattern * pattern
        return np.maximum(self.read_dn**2 + self.gain_dn * mu + square * mu**2, 1e-300)

    def sd(self, signal: Array | float, *, pattern: bool = False) -> Array:
        """Return sigma of signals."""
        return np.sqrt(self.variance(signal, pattern=pattern))

    def correlated(self, correlation: Array) -> "NoiseLaw":
        """Return the law with a correlation, whose sum chance may make negative."""
        factor = float(max(correlation.sum(), 0.05))
        return replace(self, correlation=correlation, correlation_factor=factor)

    def covariance(self, rows: Lags, cols: Lags, signal: Array | float = 0.0) -> Array:
        """Return the covariance of pixels, shape (pixel,) each, at signals; (pixel, pixel)."""
        lags = [np.subtract.outer(at, at) for at in (rows, cols)]
        limits = [size // 2 for size in self.correlation.shape]
        down, right = (np.clip(lag, -r, r) + r for lag, r in zip(lags, limits, strict=True))
        in_range = (np.abs(lags[0]) <= limits[0]) & (np.abs(lags[1]) <= limits[1])
        sd = np.broadcast_to(self.sd(signal), rows.shape)
        return np.outer(sd, sd) * np.where(in_range, self.correlation[down, right], 0.0)

    def sum_variance(self, total: float) -> float:
        """Return the variance of the sum of many pixels by the light in them, DN^2."""
        return float(self.correlation_factor * self.gain_dn * max(total, 0.0))

    def signal_at(self, snr: float) -> Array:
        """Return the signal at which mu / sigma(mu), PRNU included, is an SNR; inf if none is."""
        square = 1.0 - snr**2 * np.asarray(self.pattern + self.bend)
        shot = snr**2 * np.asarray(self.gain_dn)
        root = np.sqrt(shot**2 + 4.0 * np.maximum(square, 0.0) * (snr * self.read_dn) ** 2)
        return np.where(square > 0, (shot + root) / np.maximum(2.0 * square, 1e-12), np.inf)

    def scaled(self, ratio: float) -> "NoiseLaw":
        """Return the law with a ratio of the power of read and shot noise."""
        return replace(self, gain_dn=self.gain_dn * ratio, read_dn=self.read_dn * ratio**0.5)


def fit_noise_law(signal: Array, square: Array, top: float, floor: float) -> NoiseLaw:
    """Return the law r^2 + g mu, fitted to squared residuals by least squares.

    Parameters
    ----------
    signal, square
        mu and the squared residual of every pixel, shape (pixel,); single ones count as
        `NOISE.outlier` times their mean at most.
    top
        Signal up to which the law is used.
    floor
        Least variance, at no signal and at the top, besides `NOISE.least_fraction` of the mean.
    """
    if not signal.size:
        return NoiseLaw(gain_dn=0.0, read_dn=floor**0.5)
    square = np.minimum(square, NOISE.outlier * float(square.mean()) + floor)
    variance, mean = float(square.mean()), float(signal.mean())
    offset = signal - mean
    slope = float(offset @ square) / max(float(offset @ offset), 1e-300)
    floor = max(NOISE.least_fraction * variance, floor)
    at_none, at_top = (max(variance + slope * (mu - mean), floor) for mu in (0.0, top))
    return NoiseLaw(gain_dn=(at_top - at_none) / top if top > 0 else 0.0, read_dn=at_none**0.5)


def masked_covariance(
    fields: NDArray[np.floating], valid: NDArray[np.bool_], max_lag: int
) -> tuple[Array, Array]:
    """Return mean products of pixels a lag apart, and the number of their pairs in one field.

    Parameters
    ----------
    fields
        Deviations of pixels, shape (field, row, col); those that do not count are 0.
    valid
        Pixels that count, shape (row, col).
    max_lag
        Largest lag of rows and of columns; the results have shape (2 max_lag + 1, 2 max_lag + 1).
    """
    lag = np.arange(-max_lag, max_lag + 1)
    if not valid.any():
        return np.zeros((lag.size, lag.size)), np.zeros((lag.size, lag.size))
    rows, cols = (np.flatnonzero(valid.any(axis=axis)) for axis in (1, 0))
    part = np.s_[..., rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    fields, valid = fields[part], valid[part]
    size = [-(-(length + max_lag) // 16) * 16 for length in valid.shape]
    spectra = np.fft.rfft2(np.concatenate([valid[None].astype(fields.dtype), fields]), size)
    power = np.real(spectra) ** 2 + np.imag(spectra) ** 2
    lagged = np.fft.irfft2(np.stack([power[0], power[1:].sum(axis=0)]), size).astype(np.float64)
    pairs, products = lagged[:, lag[:, None], lag]
    pairs = np.rint(pairs)
    return np.where(pairs > 0, products / np.maximum(pairs * len(fields), 1), 0.0), pairs
