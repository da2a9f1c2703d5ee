"""Detection of edge-preserving noise reduction from the noise on slopes and plateaus."""

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
    """Temporal variance on the slopes of a target over that expected from its plateaus.

    Parameters
    ----------
    ratio, sd
        Ratio and its standard uncertainty, dimensionless.
    """

    ratio: float = 1.0
    sd: float = np.inf

    @property
    def is_smoothed(self) -> bool:
        """Whether the plateaus are quieter than photon and read-out noise allow."""
        return self.ratio > EXCESS[0] + EXCESS[1] * self.sd


def noise_on_slopes(frames: Array, level: Array, steep: Array, sides: NDArray[np.int64]) -> SlopeNoise:
    """Return the noise on the slopes of a target relative to that of its plateaus.

    Parameters
    ----------
    frames
        Shape (frame, row, col), DN; the target's lines run down the rows.
    level
        From 0 (dark) to 1 (bright), shape (row, col).
    steep
        Slope of the target across its lines, shape (row, col).
    sides
        0 for excluded pixels, 1 on the dark and 2 on the bright plateau, shape (row, col).

    Notes
    -----
    The variance of photon and read-out noise is linear in the level. Level and contrast of each frame are subtracted
    (lamp flicker), and from each row's slope the component of a displacement (line jitter). Correlated noise makes that
    component larger and the ratio smaller.
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
    # The displacement of a row takes one degree of freedom.
    share = (count - 1) / np.maximum(count, 1)
    bright = np.where(on_slope, np.clip(level, 0.0, 1.0), 0.0).sum(axis=1) * share
    # Per row: variance on the slope, and the equivalent number of pixels at the dark and the bright level.
    slope, bright, dark = ((told * one) for one in (slope, bright, count * share - bright))
    plateaus = [(np.sum(square * (sides == one), axis=1), np.count_nonzero(sides == one, axis=1)) for one in (1, 2)]
    parts = [slope, dark, bright, *(part for plateau in plateaus for part in plateau)]
    return _noise_ratio(np.stack([np.asarray(part, np.float64) for part in parts]))


def _steady(left: Array, level: Array, used: NDArray[np.bool_]) -> Array:
    """Subtract each frame's level and contrast."""
    design = np.stack([np.ones(np.count_nonzero(used)), level[used]])
    found = np.linalg.lstsq(design.T, left[:, used].T, rcond=None)[0]
    return left - found[0][:, None, None] - found[1][:, None, None] * level


def _noise_ratio(parts: Array) -> SlopeNoise:
    """Return the ratio from the sums of rows, with a jackknife uncertainty over blocks of rows."""
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
