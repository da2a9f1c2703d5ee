"""The spot of one pulse, and what a filter makes of it at all places: few amplitudes, each with its area."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from charact.noise.events.filters import Filter

Array = NDArray[np.float64]

# Places of a pulse: steps within a pixel, and how far a spot reaches around the filter, px on both sides together.
STEPS, SPOT_PX = 4, 18
# Logarithm of the highest transfer.
SHARPEST = 3.0
# Frequency at which the strength of the wings is stated, cycles per pixel.
REFERENCE_CY_PER_PX = 0.1
# Amplitudes from zero to the largest by which many are represented.
NODES = 48


@dataclass(frozen=True, kw_only=True)
class PulseSpread:
    """How a pulse spreads after the gain. Names as in `charact.noise.events.event_distribution.PulsePopulation`."""

    column_px: float
    row_px: float
    wings: float
    exponent: float
    row_pitch: float

    def area_px(self) -> float:
        """Return the area of a spot, 1 over the integral of its square, px."""
        sides = _sides(Filter(high=1, broad=1))
        power = _transfer(self, sides) ** 2
        return float(sides[0] * sides[1] / (2.0 * power.sum() - power[:, 0].sum() - power[:, -1].sum()))


def _sides(one: Filter) -> tuple[int, int]:
    """Rows and columns of the places around a filter, px."""
    rows, cols = (-(-(size + SPOT_PX) // 8) * 8 for size in (one.high, len(one.columns)))
    return rows, cols


@lru_cache(maxsize=64)
def _transfer(spot: PulseSpread, sides: tuple[int, int]) -> Array:
    """Transfer from a pulse to the light on a pixel, at the frequencies of the places."""
    squares, distance, pixel = _plane(spot.row_pitch, sides)
    gauss = spot.column_px**2 * squares[1] + spot.row_px**2 * squares[0]
    # Wings of less than nothing, which a fit may try, must not overflow.
    return np.exp(np.minimum(-2.0 * np.pi**2 * gauss - spot.wings * distance**spot.exponent, SHARPEST)) * pixel


@lru_cache(maxsize=8)
def _plane(row_pitch: float, sides: tuple[int, int]) -> tuple[tuple[Array, Array], Array, Array]:
    """Squares of frequencies along both axes, distance from zero in units of the reference, transfer of a pixel."""
    fy, fx = _frequencies(sides)
    distance = np.hypot(fx, fy / row_pitch) / REFERENCE_CY_PER_PX
    return (fy**2, fx**2), np.asarray(distance, np.float64), np.asarray(np.sinc(fx) * np.sinc(fy), np.float64)


@lru_cache(maxsize=8)
def _frequencies(sides: tuple[int, int]) -> tuple[Array, Array]:
    fy = np.fft.fftfreq(STEPS * sides[0])[:, None] * STEPS
    fx = np.fft.rfftfreq(STEPS * sides[1])[None, :] * STEPS
    return np.asarray(fy, np.float64), np.asarray(fx, np.float64)


def _comb(kernel: NDArray[np.float64], frequency: Array) -> NDArray[np.complex128]:
    """Transfer of weights on the pixels' lattice, counted from the middle."""
    place = np.arange(len(kernel)) - len(kernel) // 2
    return np.asarray(np.exp(-2j * np.pi * np.multiply.outer(frequency.ravel(), place)) @ kernel, np.complex128)


@lru_cache(maxsize=64)
def _weights(one: Filter, line: tuple[float, ...]) -> NDArray[np.complex128]:
    """Transfer of the filter and of the video's line."""
    fy, fx = _frequencies(_sides(one))
    return _comb(np.ones(one.high), fy).real[:, None] * _comb(np.convolve(one.columns, line), fx)


def responses(one: Filter, spot: PulseSpread, line: tuple[float, ...] = (1.0,)) -> tuple[Array, Array]:
    """Return what a filter makes of unit pulses at all places: amplitudes, and the area in px of each.

    The thousands of places are shared out to a few amplitudes so that area, mean response and mean square stay.
    """
    return _responses(Filter(high=one.high, broad=one.broad), spot, line)


@lru_cache(maxsize=512)
def _responses(one: Filter, spot: PulseSpread, line: tuple[float, ...]) -> tuple[Array, Array]:
    sides = _sides(one)
    # Filters and spots are even along columns: one half stands for both, its borders for one.
    half = STEPS * sides[0] // 2 + 1
    transfer = _transfer(spot, sides) * _weights(one, line)
    whole = np.fft.irfft2(transfer, s=(STEPS * sides[0], STEPS * sides[1]))[:half]
    once = np.full(half, 2.0)
    once[[0, -1]] = 1.0
    weight = np.broadcast_to(once[:, None], whole.shape) / STEPS**2
    return quantise_amplitudes(whole.ravel() * STEPS**2, weight.ravel())


def quantise_amplitudes(value: Array, weight: Array) -> tuple[Array, Array]:
    """Return few values with weights in place of many, so that moments up to the second stay.

    Each value goes to the three nearest nodes by the weights of quadratic interpolation, some of which are negative;
    nodes are as the squares of whole numbers, and all small values share the three around zero.
    """
    top = float(np.abs(value).max())
    place = np.sqrt(np.abs(value) / top) * NODES
    nodes = top * (np.arange(-NODES - 1, NODES + 2) / NODES) ** 2 * np.sign(np.arange(-NODES - 1, NODES + 2))
    far = place > 1.5
    small, small_weight = value[~far], weight[~far]
    zero, unit = NODES + 1, nodes[NODES + 2]
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
