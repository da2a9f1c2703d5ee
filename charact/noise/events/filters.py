"""Filters through space and time that tell pulses from noise, each blind to levels, lines and slow change."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Images = NDArray[np.float32]

# The background of a filter lies on both sides in its own rows: gap and length, px.
GAP_PX, SIDE_PX = 3, 8
# Index of the filter that suits the spot.
MIDDLE = 3


@dataclass(frozen=True, kw_only=True)
class Filter:
    """A box of pixels less the mean of the pixels on both its sides, in one exposure or across several.

    Parameters
    ----------
    high, broad
        Rows and columns of the box, odd.
    times
        Weights of successive exposures of the same rows.
    stride
        Exposures from one of the same rows to the next: 2 for fields.
    exposures
        Exposures of the same rows over which each pixel's mean was taken away.
    """

    high: int
    broad: int
    times: tuple[float, ...] = (1.0,)
    stride: int = 1
    exposures: int = 64

    @cached_property
    def columns(self) -> NDArray[np.float64]:
        """Weights along a row of the image; they add up to nothing."""
        side, gap = np.full(SIDE_PX, -self.broad / (2.0 * SIDE_PX)), np.zeros(GAP_PX)
        return np.concatenate([side, gap, np.ones(self.broad), gap, side])

    @property
    def reach(self) -> tuple[int, int]:
        """Rows and columns on each side that the filter needs."""
        return self.high // 2, len(self.columns) // 2

    def noise(self, line: tuple[float, ...]) -> float:
        """Variance of the filter's output over that of white noise before the video's response along a line."""
        across, time = np.convolve(self.columns, line), np.asarray(self.times)
        return float((across @ across) * self.high * (time @ time - time.sum() ** 2 / self.exposures))

    def within(self, change: Images, reach: tuple[int, int]) -> Images:
        """Return the filtered images at all pixels that have `reach` rows and columns around them.

        Parameters
        ----------
        change
            Images, shape (exposure, row, col).
        reach
            Rows and columns, at least the filter's own; the output is smaller by twice as many.
        """
        rows, cols = change.shape[1] - 2 * reach[0], change.shape[2] - 2 * reach[1]
        top, left = reach[0] - self.reach[0], reach[1] - self.reach[1]
        strip = _box_sum(change, self.high, top, rows)
        side, middle, right = left, left + SIDE_PX + GAP_PX, left + SIDE_PX + 2 * GAP_PX + self.broad
        total = np.zeros((*strip.shape[:2], strip.shape[2] + 1), np.float32)
        np.cumsum(strip, axis=2, out=total[..., 1:])
        out = total[..., side + SIDE_PX : side + SIDE_PX + cols] - total[..., side : side + cols]
        out += total[..., right + SIDE_PX : right + SIDE_PX + cols]
        out -= total[..., right : right + cols]
        out *= np.float32(-self.broad / (2.0 * SIDE_PX))
        out += total[..., middle + self.broad : middle + self.broad + cols]
        out -= total[..., middle : middle + cols]
        return out if len(self.times) == 1 else self.through_time(out)

    def through_time(self, still: Images) -> Images:
        """Return the weighted sum of successive exposures of what a filter of this box makes of each."""
        count = len(still) - len(self.times) + 1
        return sum(np.float32(w) * still[i : i + count] for i, w in enumerate(self.times))  # type: ignore[return-value]


def _box_sum(change: Images, high: int, top: int, rows: int) -> Images:
    """Sum of `high` rows from each of the `rows` rows after `top`."""
    out = change[:, top : top + rows]
    for shift in range(1, high):
        out = out + change[:, top + shift : top + shift + rows]
    return out


def common_reach(filters: Sequence[Filter]) -> tuple[int, int]:
    """Return rows and columns that all filters need on each side."""
    return max(one.reach[0] for one in filters), max(one.reach[1] for one in filters)


def boxes(step: int, *, stride: int, exposures: int, lag: bool) -> tuple[Filter, ...]:
    """Return filters from one pixel to well beyond a spot of some `step` pixels.

    Parameters
    ----------
    step
        Half width of the middle one, px.
    stride, exposures
        As in `Filter`.
    lag
        Whether filters that compare exposures are among them.
    """
    near, wide = 2 * step + 1, 6 * step + 1

    def box(high: int, broad: int, times: tuple[float, ...] = (1.0,)) -> Filter:
        return Filter(high=high, broad=broad, times=times, stride=stride, exposures=exposures)

    plain = (box(1, 1), box(1, near), box(near, 1), box(near, near), box(wide, wide))
    return plain + (box(near, near, (1.0, -1.0)), box(near, near, (1.0, 1.0, 1.0, 1.0))) * lag
