"""Normal numbers that fill their space evenly: quantiles of a few hundred scatter half as much as random ones'."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

Array = NDArray[np.float64]

# Bases of the sequence's columns; parameters beyond them are drawn at random, for large bases repeat each other.
BASES = (2, 3, 5, 7, 11, 13)
# Further points are those of the sequence again, shifted anew.
LONGEST = 8192


def quasi_random_normals(rng: np.random.Generator, count: int, parameters: int) -> Array:
    """Return independent standard normal numbers, shape (count, parameter), the first columns the most even.

    Parameters
    ----------
    rng
        Shifts the sequence, each column by its own amount, and draws what the sequence does not reach.

    Notes
    -----
    Halton's sequence (Halton 1960, doi 10.1007/BF01386213), shifted modulo one (Cranley & Patterson 1976,
    doi 10.1137/0713071), through the inverse of the normal distribution. Any first part of it is even too.
    """
    if count > LONGEST:
        parts = [quasi_random_normals(rng, min(LONGEST, count - done), parameters) for done in range(0, count, LONGEST)]
        return np.concatenate(parts)
    even = min(parameters, len(BASES))
    shares = (_halton()[:count, :even] + rng.random(even)) % 1.0
    normal = ndtri(np.maximum(shares, np.finfo(float).tiny))
    return np.concatenate([normal, rng.standard_normal((count, parameters - even))], axis=1)


@lru_cache(maxsize=1)
def _halton() -> Array:
    """Return the sequence, shape (point, base): the digits of 1, 2, 3... in a base, mirrored at the point."""
    out = np.zeros((LONGEST, len(BASES)))
    for column, base in enumerate(BASES):
        rest, place = np.arange(1, LONGEST + 1), 1.0
        while rest.any():
            place /= base
            rest, digit = np.divmod(rest, base)
            out[:, column] += place * digit
    return out
