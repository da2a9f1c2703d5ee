"""Spread of one pulse, and filter outputs at all positions as few amplitudes with areas."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from charact.noise.events.filters import Filter
from charact.noise.thresholds import EVENT_ACCURACY

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
