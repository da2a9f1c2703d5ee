"""The transfer of a Moffat spread by table, compiled: ln of it, linear between close steps in ln(f/f2) and 1/b."""

from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
MoffatTable = tuple[Array, Array, Array]

# Exponent b of a Moffat spread (1 + r^2/a^2)^-b: 3/2 is a Lorentzian whose transfer is exp(-f), infinity a Gaussian.
MOFFAT_EXPONENT = (1.2, 8.0)


def moffat(frequency: Array, half_frequency: Array, exponent: Array) -> Array:
    """Return ln of the transfer of a Moffat spread, shape (f,) or (n, f), (n,), (n,) -> (n, f).

    Notes
    -----
    The two-dimensional transform of (1 + r^2/a^2)^-b is 2^(2-b)/Gamma(b-1) x^(b-1) K_(b-1)(x), x = 2 pi a f.
    """
    ratio = np.log(np.maximum(frequency, 1e-12)) - np.log(half_frequency)[:, None]
    return _moffats_from_table(ratio, np.ascontiguousarray(exponent, float), moffat_table())


@lru_cache(maxsize=1)
def moffat_table() -> MoffatTable:
    """Return ln(f/f2), 1/b and ln of the transfer at them, shape (1/b, ln(f/f2))."""
    from scipy.special import gammaln, kve

    places = np.linspace(np.log(1e-5), np.log(300.0), 1400)
    inverse = np.linspace(1.0 / (MOFFAT_EXPONENT[1] + 0.5), 1.0 / (MOFFAT_EXPONENT[0] - 0.05), 80)
    wide = np.exp(np.linspace(np.log(1e-7), np.log(1e4), 6000))
    rows = []
    for order in 1.0 / inverse - 1.0:
        log = (1.0 - order) * np.log(2.0) - gammaln(order) + order * np.log(wide)
        log = np.minimum(log + np.log(kve(order, wide)) - wide, 0.0)
        half = np.exp(np.interp(np.log(2.0), -log, np.log(wide)))
        rows.append(np.interp(places + np.log(half), np.log(wide), log))
    return places, inverse, np.ascontiguousarray(rows)


@njit(cache=True)
def _moffats_from_table(ratio: Array, exponent: Array, table: MoffatTable) -> Array:
    out = np.empty(ratio.shape)
    for i in range(ratio.shape[0]):
        for j in range(ratio.shape[1]):
            out[i, j] = moffat_at(ratio[i, j], exponent[i], table)[0]
    return out


@njit(cache=True)
def moffat_at(ratio: float, exponent: float, table: MoffatTable) -> tuple[float, float, float]:
    """Return ln of the transfer at ln(f/f2), and its slopes with ln(f/f2) and with the exponent.

    Far below f2 it is too small for the table's first column to matter.
    """
    places, inverse, ln = table
    row = min(max((1.0 / exponent - inverse[0]) / (inverse[1] - inverse[0]), 0.0), inverse.size - 1.0)
    low = min(int(row), inverse.size - 2)
    step = places[1] - places[0]
    column = min(max((ratio - places[0]) / step, 0.0), places.size - 1.001)
    left = int(column)
    share, rest = row - low, column - left
    one = ln[low, left] * (1.0 - rest) + ln[low, left + 1] * rest
    other = ln[low + 1, left] * (1.0 - rest) + ln[low + 1, left + 1] * rest
    rise = (ln[low, left + 1] - ln[low, left]) * (1.0 - share) + (ln[low + 1, left + 1] - ln[low + 1, left]) * share
    by_exponent = (one - other) / (exponent**2 * (inverse[1] - inverse[0]))
    return one * (1.0 - share) + other * share, rise / step, by_exponent
