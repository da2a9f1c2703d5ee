"""The transfer of a pupil with a hole and out of focus by table, compiled: with its slopes, scaled
by a half frequency.

It is an entire function of defocus squared, kept at Chebyshev's places, and linear between close
obscurations and frequencies.
"""

from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from labdata import Array

# Diameter of the obscuration over that of the pupil: telescopes have up to about a half.
OBSCURATION = (0.0, 0.8)
# Nodes that integrate to 1e-7 up to a defocus of 3 waves.
NODES = 16
_AT, _WEIGHT = np.polynomial.legendre.leggauss(NODES)


def pupil(
    frequency: Array, cut_off: ArrayLike, obscuration: ArrayLike = 0.0, defocus: ArrayLike = 0.0
) -> Array:
    """Return the transfer of a pupil in incoherent light of one wavelength, shape (f,), (n,), (n,),
    (n,) -> (n, f).

    Parameters
    ----------
    frequency, cut_off
        Cycles per pixel; nothing passes from the cut-off 1 / (wavelength x f-number) on.
    obscuration
        Diameter of the obscuration over that of the pupil, 0: none.
    defocus
        Optical path by which the pupil's border is off, W020, waves; negative transfers exchange
        bright and dark.

    Notes
    -----
    The transfer is the pupil's autocorrelation (Hopkins, Proc. R. Soc. A 231, 91, 1955): with v = f
    / cut-off,

        T(v) = integral of cos(8 pi W v x) over the overlap of two pupils with centres at x = -v and
        v / pupil's area.

    A pupil with a hole is a disc less a disc, so the overlap is that of two outer discs, less twice
    that of an outer with an inner one, plus that of two inner ones; each is made of segments of
    circles. In focus a clear pupil has 2/pi (acos v - v sqrt(1 - v^2)); with a hole the sum is that
    of O'Neill (J. Opt. Soc. Am. 46, 285, 1956).
    """
    parameters = np.broadcast_arrays(
        *(
            np.atleast_1d(np.asarray(parameter, float))
            for parameter in (cut_off, obscuration, defocus)
        )
    )
    return _all_pupils(
        np.asarray(frequency, float), *(np.ascontiguousarray(parameter) for parameter in parameters)
    )


@njit(cache=True)
def _all_pupils(frequency: Array, cut_off: Array, obscuration: Array, defocus: Array) -> Array:
    out = np.empty((cut_off.size, frequency.size))
    for i in range(cut_off.size):
        for j in range(frequency.size):
            out[i, j] = pupil_at(frequency[j] / cut_off[i], obscuration[i], defocus[i])
    return out


@njit(cache=True)
def pupil_at(ratio: float, obscuration: float, defocus: float) -> float:
    """Return the transfer at a frequency over the cut-off, of a hole and a defocus as `pupil` has
    them.
    """
    v = abs(ratio)
    if v >= 1.0:
        return 0.0
    wave = 8.0 * np.pi * defocus * v
    overlap = _common(v, 1.0, 1.0, wave)
    if obscuration > 0.0:
        overlap += _common(v, obscuration, obscuration, wave) - 2.0 * _common(
            v, 1.0, obscuration, wave
        )
    return overlap / (np.pi * (1.0 - obscuration**2))


@njit(cache=True)
def _common(v: float, left_radius: float, right_radius: float, wave: float) -> float:
    """Return the integral of cos(wave x) over what a disc about -v and a disc about v, not larger,
    share.
    """
    if 2.0 * v >= left_radius + right_radius:
        return 0.0
    if 2.0 * v <= left_radius - right_radius:
        return _segment(v, right_radius, 0.0, np.pi, wave)
    # Where the circles cross: to the left of it the right one is the border, and to the right of it
    # the left one.
    x = (left_radius**2 - right_radius**2) / (4.0 * v)
    to_left = _segment(
        v, right_radius, np.arccos(min(max((x - v) / right_radius, -1.0), 1.0)), np.pi, wave
    )
    return to_left + _segment(
        -v, left_radius, 0.0, np.arccos(min(max((x + v) / left_radius, -1.0), 1.0)), wave
    )


@njit(cache=True)
def _segment(middle: float, radius: float, low: float, high: float, wave: float) -> float:
    """Return the integral of cos(wave x) over a disc between two angles, x = middle + radius
    cos(angle).
    """
    if wave == 0.0:
        return radius**2 * ((high - low) - 0.5 * (np.sin(2.0 * high) - np.sin(2.0 * low)))
    half, total = 0.5 * (high - low), 0.0
    for k in range(NODES):
        cosine = np.cos(low + half * (1.0 + _AT[k]))
        total += _WEIGHT[k] * (1.0 - cosine * cosine) * np.cos(wave * (middle + radius * cosine))
    return 2.0 * radius**2 * half * total


# Obscured areas, shape (area,); defocus squared, waves^2, shape (place,); transfer, shape (area,
# place, frequency); half frequency over the cut-off, shape (area, place).
PupilTable = tuple[Array, Array, Array, Array]

