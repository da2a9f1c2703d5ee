"""What a digitiser's steps do to the mean of frames whose noise is smaller than they are."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Variance that rounding to whole codes adds where noise spreads over several, DN^2.
QUANTISATION_DN2 = 1.0 / 12.0

# Places of black between two codes that are gone through, terms of the sawtooth's series, and shifts that count, DN.
PLACES, TERMS, COUNTS_DN = 8, 6, 1e-3


def rounding_shifts(level_dn: Array, variance_dn2: Array) -> Array:
    """Return by how much rounding to whole codes may shift means, shape (place, pixel), DN; if it does not, no places.

    Parameters
    ----------
    level_dn
        Means as they would be without rounding, shape (pixel,).
    variance_dn2
        Variances of one frame's values as rounded, shape (pixel,).

    Notes
    -----
    The mean of a value x with normal noise of standard deviation s is off by
    sum_k (-1)^k sin(2 pi k x) exp(-2 (pi k s)^2) / (pi k), the Fourier series of the sawtooth (Widrow & Kollar,
    Quantization Noise, 2008). Where x lies between codes is not known well enough: black is put at several places
    between two codes, each as likely. The noise is the least that rounding may leave with such a variance.
    """
    from charact.noise.rounding import EVEN_DN2

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
    """Variances as rounded, and the least that they may come of, DN^2."""
    from charact.noise.rounding import EVEN_DN2, variance_range_before_rounding

    rounded = np.linspace(0.0, EVEN_DN2, 91)
    return rounded, np.array([variance_range_before_rounding(float(one))[0] for one in rounded])
