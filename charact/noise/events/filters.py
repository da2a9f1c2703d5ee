"""Pulse filters in space and time, insensitive to offsets and slopes, and the spread of a pulse."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.noise.thresholds import EVENT_ACCURACY

Images = NDArray[np.float32]

# Index of the filter matched to the spot.
MIDDLE = 3


@dataclass(frozen=True, kw_only=True)
class Filter:
    """Sum over a box of pixels less the mean on both sides, in one exposure or across several.

    Parameters
    ----------
    high, broad
        Rows and columns of the box, odd.
    times
        Weights of successive exposures of one parity.
    stride
        Exposures between successive ones of one parity: 2 for fields.
    exposures
        Exposures of one parity in each pixel's subtracted mean.
    """

    high: int
    broad: int
    times: tuple[float, ...] = (1.0,)
    stride: int = 1
    exposures: int = 64

    @cached_property
    def columns(self) -> NDArray[np.float64]:
        """Weights along a row; their sum is zero."""
        side, gap = (
            np.full(EVENT_ACCURACY.background_px, -self.broad / (2.0 * EVENT_ACCURACY.background_px)),
            np.zeros(EVENT_ACCURACY.gap_px),
        )
        return np.concatenate([side, gap, np.ones(self.broad), gap, side])

    @property
    def reach(self) -> tuple[int, int]:
        """Rows and columns of margin on each side."""
        return self.high // 2, len(self.columns) // 2

    def noise(self, line: tuple[float, ...]) -> float:
        """Return the output variance over that of white noise before the video filter along a line."""
        across, time = np.convolve(self.columns, line), np.asarray(self.times)
        return float((across @ across) * self.high * (time @ time - time.sum() ** 2 / self.exposures))

    def within(self, change: Images, reach: tuple[int, int]) -> Images:
        """Return the filtered images at all pixels with a margin of `reach` rows and columns.

        Parameters
        ----------
        change
            Images, shape (exposure, row, col).
        reach
            Margin in rows and columns, at least that of the filter; the output is smaller by twice as many.
        """
        rows, cols = change.shape[1] - 2 * reach[0], change.shape[2] - 2 * reach[1]
        top, left = reach[0] - self.reach[0], reach[1] - self.reach[1]
        strip = _box_sum(change, self.high, top, rows)
        side, middle, right = (
            left,
            left + EVENT_ACCURACY.background_px + EVENT_ACCURACY.gap_px,
            left + EVENT_ACCURACY.background_px + 2 * EVENT_ACCURACY.gap_px + self.broad,
        )
        total = np.zeros((*strip.shape[:2], strip.shape[2] + 1), np.float32)
        np.cumsum(strip, axis=2, out=total[..., 1:])
        out = (
            total[..., side + EVENT_ACCURACY.background_px : side + EVENT_ACCURACY.background_px + cols]
            - total[..., side : side + cols]
        )
        out += total[..., right + EVENT_ACCURACY.background_px : right + EVENT_ACCURACY.background_px + cols]
        out -= total[..., right : right + cols]
        out *= np.float32(-self.broad / (2.0 * EVENT_ACCURACY.background_px))
        out += total[..., middle + self.broad : middle + self.broad + cols]
        out -= total[..., middle : middle + cols]
        return out if len(self.times) == 1 else self.through_time(out)

    def through_time(self, still: Images) -> Images:
        """Return the weighted sum over successive exposures of box-filtered images."""
        count = len(still) - len(self.times) + 1
        return sum(np.float32(w) * still[i : i + count] for i, w in enumerate(self.times))  # type: ignore[return-value]


def _box_sum(change: Images, high: int, top: int, rows: int) -> Images:
    """Return sums of `high` rows starting at each of `rows` rows from `top`."""
    out = change[:, top : top + rows]
    for shift in range(1, high):
        out = out + change[:, top + shift : top + shift + rows]
    return out


def common_reach(filters: Sequence[Filter]) -> tuple[int, int]:
    """Return the margin in rows and columns of all filters."""
    return max(one.reach[0] for one in filters), max(one.reach[1] for one in filters)


def boxes(step: int, *, stride: int, exposures: int, lag: bool) -> tuple[Filter, ...]:
    """Return filters from one pixel to several times a spot of half width `step`.

    Parameters
    ----------
    step
        Half width of the matched filter, px.
    stride, exposures
        As in `Filter`.
    lag
        Whether to include filters across exposures.
    """
    near, wide = 2 * step + 1, 6 * step + 1

    def box(high: int, broad: int, times: tuple[float, ...] = (1.0,)) -> Filter:
        return Filter(high=high, broad=broad, times=times, stride=stride, exposures=exposures)

    plain = (box(1, 1), box(1, near), box(near, 1), box(near, near), box(wide, wide))
    return plain + (box(near, near, (1.0, -1.0)), box(near, near, (1.0, 1.0, 1.0, 1.0))) * lag