# Bounds of the share of the pupil's area that is obscured, and of defocus squared, waves^2.
AREA, SQUARED_WAVES = (0.0, 0.4), (0.0, 0.64)
# Places of the table: within 2e-3 of the transfer at its kinks and 2e-4 elsewhere.
AREAS, SQUARES, FREQUENCIES = 21, 7, 257


@lru_cache(maxsize=1)
def pupil_table() -> PupilTable:
    """Return the table, made in a quarter of a second."""
    frequency = np.linspace(0.0, 1.0, FREQUENCIES)
    areas = np.linspace(0.0, np.sqrt(AREA[1]), AREAS) ** 2
    squares = SQUARED_WAVES[1] * 0.5 * (1.0 - np.cos(np.pi * np.arange(SQUARES) / (SQUARES - 1)))
    area, squared = (grid.ravel() for grid in np.meshgrid(areas, squares, indexing="ij"))
    table = pupil(frequency, 1.0, np.sqrt(area), np.sqrt(squared))
    first_below_half = np.argmax(table < 0.5, axis=1)
    every = np.arange(len(table))
    high, low = table[every, first_below_half - 1], table[every, first_below_half]
    half = (first_below_half - 1 + (high - 0.5) / (high - low)) * frequency[1]
    return areas, squares, table.reshape(AREAS, SQUARES, FREQUENCIES), half.reshape(AREAS, SQUARES)


@njit(cache=True)
def pupils_from_table(
    frequency: Array, half: Array, area: Array, squared: Array, table: PupilTable
) -> Array:
    """Return the transfer of pupils of a half frequency and its slopes with ln(f2), area and
    defocus squared, shape (f,), (n,), (n,), (n,) -> (4, n, f), cycles per pixel.

    `area`: share of the pupil's area that is obscured, the obscuration squared; `squared`: defocus
    squared, waves^2.
    """
    out = np.empty((4, half.size, frequency.size))
    for i in range(half.size):
        curves, halves = pupil_curves(area[i], squared[i], table)
        for j in range(frequency.size):
            value, rise, by_area, by_squared = pupil_and_slopes(
                frequency[j] / half[i], curves, halves
            )
            out[0, i, j], out[1, i, j], out[2, i, j], out[3, i, j] = (
                value,
                -rise,
                by_area,
                by_squared,
            )
    return out


@njit(cache=True)
def pupil_curves(area: float, squared: float, table: PupilTable) -> tuple[Array, Array]:
    """Return transfer and half frequency of one pupil and their slopes with area and defocus
    squared.

    Shapes (3, frequency), at even frequencies from 0 to the cut-off, and (3,).
    """
    areas, squares, transfer, half = table
    low = min(max(int(np.sqrt(max(area, 0.0) / AREA[1]) * (AREAS - 1)), 0), AREAS - 2)
    step = areas[low + 1] - areas[low]
    area_weight = min(max((area - areas[low]) / step, 0.0), 1.0)
    curves, halves = np.zeros((3, FREQUENCIES)), np.zeros(3)
    for k in range(SQUARES):
        # Lagrange's polynomial through all places, and its slope.
        weight, rise = 1.0, 0.0
        for m in range(SQUARES):
            if m != k:
                spacing = squares[k] - squares[m]
                rise = rise * (squared - squares[m]) / spacing + weight / spacing
                weight *= (squared - squares[m]) / spacing
        for row, low_weight, high_weight in (
            (0, weight * (1.0 - area_weight), weight * area_weight),
            (1, -weight / step, weight / step),
            (2, rise * (1.0 - area_weight), rise * area_weight),
        ):
            halves[row] += low_weight * half[low, k] + high_weight * half[low + 1, k]
            for j in range(FREQUENCIES):
                curves[row, j] += (
                    low_weight * transfer[low, k, j] + high_weight * transfer[low + 1, k, j]
                )
    return curves, halves


@njit(cache=True)
def pupil_and_slopes(
    ratio: float, curves: Array, halves: Array
) -> tuple[float, float, float, float]:
    """Return the transfer at f/f2, and its slopes with ln(f/f2), area and defocus squared."""
    position = ratio * halves[0] * (FREQUENCIES - 1)
    node = int(position)
    if node >= FREQUENCIES - 1:
        return 0.0, 0.0, 0.0, 0.0
    part = position - node
    rise = (curves[0, node + 1] - curves[0, node]) * position
    value = curves[0, node] + part * (curves[0, node + 1] - curves[0, node])
    by_area = (
        curves[1, node]
        + part * (curves[1, node + 1] - curves[1, node])
        + rise * halves[1] / halves[0]
    )
    by_squared = (
        curves[2, node]
        + part * (curves[2, node + 1] - curves[2, node])
        + rise * halves[2] / halves[0]
    )
    return value, rise, by_area, by_squared
