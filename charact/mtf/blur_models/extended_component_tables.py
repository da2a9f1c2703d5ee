"""The sine integral and the transfer of a disc by table, compiled: what light beyond the core is made of."""

from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Places of the table of Si in a unit, and where it ends.
SINE_PER_UNIT, SINE_END = 100, 400.0
# Step and end of the table of a disc's transfer; beyond it Hankel's expansion is off by less than 1e-6.
DISC_STEP, DISC_END = 0.02, 400.0


@lru_cache(maxsize=1)
def sine_table() -> Array:
    """Return Si by Simpson's rule at places from 0 on, 1/`SINE_PER_UNIT` apart."""
    x = np.linspace(0.0, SINE_END, int(SINE_END) * SINE_PER_UNIT + 1)
    middle = 0.5 * (x[1:] + x[:-1])
    step = x[1] - x[0]
    ends, inner = np.sinc(x / np.pi), np.sinc(middle / np.pi)
    return np.concatenate([[0.0], np.cumsum((ends[1:] + 4.0 * inner + ends[:-1]) * step / 6.0)])


@lru_cache(maxsize=1)
def disc_table() -> Array:
    """Return 2 J1(x)/x and its slope -2 J2(x)/x at places from 0 on, `DISC_STEP` apart, shape (place, 2)."""
    from scipy.special import j1, jn

    x = np.maximum(np.arange(0.0, DISC_END + 2.0 * DISC_STEP, DISC_STEP), 1e-9)
    return np.stack([2.0 * j1(x) / x, -2.0 * jn(2, x) / x], axis=1)


def sine_integral(x: Array) -> Array:
    """Return Si(x) for x >= 0, beyond 400 by pi/2 - cos(x)/x (error below 1e-5)."""
    return _sines_from_table(np.ravel(x).astype(float), sine_table()).reshape(np.shape(x))


def disc_from_table(x: Array) -> Array:
    """Return 2 J1(x)/x for x >= 0 (error below 1e-8)."""
    return _discs_from_table(np.ravel(x).astype(float), disc_table()).reshape(np.shape(x))


def halo_from_table(x: Array, elastic_share: Array) -> Array:
    """Return share sin(x)/x + (1 - share) Si(x)/x for x > 0, shape (n, f) and (n,) -> (n, f)."""
    return _halos_from_table(x, elastic_share, sine_table())


@njit(cache=True)
def _halos_from_table(x: Array, share: Array, table: Array) -> Array:
    out = np.empty(x.shape)
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            here = x[i, j]
            out[i, j] = (share[i] * np.sin(here) + (1.0 - share[i]) * sine_integral_at(here, table)) / here
    return out


@njit(cache=True)
def _sines_from_table(x: Array, table: Array) -> Array:
    out = np.empty(x.size)
    for i in range(x.size):
        out[i] = sine_integral_at(x[i], table)
    return out


@njit(cache=True)
def _discs_from_table(x: Array, table: Array) -> Array:
    out = np.empty(x.size)
    for i in range(x.size):
        out[i] = disc_at(x[i], table)[0]
    return out


@njit(cache=True)
def sine_integral_at(x: float, table: Array) -> float:
    """Return Si(x), linear between places of the table."""
    place = x * SINE_PER_UNIT
    if place >= table.size - 1:
        return np.pi / 2 - np.cos(x) / x
    left = int(place)
    return table[left] + (table[left + 1] - table[left]) * (place - left)


@njit(cache=True)
def disc_at(x: float, table: Array) -> tuple[float, float]:
    """Return 2 J1(x)/x and its slope -2 J2(x)/x, cubic between places of the table."""
    if x >= DISC_END:
        scale = np.sqrt(2.0 / (np.pi * x)) * 2.0 / x
        one, two = x - 0.75 * np.pi, x - 1.25 * np.pi
        value = scale * (np.cos(one) - 0.375 / x * np.sin(one))
        return value, -scale * (np.cos(two) - 1.875 / x * np.sin(two))
    place = x / DISC_STEP
    left = int(place)
    t = place - left
    low, high = table[left, 0], table[left + 1, 0]
    rise, last = table[left, 1] * DISC_STEP, table[left + 1, 1] * DISC_STEP
    bend, twist = 3.0 * (high - low) - 2.0 * rise - last, rise + last - 2.0 * (high - low)
    value = low + t * (rise + t * (bend + t * twist))
    return value, (rise + t * (2.0 * bend + 3.0 * t * twist)) / DISC_STEP
