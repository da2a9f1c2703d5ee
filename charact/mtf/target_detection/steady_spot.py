"""Light that stands at one place in most frames, and how far single flashes reach without any."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.mtf.point.thresholds import LIMITS
from charact.mtf.target_detection.smoothed_mean_frame import gaussian_blur
from labdata.frames import FrameStack

Array = NDArray[np.float32]

# Smoothing for the search, and the wider one that stands for the ground, px.
SMOOTHING_PX, GROUND_PX = 1.2, 8.0
# Fewest frames that tell a source from a flash, and into how many groups more are averaged.
MIN_FRAMES, MAX_GROUPS = 3, 16
# Upper quantiles of the background and how many standard deviations a normal one has there: pulses reach further.
TAIL, TAIL_SD = 0.97, 1.8808
FAR_TAIL, FAR_TAIL_SD = 0.999, 3.0902
FAR_ENOUGH = 20_000


@dataclass(frozen=True, kw_only=True)
class SteadySpots:
    """Smoothed light over its ground.

    Parameters
    ----------
    groups
        Frames, or means of as many as make few enough groups, shape (group, row, col), DN.
    height
        Their median over the median of the picture, shape (row, col), DN; of too few frames their mean.
    spread
        Standard deviation of the background, DN.
    """

    groups: Array
    height: Array
    spread: float

    def stays(self, row: int, col: int) -> bool:
        """Tell whether light at a place stands out of its own changes from frame to frame."""
        if len(self.groups) < MIN_FRAMES:
            return True
        over = self.groups[:, row, col]
        error = max(float(over.std(ddof=1)), self.spread) / np.sqrt(len(over))
        return bool(over.mean() >= LIMITS.min_steadiness_sd * error)

    def far_spread(self, places: list[tuple[int, int]], apart_px: int) -> float:
        """Return the standard deviation that the background's far tail says, places and their surroundings left out."""
        bare = np.ones(self.height.shape, bool)
        for row, col in places:
            bare[max(row - apart_px, 0) : row + apart_px + 1, max(col - apart_px, 0) : col + apart_px + 1] = False
        rest = self.height[bare]
        far = float(np.quantile(rest, FAR_TAIL)) / FAR_TAIL_SD if rest.size > FAR_ENOUGH else 0.0
        return max(self.spread, far)


def steady_light(pictures: NDArray | FrameStack, replaced: tuple[NDArray[np.bool_], Array]) -> SteadySpots:
    """Return the steady light of a picture (row, col), stack or frames (frame, row, col).

    Parameters
    ----------
    replaced
        Which pixels say nothing, shape (row, col), and what stands for them, DN.
    """
    data = pictures.data if isinstance(pictures, FrameStack) else np.asarray(pictures)
    data = data[None] if data.ndim == 2 else data
    count = min(len(data), MAX_GROUPS) if len(data) >= MIN_FRAMES else 1
    groups = np.stack([_subtract_background(part.mean(axis=0, dtype=np.float32), replaced)
                       for part in np.array_split(data, count)])  # fmt: skip
    height = np.median(groups, axis=0)
    middle = float(np.median(height))
    height = height - middle
    robust = 1.4826 * float(np.median(np.abs(height)))
    tail = float(np.quantile(height[::2, ::2], TAIL)) / TAIL_SD
    rounding = LIMITS.min_background_sd_dn if data.dtype.kind in "ui" else 0.0
    spread = max(robust, tail, rounding, 1e-6 * float(np.ptp(height)))
    return SteadySpots(groups=groups - middle, height=height, spread=spread)


def _subtract_background(picture: Array, replaced: tuple[NDArray[np.bool_], Array]) -> Array:
    whole = np.where(*replaced, picture)
    return gaussian_blur(whole, SMOOTHING_PX) - gaussian_blur(whole, GROUND_PX)
