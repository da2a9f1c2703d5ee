"""Tables of the special functions that transfers are made of, compiled: Si, 2 J1(x)/x, and the
transform of a Moffat spread.
"""

from functools import lru_cache

import numpy as np
from numba import njit

from labdata import Array

# ln(f/f2), 1/b, ln of the transfer at them, and (b - 1) ln(x2/2) at 1/b, x2 = 2 pi a f2.
MoffatTable = tuple[Array, Array, Array, Array]

# Exponents b of the table of the Moffat spread (1 + r^2/a^2)^-b: cubic between its nodes it is
# within 1e-6 from 1.1 on, linear within 5e-5 from 1.2 on.
MOFFAT_EXPONENTS = (1.05, 8.5)
# Nodes of the table of Si in a unit, and where it ends; beyond it its expansion is off by less than
# 1e-7.
SINE_PER_UNIT, SINE_END = 25, 400.0
# Step and end of the table of a disc's transfer; beyond it Hankel's expansion is off by less than
# 1e-6.
DISC_STEP, DISC_END = 0.02, 400.0


def ln_bessel_transfer(x: Array, order: Array | float) -> Array:
    """Return ln of 2^(1-m)/Gamma(m) x^m K_m(x), the transform of (1 + r^2/a^2)^-(m+1) at x = 2 pi a
    f.
    """
    from scipy.special import gammaln, kve

    ln = (1.0 - order) * np.log(2.0) - gammaln(order) + order * np.log(x)
    return np.minimum(ln + np.log(kve(order, x)) - x, 0.0)


@lru_cache(maxsize=1)
def moffat_table() -> MoffatTable:
    """Return the table of the Moffat spread, which its last part scales to a radius."""
    ln_ratios = np.linspace(np.log(1e-5), np.log(1e4), 1700)
    inverse = np.linspace(1.0 / MOFFAT_EXPONENTS[1], 1.0 / MOFFAT_EXPONENTS[0], 120)
    ln_argument, rows, scales = np.linspace(np.log(1e-4), np.log(10.0), 600), [], []
    for order in 1.0 / inverse - 1.0:
        ln_half, places = 0.0, ln_argument
        for _ in range(2):
            falling = -ln_bessel_transfer(np.exp(places), order)
            ln_half = float(np.interp(np.log(2.0), falling, places))
            places = ln_half + np.linspace(-0.02, 0.02, 41)
        rows.append(ln_bessel_transfer(np.exp(ln_ratios + ln_half), order))
        scales.append(order * (ln_half - np.log(2.0)))
    return ln_ratios, inverse, np.ascontiguousarray(rows), np.array(scales)


@njit(cache=True)
def moffat_grid(ratio: Array, exponent: Array, table: MoffatTable) -> Array:
    """Return what `moffat_at` does for ln(f/f2), shape (n, f), and exponents, shape (n,): shape (3,
    n, f).
    """
    out = np.empty((3, *ratio.shape))
    for i in range(ratio.shape[0]):
        for j in range(ratio.shape[1]):
            out[0, i, j], out[1, i, j], out[2, i, j] = moffat_at(ratio[i, j], exponent[i], table)
    return out


@njit(cache=True)
def moffat_at(ratio: float, exponent: float, table: MoffatTable) -> tuple[float, float, float]:
    """Return ln of the transfer at ln(f/f2), and its slopes with ln(f/f2) and with the exponent.

    Far below f2 it is too small for the table's first column to matter.
    """
    ln_ratios, inverse, ln, _ = table
    row = min(
        max((1.0 / exponent - inverse[0]) / (inverse[1] - inverse[0]), 0.0), inverse.size - 1.0
    )
    low = min(int(row), inverse.size - 2)
    step = ln_ratios[1] - ln_ratios[0]
    column = min(max((ratio - ln_ratios[0]) / step, 0.0), ln_ratios.size - 1.001)
    node = int(column)
    row_part, column_part = row - low, column - node
    lower_row = ln[low, node] * (1.0 - column_part) + ln[low, node + 1] * column_part
    upper_row = ln[low + 1, node] * (1.0 - column_part) + ln[low + 1, node + 1] * column_part
    rise = (ln[low, node + 1] - ln[low, node]) * (1.0 - row_part) + (
        ln[low + 1, node + 1] - ln[low + 1, node]
    ) * row_part
    by_exponent = (lower_row - upper_row) / (exponent**2 * (inverse[1] - inverse[0]))
    return lower_row * (1.0 - row_part) + upper_row * row_part, rise / step, by_exponent


