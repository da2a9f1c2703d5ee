"""Pulse filters in space and time, insensitive to offsets and slopes, and the spread of a pulse."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from charact.noise.thresholds import EVENT_ACCURACY

Images = NDArray[np.float32]
# Index of the filter matched to the spot.
MIDDLE = 3


@dataclass(frozen=True, kw_only=True)
class Filter:
    """Sum over a box of pixels less the mean on both sides, in one exposure or across several."""

    # high, broad: rows and columns of the box, odd
    high: int
    broad: int
    times: tuple[float, ...] = (1.0,)  # weights of successive exposures of one parity
    stride: int = 1  # exposures between successive ones of one parity: 2 for fields
    exposures: int = 64  # exposures of one parity in each pixel's subtracted mean

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

        `change`: images, shape (exposure, row, col); `reach`: margin in rows and columns, at least that of the filter;
        the output is smaller by twice as many.
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

    `step`: half width of the matched filter, px; `stride`, `exposures`: as in `Filter`; `lag`: whether to include
    filters across exposures.
    """
    near, wide = 2 * step + 1, 6 * step + 1

    def box(high: int, broad: int, times: tuple[float, ...] = (1.0,)) -> Filter:
        return Filter(high=high, broad=broad, times=times, stride=stride, exposures=exposures)

    plain = (box(1, 1), box(1, near), box(near, 1), box(near, near), box(wide, wide))
    return plain + (box(near, near, (1.0, -1.0)), box(near, near, (1.0, 1.0, 1.0, 1.0))) * lag


Array = NDArray[np.float64]
# Reference frequency of the wings, cycles per pixel.
REFERENCE_CY_PER_PX = 0.1


@dataclass(frozen=True, kw_only=True)
class PulseSpread:
    """Spread of a pulse after the gain; names as in `charact.noise.events.event_distribution.PulsePopulation`."""

    column_px: float
    row_px: float
    wings: float
    exponent: float
    row_pitch: float

    def area_px(self) -> float:
        """Return the effective area of a spot, 1 over the integral of its square, px."""
        sides = _sides(Filter(high=1, broad=1))
        power = _transfer(self, sides) ** 2
        return float(sides[0] * sides[1] / (2.0 * power.sum() - power[:, 0].sum() - power[:, -1].sum()))


