"""Effect of quantisation on the mean of frames whose noise is below one step."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Variance that quantisation adds where noise spreads over several steps, DN^2.
QUANTISATION_DN2 = 1.0 / 12.0

# Places of black between two codes that are gone through, terms of the sawtooth's series, and shifts that count, DN.
PLACES, TERMS, COUNTS_DN = 8, 6, 1e-3


def rounding_shifts(level_dn: Array, variance_dn2: Array) -> Array:
    """Return the possible shifts of mean values by quantisation, shape (offset, pixel), DN; no rows if negligible.

    Parameters
    ----------
    level_dn
        Means without quantisation, shape (pixel,).
    variance_dn2
        Variances of single quantised values, shape (pixel,).

    Notes
    -----
    The mean of a value x with normal noise of standard deviation s is shifted by sum_k (-1)^k sin(2 pi k x) exp(-2 (pi
    k s)^2) / (pi k), the Fourier series of the sawtooth (Widrow & Kollar, Quantization Noise, 2008). The fractional
    part of x is unknown: the black level is placed at several equally likely offsets between two steps. The noise is
    the smallest that is consistent with the variance.
    """
    from charact.noise.snr.rounding import EVEN_DN2

    least = np.interp(variance_dn2, *_least_noise())
    noise = np.where(variance_dn2 > EVEN_DN2, variance_dn2 - QUANTISATION_DN2, least)
    if np.exp(-2.0 * np.pi**2 * float(noise.min())) / np.pi < COUNTS_DN:
        return np.empty((0, level_dn.size))
    out = np.zeros((PLACES, level_dn.size))
    for term in range(1, TERMS + 1):
        size = (-1.0) ** term * np.exp(-2.0 * (np.pi * term) ** 2 * noise) / (np.pi * term)
        turns = term * (level_dn + np.arange(PLACES)[:, None] / PLACES)
        out += size * np.sin(2.0 * np.pi * turns)
    return out


@cache
def _least_noise() -> tuple[Array, Array]:
    """Return variances after quantisation and the smallest variances before it, DN^2."""
    from charact.noise.snr.rounding import EVEN_DN2, unrounded_variance_range

    rounded = np.linspace(0.0, EVEN_DN2, 91)
    return rounded, np.array([unrounded_variance_range(float(one))[0] for one in rounded])
