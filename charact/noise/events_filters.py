"""Filters through space and time that tell pulses from noise, each blind to levels, lines and slow change."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# The background of a filter lies on both sides in its own rows: gap and length, px.
GAP_PX, SIDE_PX = 3, 8


@dataclass(frozen=True, kw_only=True)
class Filter:
    """Weights of pixels and exposures around a pixel.

    Parameters
    ----------
    rows, columns
        Weights along a column and along a row of the image, of odd length and even; the columns' add up to nothing.
    times
        Weights of successive exposures of the same rows.
    stride
        Exposures from one of the same rows to the next: 2 for fields.
    exposures
        Exposures over which each pixel's mean was taken away.
    """

    rows: tuple[float, ...]
    columns: tuple[float, ...]
    times: tuple[float, ...] = (1.0,)
    stride: int = 1
    exposures: int = 64

    def noise(self, line: tuple[float, ...]) -> float:
        """Variance of the filter's output over that of white noise before the video's response along a line."""
        across = np.convolve(self.columns, line)
        power = across @ across
        time = np.asarray(self.times)
        kept = time @ time - time.sum() ** 2 / self.exposures
        return float(power * np.sum(np.square(self.rows)) * kept)

    def of(self, change: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the filtered images, shape (exposure, row, col), smaller by what the filter reaches beyond."""
        from scipy.ndimage import convolve1d

        out = change
        for weights, axis in ((self.rows, 1), (self.columns, 2)):
            reach = len(weights) // 2
            if reach:
                out = convolve1d(out, np.array(weights, np.float32), axis=axis)
                out = out[(slice(None),) * axis + (slice(reach, -reach),)]
        count = len(out) - len(self.times) + 1
        return sum(w * out[i : i + count] for i, w in enumerate(self.times))  # type: ignore[return-value]


def boxes(step: int, *, stride: int, exposures: int, lag: bool) -> tuple[Filter, ...]:
    """Return filters from one pixel to well beyond a spot of some `step` pixels.

    Parameters
    ----------
    step
        Half width of the middle one, px.
    lag
        Whether filters that compare exposures are among them.
    """
    near, wide = 2 * step + 1, 6 * step + 1

    def box(high: int, broad: int, times: tuple[float, ...] = (1.0,)) -> Filter:
        return Filter(rows=(1.0,) * high, columns=_with_background(broad), times=times, stride=stride,
                      exposures=exposures)  # fmt: skip

    plain = (box(1, 1), box(1, near), box(near, 1), box(near, near), box(wide, wide))
    through_time = (box(near, near, (1.0, -1.0)), box(near, near, (1.0, 1.0, 1.0, 1.0)))
    return plain + through_time * lag


def _with_background(broad: int) -> tuple[float, ...]:
    """A box of weights 1 with the mean of both sides taken away."""
    side = (-broad / (2.0 * SIDE_PX),) * SIDE_PX
    gap = (0.0,) * GAP_PX
    return (*side, *gap, *((1.0,) * broad), *gap, *side)