def _sides(one: Filter) -> tuple[int, int]:
    """Return rows and columns of the positions around a filter, px."""
    rows, cols = (-(-(size + EVENT_ACCURACY.spot_px) // 8) * 8 for size in (one.high, len(one.columns)))
    return rows, cols


@lru_cache(maxsize=64)
def _transfer(spot: PulseSpread, sides: tuple[int, int]) -> Array:
    """Return the transfer from a pulse to the light of a pixel."""
    squares, distance, pixel = _plane(spot.row_pitch, sides)
    gauss = spot.column_px**2 * squares[1] + spot.row_px**2 * squares[0]
    # Negative wings, tried by a fit, must not overflow.
    return (
        np.exp(
            np.minimum(-2.0 * np.pi**2 * gauss - spot.wings * distance**spot.exponent, EVENT_ACCURACY.max_log_transfer)
        )
        * pixel
    )


@lru_cache(maxsize=8)
def _plane(row_pitch: float, sides: tuple[int, int]) -> tuple[tuple[Array, Array], Array, Array]:
    """Return squared frequencies along both axes, radial frequency over the reference, and pixel transfer."""
    fy, fx = _frequencies(sides)
    distance = np.hypot(fx, fy / row_pitch) / REFERENCE_CY_PER_PX
    return (fy**2, fx**2), np.asarray(distance, np.float64), np.asarray(np.sinc(fx) * np.sinc(fy), np.float64)


@lru_cache(maxsize=8)
def _frequencies(sides: tuple[int, int]) -> tuple[Array, Array]:
    fy = np.fft.fftfreq(EVENT_ACCURACY.steps_per_px * sides[0])[:, None] * EVENT_ACCURACY.steps_per_px
    fx = np.fft.rfftfreq(EVENT_ACCURACY.steps_per_px * sides[1])[None, :] * EVENT_ACCURACY.steps_per_px
    return np.asarray(fy, np.float64), np.asarray(fx, np.float64)


def _comb(kernel: NDArray[np.float64], frequency: Array) -> NDArray[np.complex128]:
    """Return the transfer of weights on the pixel lattice, about the centre."""
    place = np.arange(len(kernel)) - len(kernel) // 2
    return np.asarray(np.exp(-2j * np.pi * np.multiply.outer(frequency.ravel(), place)) @ kernel, np.complex128)


@lru_cache(maxsize=64)
def _weights(one: Filter, line: tuple[float, ...]) -> NDArray[np.complex128]:
    """Return the transfer of the filter and the video filter."""
    fy, fx = _frequencies(_sides(one))
    return _comb(np.ones(one.high), fy).real[:, None] * _comb(np.convolve(one.columns, line), fx)


def responses(one: Filter, spot: PulseSpread, line: tuple[float, ...] = (1.0,)) -> tuple[Array, Array]:
    """Return the filter outputs of unit pulses at all positions: amplitudes, and the area in px of each.

    Thousands of positions are reduced to few amplitudes with equal area, mean and mean square.
    """
    return _responses(Filter(high=one.high, broad=one.broad), spot, line)


@lru_cache(maxsize=512)
def _responses(one: Filter, spot: PulseSpread, line: tuple[float, ...]) -> tuple[Array, Array]:
    sides = _sides(one)
    # Filters and spots are symmetric along columns: one half counts twice, its borders once.
    half = EVENT_ACCURACY.steps_per_px * sides[0] // 2 + 1
    transfer = _transfer(spot, sides) * _weights(one, line)
    whole = np.fft.irfft2(transfer, s=(EVENT_ACCURACY.steps_per_px * sides[0], EVENT_ACCURACY.steps_per_px * sides[1]))[
        :half
    ]
    once = np.full(half, 2.0)
    once[[0, -1]] = 1.0
    weight = np.broadcast_to(once[:, None], whole.shape) / EVENT_ACCURACY.steps_per_px**2
    return quantise_amplitudes(whole.ravel() * EVENT_ACCURACY.steps_per_px**2, weight.ravel())


def quantise_amplitudes(value: Array, weight: Array) -> tuple[Array, Array]:
    """Return few values with weights in place of many, with equal moments up to the second.

    Each value is assigned to the three nearest nodes by quadratic interpolation (some weights are negative). Nodes are
    proportional to squared integers; small values use the three around zero.
    """
    top = float(np.abs(value).max())
    place = np.sqrt(np.abs(value) / top) * EVENT_ACCURACY.nodes
    nodes = (
        top
        * (np.arange(-EVENT_ACCURACY.nodes - 1, EVENT_ACCURACY.nodes + 2) / EVENT_ACCURACY.nodes) ** 2
        * np.sign(np.arange(-EVENT_ACCURACY.nodes - 1, EVENT_ACCURACY.nodes + 2))
    )
    far = place > 1.5
    small, small_weight = value[~far], weight[~far]
    zero, unit = EVENT_ACCURACY.nodes + 1, nodes[EVENT_ACCURACY.nodes + 2]
    out = np.zeros(len(nodes))
    first, second = float(small_weight @ small) / unit, float(small_weight @ small**2) / unit**2
    out[zero - 1 : zero + 2] = 0.5 * (second - first), float(small_weight.sum()) - second, 0.5 * (second + first)
    large, large_weight = value[far], weight[far]
    middle = np.rint(np.copysign(place[far], large)).astype(np.int64) + zero
    middle = np.clip(middle, 1, len(nodes) - 2)
    a, b, c = nodes[middle - 1], nodes[middle], nodes[middle + 1]
    to_a, to_b, to_c = large - a, large - b, large - c
    out += np.bincount(middle - 1, to_b * to_c / ((a - b) * (a - c)) * large_weight, len(nodes))
    out += np.bincount(middle, to_a * to_c / ((b - a) * (b - c)) * large_weight, len(nodes))
    out += np.bincount(middle + 1, to_a * to_b / ((c - a) * (c - b)) * large_weight, len(nodes))
    used = out != 0.0
    return nodes[used], out[used]
