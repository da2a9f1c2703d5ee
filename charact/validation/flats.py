"""Noise of evenly lit frames as a few numbers: variance and covariance over signal, and the correlation of neighbours.

Every number is a ratio of sums over tiles of the picture; leaving one tile out at a time gives its sampling error with
the correlation of the pixels inside a tile allowed for.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.validation.predictive import Features

Array = NDArray[np.float64]

TILES = 4
REACH = 6
# Lags (row, col) whose correlation is compared.
LAGS = ((0, 1), (0, 2), (0, 3), (1, 0), (2, 0), (3, 0), (4, 0))
LAG_NAMES = ("h1", "h2", "h3", "v1", "v2", "v3", "v4")


@dataclass(frozen=True, kw_only=True)
class TileStatistics:
    """Sums over tiles of a stack's frame-to-frame changes.

    Parameters
    ----------
    mean
        Mean level of each tile, shape (tile,), DN.
    autocovariance
        Autocovariance of the changes in each tile, DN^2, lag zero in the middle; shape (tile, lag, lag).
    """

    mean: Array
    autocovariance: Array

    def without(self, tile: int) -> "TileStatistics":
        """Return all tiles but one."""
        return TileStatistics(
            mean=np.delete(self.mean, tile), autocovariance=np.delete(self.autocovariance, tile, axis=0)
        )

    @property
    def variance(self) -> float:
        """Temporal variance, DN^2."""
        return float(self.autocovariance[:, REACH, REACH].mean())

    @property
    def covariance_sum(self) -> float:
        """Covariance summed over the lags within reach, DN^2."""
        return float(self.autocovariance.sum(axis=(1, 2)).mean())

    def correlation(self, lag: tuple[int, int]) -> float:
        """Correlation of pixels a lag (row, col) apart, dimensionless."""
        return float(self.autocovariance[:, REACH + lag[0], REACH + lag[1]].mean()) / self.variance


def tiles_of(frames: NDArray) -> TileStatistics:
    """Return the sums over TILES x TILES tiles of frames (frame, row, col); at least two frames."""
    change = frames.astype(np.float32)
    change -= change.mean(axis=0)
    count, rows, cols = change.shape
    height, width = rows // TILES, cols // TILES
    corners = [(height * r, width * c) for r in range(TILES) for c in range(TILES)]
    cut = [np.s_[:, row : row + height, col : col + width] for row, col in corners]
    scale = count / (count - 1.0)
    return TileStatistics(
        mean=np.array([float(frames[place].mean()) for place in cut]),
        autocovariance=np.array([scale * _autocovariance(change[place]) for place in cut]),
    )


def noise_features(lit: list[TileStatistics], dark: TileStatistics) -> Features:
    """Return ln(variance/signal) and ln(covariance sum/signal) of every flat."""

    def numbers(lit: list[TileStatistics], dark: TileStatistics) -> list[float]:
        signal = [float(one.mean.mean() - dark.mean.mean()) for one in lit]
        pairs = zip(lit, signal, strict=True)
        return [np.log(max(part, 1e-9) / s) for one, s in pairs for part in _above(one, dark)]

    out = [numbers([one.without(tile) for one in lit], dark.without(tile)) for tile in range(TILES**2)]
    return _jackknife(np.array(numbers(lit, dark)), np.array(out))


def correlation_features(flat: TileStatistics) -> Features:
    """Return the correlations of a flat at LAGS."""
    out = [[flat.without(tile).correlation(lag) for lag in LAGS] for tile in range(TILES**2)]
    return _jackknife(np.array([flat.correlation(lag) for lag in LAGS]), np.array(out))


def _above(lit: TileStatistics, dark: TileStatistics) -> tuple[float, float]:
    return lit.variance - dark.variance, lit.covariance_sum - dark.covariance_sum


def _jackknife(value: Array, left_out: Array) -> Features:
    """Return features with the covariance of leaving one of n parts out: (n - 1)/n sum (t_i - mean)(t_i - mean)^T."""
    count = len(left_out)
    away = left_out - left_out.mean(axis=0)
    return Features(value=value, covariance=(count - 1.0) / count * away.T @ away, freedom=count - 1)


def _autocovariance(change: NDArray[np.float32]) -> Array:
    """Return the autocovariance of changes (frame, row, col) within reach, averaged over frames and pairs of pixels."""
    from scipy.fft import irfft2, next_fast_len, rfft2

    count, rows, cols = change.shape
    shape = (next_fast_len(rows + REACH), next_fast_len(cols + REACH))
    spectrum = np.asarray(rfft2(change, s=shape))
    full = np.asarray(irfft2((np.abs(spectrum) ** 2).sum(axis=0), s=shape))
    lags = np.arange(-REACH, REACH + 1)
    pairs = np.outer(rows - np.abs(lags), cols - np.abs(lags)) * count
    return full[np.ix_(lags, lags)] / pairs
