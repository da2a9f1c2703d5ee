"""The transfer of a pupil with a hole and out of focus by table, compiled: with its slopes, scaled by a half frequency.

Kept at even steps of the share of the pupil's area that is obscured and of defocus squared, in both of which the
transfer is smooth down to none.
"""

from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from charact.mtf.forms.diffraction import pupil

Array = NDArray[np.float64]
# Transfer, shape (area, defocus squared, frequency), and half frequency over the cut-off, shape (area, defocus
# squared).
Table = tuple[Array, Array]

# Bounds of the share of the pupil's area that is obscured, of defocus squared, waves^2, and steps of the table.
AREA, SQUARED_WAVES = (0.0, 0.4), (0.0, 0.64)
AREAS, SQUARES, FREQUENCIES = 11, 17, 129


@lru_cache(maxsize=1)
def pupil_table() -> Table:
    """Return the table, made in some hundredths of a second."""
    frequency = np.linspace(0.0, 1.0, FREQUENCIES)
    area, squared = np.meshgrid(np.linspace(*AREA, AREAS), np.linspace(*SQUARED_WAVES, SQUARES), indexing="ij")
    table = pupil(frequency, 1.0, np.sqrt(area.ravel()), np.sqrt(squared.ravel()))
    below = np.argmax(table < 0.5, axis=1)
    every = np.arange(len(table))
    high, low = table[every, below - 1], table[every, below]
    half = (below - 1 + (high - 0.5) / (high - low)) * frequency[1]
    return table.reshape(AREAS, SQUARES, FREQUENCIES), half.reshape(AREAS, SQUARES)


def scaled_pupil(frequency: Array, half_frequency: Array, area: Array, squared: Array) -> Array:
    """Return the transfer of pupils, shape (f,), (n,), (n,), (n,) -> (n, f).

    Parameters
    ----------
    frequency, half_frequency
        Cycles per pixel.
    area
        Share of the pupil's area that is obscured: the obscuration squared.
    squared
        Defocus squared, waves^2.
    """
    return _all_scaled(frequency, half_frequency, area, squared, pupil_table())


@njit(cache=True)
def _all_scaled(frequency: Array, half: Array, area: Array, squared: Array, table: Table) -> Array:
    out = np.empty((half.size, frequency.size))
    for i in range(half.size):
        for j in range(frequency.size):
            out[i, j] = scaled_pupil_at(frequency[j] / half[i], area[i], squared[i], table)[0]
    return out


@njit(cache=True)
def scaled_pupil_at(ratio: float, area: float, squared: float, table: Table) -> tuple[float, float, float, float]:
    """Return the transfer at f/f2, and its slopes with ln(f/f2), area and defocus squared.

    Linear in frequency and area, in defocus squared Lagrange's cubic.
    """
    transfer, halves = table
    row = min(max(area / AREA[1] * (AREAS - 1), 0.0), AREAS - 1.0)
    low = min(int(row), AREAS - 2)
    rest = row - low
    column = min(max(squared / SQUARED_WAVES[1] * (SQUARES - 1), 0.0), SQUARES - 1.0)
    first = min(max(int(column) - 1, 0), SQUARES - 4)
    t = column - first
    weight, rise = np.empty(4), np.empty(4)
    for k in range(4):
        weight[k], rise[k] = 1.0, 0.0
        for m in range(4):
            if m != k:
                rise[k] = rise[k] * (t - m) / (k - m) + weight[k] / (k - m)
                weight[k] *= (t - m) / (k - m)
    half, half_by_area, half_by_squared = 0.0, 0.0, 0.0
    for k in range(4):
        near, far = halves[low, first + k], halves[low + 1, first + k]
        half += weight[k] * (near + rest * (far - near))
        half_by_area += weight[k] * (far - near)
        half_by_squared += rise[k] * (near + rest * (far - near))
    v = ratio * half
    if v >= 1.0:
        return 0.0, 0.0, 0.0, 0.0
    place = v * (FREQUENCIES - 1)
    left = min(int(place), FREQUENCIES - 2)
    part = place - left
    value, by_v, by_area, by_squared = 0.0, 0.0, 0.0, 0.0
    for k in range(4):
        one, other = transfer[low, first + k], transfer[low + 1, first + k]
        near, far = one[left] + part * (one[left + 1] - one[left]), other[left] + part * (other[left + 1] - other[left])
        value += weight[k] * (near + rest * (far - near))
        by_squared += rise[k] * (near + rest * (far - near))
        by_area += weight[k] * (far - near)
        by_v += weight[k] * ((1.0 - rest) * (one[left + 1] - one[left]) + rest * (other[left + 1] - other[left]))
    by_v *= FREQUENCIES - 1
    by_area = (by_area + by_v * ratio * half_by_area) * (AREAS - 1) / AREA[1]
    by_squared = (by_squared + by_v * ratio * half_by_squared) * (SQUARES - 1) / SQUARED_WAVES[1]
    return value, by_v * v, by_area, by_squared
