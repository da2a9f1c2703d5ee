"""The compiled random generator, and whole numbers of electrons drawn with it.

SplitMix64 by counter (Steele, Lea and Flood, OOPSLA 2014): the random words of a place follow from
a key and the place, so that rows may be drawn in any order and by any thread.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulate.camera.grid import ACCURACY

u4, u8 = np.uint32, np.uint64
GOLDEN, ROW_STRIDE = u8(0x9E3779B97F4A7C15), u8(0xD1342543DE82EF95)
# A double in [0, 1) has this many bits.
PER_DOUBLE = 2.0**-53
FAST = {"nogil": True, "fastmath": True, "error_model": "numpy", "cache": True}
# What a pass is made of becomes part of it: a function by itself is compiled once more for a pass
# that comes from the cache, and rounds otherwise, so that a first run would not draw the frames of
# the next.
PART = {"inline": "always", **FAST}


@njit(**PART)
def mix(z):
    """Sixty-four random bits from a counter."""
    z = (z ^ (z >> u8(30))) * u8(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> u8(27))) * u8(0x94D049BB133111EB)
    return z ^ (z >> u8(31))


@njit(**PART)
def row_key(key, row):
    """Key of one row."""
    return mix(key + u8(row) * ROW_STRIDE)


@njit(**PART)
def fill_random_words(key, high, low):
    """Random words of one row, two for each column."""
    for c in range(high.size):
        z = mix(key + u8(c) * GOLDEN)
        high[c] = u4(z >> u8(32))
        low[c] = u4(z)


def key_of(seed: int, purpose: int, number: int) -> np.uint64:
    """Return the key of the random generator of one exposure."""
    # Exposures before the first frame, whose light it still shows, have numbers below zero; seeds
    # may not.
    return np.random.SeedSequence([seed, purpose, number + 2**32]).generate_state(1, np.uint64)[0]


def poisson_numbers(key: np.uint64, mean: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return Poisson numbers of the means given, of their shape; 0 where a mean is not positive."""
    numbers = np.empty(mean.shape, np.float32)
    _fill_poisson(
        key,
        np.ascontiguousarray(mean, np.float32).ravel(),
        numbers.reshape(-1),
        ACCURACY.max_counted_e,
    )
    return numbers


@njit(cache=True)
def _uniform(key, count):
    """A uniform number in (0, 1)."""
    return (np.float64(mix(key + u8(count) * ROW_STRIDE) >> u8(11)) + 0.5) * PER_DOUBLE


@njit(cache=True, nogil=True)
def _fill_poisson(key, mean, out, max_mean):
    last_mean, p_zero = -1.0, 1.0
    for i in range(mean.size):
        expected, pixel_key = np.float64(mean[i]), mix(key + u8(i) * GOLDEN)
        if expected <= 0.0:
            out[i] = 0.0
        elif expected > max_mean:
            # Box and Muller's normal number with the skewness of a Poisson law (Cornish and Fisher
            # 1938), rounded: the variances of the square, 1/18, and of rounding, 1/12, are taken
            # off.
            radius = np.sqrt(-2.0 * np.log(_uniform(pixel_key, 1)))
            normal = radius * np.cos(2.0 * np.pi * _uniform(pixel_key, 2))
            out[i] = np.floor(
                expected
                + np.sqrt(expected - 5.0 / 36.0) * normal
                + (normal * normal - 1.0) / 6.0
                + 0.5
            )
        elif expected < 12.0:
            # Means that differ by rounding alone share one exponential function.
            if abs(expected - last_mean) > 1e-6 * expected:
                last_mean, p_zero = expected, np.exp(-expected)
            count, term, total, u = 0.0, p_zero, p_zero, _uniform(pixel_key, 1)
            while u > total and count < 100.0:
                count += 1.0
                term *= expected / count
                total += term
            out[i] = count
        else:
            out[i] = _large_poisson(pixel_key, expected)


@njit(cache=True)
def _large_poisson(key, mean):
    """A Poisson number of mean above 10 by transformed rejection (Hörmann, Insurance Math. Econ.
    12, 39, 1993).
    """
    root = np.sqrt(mean)
    b = 0.931 + 2.53 * root
    a = -0.059 + 0.02483 * b
    inverse_alpha = 1.1239 + 1.1328 / (b - 3.4)
    squeeze = 0.9277 - 3.6224 / (b - 2.0)
    count = 0
    while True:
        u, v = _uniform(key, count) - 0.5, _uniform(key, count + 1)
        count += 2
        us = 0.5 - abs(u)
        k = np.floor((2.0 * a / us + b) * u + mean + 0.43)
        if us >= 0.07 and v <= squeeze:
            return k
        if k < 0.0 or (us < 0.013 and v > us):
            continue
        if np.log(v * inverse_alpha / (a / (us * us) + b)) <= -mean + k * np.log(
            mean
        ) - _log_factorial(k):
            return k


@njit(cache=True)
def _log_factorial(k):
    """Stirling's series."""
    inverse = 1.0 / (k + 1.0)
    square = inverse * inverse
    series = inverse * (1.0 / 12.0 - square * (1.0 / 360.0 - square / 1260.0))
    return (k + 0.5) * np.log(k + 1.0) - (k + 1.0) + 0.5 * np.log(2.0 * np.pi) + series
