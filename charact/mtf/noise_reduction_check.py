"""Noise reduction that follows the picture: it leaves the noise where a target is steep and takes it from plateaus."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Fewest frames that tell noise from the picture, rows of a block that have noise of their own, and fewest blocks.
MIN_FRAMES, BLOCK_ROWS, MIN_BLOCKS = 4, 4, 6
# Share of the steepest slope from which pixels are on a slope, and fewest of them in a row.
STEEP, MIN_STEEP_PIXELS = 0.2, 3
# By how much noise on slopes may exceed that of plateaus, and by how many standard errors besides.
EXCESS = (1.25, 5.0)


@dataclass(frozen=True, kw_only=True)
class SlopeNoise:
    """Variance from frame to frame where a target is steep, over what its plateaus have at the same level.

    Parameters
    ----------
    ratio, sd
        Dimensionless, and its standard error.
    """

    ratio: float = 1.0
    sd: float = np.inf

    @property
    def is_smoothed(self) -> bool:
        """Whether plateaus are quieter than noise of light and of read-out leaves them."""
        return self.ratio > EXCESS[0] + EXCESS[1] * self.sd


def noise_on_slopes(frames: Array, level: Array, steep: Array, sides: NDArray[np.int64]) -> SlopeNoise:
    """Return how much noisier a target is on its slopes than on its plateaus.

    Parameters
    ----------
    frames
        Shape (frame, row, col), DN; the target's lines run down the rows.
    level
        From 0 (dark) to 1 (bright), shape (row, col).
    steep
        Slope of the target across its lines, shape (row, col).
    sides
        0 for pixels that do not count, 1 on the dark and 2 on the bright plateau, shape (row, col).

    Notes
    -----
    The variance of light and of read-out is linear in the level. Taken off before are each frame's own level and
    contrast, as lamps flicker, and of every row on the slope what moves it: jitter of lines is no noise. What
    neighbours share of noise makes that more than one pixel's, and the ratio smaller.
    """
    on_slope = (np.abs(steep) > STEEP * np.abs(steep).max()) & (np.count_nonzero(sides, axis=1) > 0)[:, None]
    if len(frames) < MIN_FRAMES or not on_slope.any():
        return SlopeNoise()
    left = _steady(frames - frames.mean(axis=0), level, on_slope | (sides > 0))
    free = len(frames) - 1
    square = np.sum(left**2, axis=0) / free
    count = np.count_nonzero(on_slope, axis=1)
    shape = np.where(on_slope, steep, 0.0)
    moved = np.einsum("fij,ij->fi", left, shape) ** 2 / np.maximum(np.sum(shape**2, axis=1), 1e-300)
    slope = np.sum(square * on_slope, axis=1) - moved.sum(axis=0) / free
    told = count >= MIN_STEEP_PIXELS
    # One of a row's pixels is taken off with what moves it.
    share = (count - 1) / np.maximum(count, 1)
    bright = np.where(on_slope, np.clip(level, 0.0, 1.0), 0.0).sum(axis=1) * share
    # Of every row: what is on the slope and how many pixels at either level are expected to make it.
    slope, bright, dark = ((told * one) for one in (slope, bright, count * share - bright))
    plateaus = [(np.sum(square * (sides == one), axis=1), np.count_nonzero(sides == one, axis=1)) for one in (1, 2)]
    parts = [slope, dark, bright, *(part for plateau in plateaus for part in plateau)]
    return _noise_ratio(np.stack([np.asarray(part, np.float64) for part in parts]))


def _steady(left: Array, level: Array, used: NDArray[np.bool_]) -> Array:
    """Return what is left of frames without each frame's own level and contrast."""
    design = np.stack([np.ones(np.count_nonzero(used)), level[used]])
    found = np.linalg.lstsq(design.T, left[:, used].T, rcond=None)[0]
    return left - found[0][:, None, None] - found[1][:, None, None] * level


def _noise_ratio(parts: Array) -> SlopeNoise:
    """Return the ratio from the sums of rows, its error from leaving out blocks of them in turn."""
    blocks = parts.shape[1] // BLOCK_ROWS
    if blocks < MIN_BLOCKS:
        return SlopeNoise()
    sums = parts[:, : blocks * BLOCK_ROWS].reshape(len(parts), blocks, BLOCK_ROWS).sum(axis=2)
    total = sums.sum(axis=1)
    if min(total[[1, 2, 3, 4, 5, 6]]) <= 0:
        return SlopeNoise()
    ratio, each = _ratio(total[:, None])[0], _ratio(total[:, None] - sums)
    return SlopeNoise(ratio=float(ratio), sd=float(np.sqrt((blocks - 1) / blocks * np.sum((each - each.mean()) ** 2))))


def _ratio(sums: Array) -> Array:
    slope, dark, bright, dark_sum, dark_count, bright_sum, bright_count = sums
    expected = dark * dark_sum / np.maximum(dark_count, 1.0) + bright * bright_sum / np.maximum(bright_count, 1.0)
    return slope / np.maximum(expected, 1e-300)
