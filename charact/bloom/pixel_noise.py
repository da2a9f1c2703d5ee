"""The noise of single pixels against their signal, and what a noisy pixel shows on average where codes end."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.bloom.polar import Polar, Rings

Array = NDArray[np.float64]

# Shares of full scale between which the noise of the light is read, and the fewest pixels that tell it.
LIGHT = (0.1, 0.7)
FEWEST = 8
LEAST_LIGHT_DN = 1.0
# Times by which what is well lit is brighter than what is faint, lest a line through both be no line.
APART = 1.5
# Variance of rounding, DN^2.
ROUNDING = 1.0 / 12.0
# Fall of the rings a px, share of their level and of full scale, beyond which a single frame's noise is not read.
STEEP, STEEP_FAINT = 0.015, 0.004
SMOOTHING_PX = 1.0
# Rows that share no noise.
APART_ROWS = 3


@dataclass(frozen=True, kw_only=True)
class PixelNoise:
    """Variance of a pixel of a single frame, `floor + slope * signal`, DN^2, and the number of frames averaged.

    `tied` is the variance of sums of many pixels over that of as many independent ones.
    """

    floor: float
    slope: float
    frames: int
    tied: float = 1.0

    def sd(self, signal: Array | float) -> Array:
        """Standard deviation of a pixel of a single frame, DN."""
        return np.sqrt(np.maximum(self.floor + self.slope * np.maximum(signal, 0.0), 1e-6))


def mean_with_clipping(mean: Array, noise: PixelNoise, top: float) -> tuple[Array, Array]:
    """Return the mean of a noisy signal cut at `top`, and the share of it that is not cut; shapes of `mean`."""
    from scipy.special import ndtr

    sd = noise.sd(np.minimum(mean, top))
    z = np.clip((top - mean) / sd, -30.0, 30.0)
    below = ndtr(z)
    density = np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
    return np.where(z >= 30.0, mean, mean * below - sd * density + top * (1.0 - below)), below


def noise_of(frames: NDArray, signal: Array, smooth: Array, top: float, polar: Polar, rings: Rings) -> PixelNoise:
    """Read the noise of pixels from what frames differ, or of a single frame from what pixels of a ring differ.

    Parameters
    ----------
    frames, signal, smooth
        The frames, shape (frame, row, col), their mean over dark and that smoothed by a pixel, shape (row, col), DN.
    top
        Highest code over dark, DN.
    polar, rings
        Places of the pixels and sums over cells of the mean.
    """
    profile = rings.median()
    expected = np.interp(polar.radius, rings.radius, profile)
    if len(frames) > 1:
        variance = frames.var(axis=0, ddof=1, dtype=np.float64)
    else:
        # Where rings fall steeply, differences say nothing of noise; along columns they do even in a streak.
        level = (np.abs(np.gradient(profile)) < np.maximum(STEEP * profile, STEEP_FAINT * top))[polar.ring]
        level[:APART_ROWS] = level[-APART_ROWS:] = False
        around = 0.5 * (np.roll(signal, APART_ROWS, axis=0) + np.roll(signal, -APART_ROWS, axis=0))
        variance = np.where(level, (signal - around) ** 2 / 1.5, np.nan)
    faint = (signal <= np.median(signal[::2, ::2]))[::2, ::2]
    spread = [float(np.median(np.abs(one - expected)[::2, ::2][faint])) for one in (smooth, signal)]
    tied = max(1.0, (spread[0] / max(spread[1], 1e-6)) ** 2 * 4.0 * np.pi * SMOOTHING_PX**2)
    # A single frame's pixels are not chosen by their own noise.
    of = signal if len(frames) > 1 else expected
    return _line(variance.ravel(), of.ravel(), top, len(frames), tied)


def _line(variance: Array, signal: Array, top: float, frames: int, tied: float) -> PixelNoise:
    """Variance that grows with the signal, from the faint half of the pixels and from those that are well lit."""
    known = np.isfinite(variance)
    variance, signal = variance[known], signal[known]
    faint = signal <= np.median(signal)
    lit = (signal > LIGHT[0] * top) & (signal < LIGHT[1] * top)
    at_faint, of_faint = float(np.maximum(signal[faint], 0.0).mean()), float(variance[faint].mean())
    if lit.sum() < FEWEST:
        # All of the noise is laid to the light, as intensified cameras have it.
        slope = max(of_faint - ROUNDING, 0.0) / max(at_faint, LEAST_LIGHT_DN)
        return PixelNoise(floor=ROUNDING, slope=slope, frames=frames, tied=tied)
    # Medians: pixels at the end of a streak, or across which a source moves, vary more than by their noise.
    at_lit = float(np.median(signal[lit]))
    of_lit = float(np.median(variance[lit])) / _median_share(max(frames - 1, 1))
    if at_lit < APART * at_faint:
        return PixelNoise(floor=ROUNDING, slope=max(of_lit - ROUNDING, 0.0) / at_lit, frames=frames, tied=tied)
    slope = max(of_lit - of_faint, 0.0) / max(at_lit - at_faint, 1e-6)
    return PixelNoise(floor=max(of_faint - slope * at_faint, ROUNDING), slope=slope, frames=frames, tied=tied)


def _median_share(freedom: int) -> float:
    """Median over mean of chi squared (Wilson and Hilferty, 1931)."""
    return (1.0 - 2.0 / (9.0 * freedom)) ** 3