def sine_integral(x: Array) -> Array:
    """Return Si(x), x > 0 of any shape, cubic between nodes of a table."""
    return _sine_integrals(np.ravel(x), _sine_table()).reshape(np.shape(x))


def disc(x: Array) -> Array:
    """Return 2 J1(x)/x and its slope -2 J2(x)/x, x >= 0, shape (...) -> (2, ...), cubic between
    nodes of a table.
    """
    return _discs(np.ravel(x), _disc_table()).reshape(2, *np.shape(x))


@lru_cache(maxsize=1)
def _sine_table() -> Array:
    """Return Si by Simpson's rule and its slope sin x/x at nodes from 0 on, shape (node, 2)."""
    x = np.linspace(0.0, SINE_END, int(SINE_END) * SINE_PER_UNIT + 1)
    middle = 0.5 * (x[1:] + x[:-1])
    step = x[1] - x[0]
    ends, inner = np.sinc(x / np.pi), np.sinc(middle / np.pi)
    sums = np.cumsum((ends[1:] + 4.0 * inner + ends[:-1]) * step / 6.0)
    return np.stack([np.append(0.0, sums), ends], axis=1)


@njit(cache=True)
def _sine_integrals(x: Array, table: Array) -> Array:
    out = np.empty(x.size)
    for i in range(x.size):
        position = x[i] * SINE_PER_UNIT
        if position >= len(table) - 1:
            out[i] = np.pi / 2 - np.cos(x[i]) / x[i] - np.sin(x[i]) / x[i] ** 2
        else:
            node = int(position)
            t = position - node
            low, high = table[node, 0], table[node + 1, 0]
            rise, last = table[node, 1] / SINE_PER_UNIT, table[node + 1, 1] / SINE_PER_UNIT
            bend, twist = 3.0 * (high - low) - 2.0 * rise - last, rise + last - 2.0 * (high - low)
            out[i] = low + t * (rise + t * (bend + t * twist))
    return out


@lru_cache(maxsize=1)
def _disc_table() -> Array:
    """Return 2 J1(x)/x and its slope at nodes from 0 on, `DISC_STEP` apart, shape (node, 2)."""
    from scipy.special import j1, jn

    x = np.maximum(np.arange(0.0, DISC_END + 2.0 * DISC_STEP, DISC_STEP), 1e-9)
    return np.stack([2.0 * j1(x) / x, -2.0 * jn(2, x) / x], axis=1)


@njit(cache=True)
def _discs(x: Array, table: Array) -> Array:
    out = np.empty((2, x.size))
    for i in range(x.size):
        if x[i] >= DISC_END:
            scale = np.sqrt(2.0 / (np.pi * x[i])) * 2.0 / x[i]
            zero, first = x[i] - 0.75 * np.pi, x[i] - 1.25 * np.pi
            out[0, i] = scale * (np.cos(zero) - 0.375 / x[i] * np.sin(zero))
            out[1, i] = -scale * (np.cos(first) - 1.875 / x[i] * np.sin(first))
            continue
        node = int(x[i] / DISC_STEP)
        t = x[i] / DISC_STEP - node
        low, high = table[node, 0], table[node + 1, 0]
        rise, last = table[node, 1] * DISC_STEP, table[node + 1, 1] * DISC_STEP
        bend, twist = 3.0 * (high - low) - 2.0 * rise - last, rise + last - 2.0 * (high - low)
        out[0, i] = low + t * (rise + t * (bend + t * twist))
        out[1, i] = (rise + t * (2.0 * bend + 3.0 * t * twist)) / DISC_STEP
    return out
