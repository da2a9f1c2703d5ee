"""Compiled samplers of cell images: compound photoelectron pulses and Poisson charge.

The generator is xoshiro256++ (Blackman and Vigna, ACM TOMS 47, 36, 2021), started from the caller's
`numpy.random.Generator`, and compiled together with the draws: a call through NumPy's interface for every one of a
million cells costs several times more than the draws themselves.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

# Mean above which counts are drawn by transformed rejection instead of by searching the distribution.
SEARCH_BELOW = 12.0
# Mean above which the charge of a pixel is drawn from a normal law: its skewness is then below 0.04.
NORMAL_ABOVE = 1000.0
TWO_TO_MINUS_32 = 1.0 / 4294967296.0
TWO_TO_MINUS_53 = 1.0 / 9007199254740992.0


def state_from(rng: np.random.Generator) -> NDArray[np.uint64]:
    """Return a fresh state of the compiled generator, shape (4,)."""
    return rng.integers(1, 2**64, size=4, dtype=np.uint64, endpoint=False)


@njit(cache=True, inline="always")
def _rotate_left(value, bits):
    return (value << np.uint64(bits)) | (value >> np.uint64(64 - bits))


@njit(cache=True, inline="always")
def _next(s):
    """Sixty-four random bits."""
    result = _rotate_left(s[0] + s[3], 23) + s[0]
    carried = s[1] << np.uint64(17)
    s[2] ^= s[0]
    s[3] ^= s[1]
    s[1] ^= s[2]
    s[0] ^= s[3]
    s[2] ^= carried
    s[3] = _rotate_left(s[3], 45)
    return result


@njit(cache=True, inline="always")
def _uniform(s):
    """A uniform number in (0, 1)."""
    return (np.float64(_next(s) >> np.uint64(11)) + 0.5) * TWO_TO_MINUS_53


@njit(cache=True)
def _normal(s):
    """A standard normal number, by the polar method."""
    while True:
        x = 2.0 * _uniform(s) - 1.0
        y = 2.0 * _uniform(s) - 1.0
        square = x * x + y * y
        if 0.0 < square < 1.0:
            return x * np.sqrt(-2.0 * np.log(square) / square)


@njit(cache=True)
def _gamma(s, shape):
    """A gamma number of unit scale (Marsaglia and Tsang, ACM TOMS 26, 363, 2000)."""
    if shape <= 0.0:
        return 0.0
    boost = 1.0
    if shape < 1.0:
        boost = _uniform(s) ** (1.0 / shape)
        shape += 1.0
    d = shape - 1.0 / 3.0
    c = 1.0 / np.sqrt(9.0 * d)
    while True:
        x = _normal(s)
        v = (1.0 + c * x) ** 3
        if v > 0.0 and np.log(_uniform(s)) < 0.5 * x * x + d - d * v + d * np.log(v):
            return boost * d * v


@njit(cache=True)
def _log_factorial(k):
    if k < 10.0:
        total = 0.0
        for j in range(2, int(k) + 1):
            total += np.log(np.float64(j))
        return total
    inverse = 1.0 / (k + 1.0)
    square = inverse * inverse
    series = inverse * (1.0 / 12.0 - square * (1.0 / 360.0 - square / 1260.0))
    return (k + 0.5) * np.log(k + 1.0) - (k + 1.0) + 0.9189385332046728 + series


@njit(cache=True)
def _large_poisson(s, mean):
    """A Poisson number of mean above 10 by transformed rejection (Hörmann, Insurance Math. Econ. 12, 39, 1993)."""
    root = np.sqrt(mean)
    log_mean = np.log(mean)
    b = 0.931 + 2.53 * root
    a = -0.059 + 0.02483 * b
    inverse_alpha = 1.1239 + 1.1328 / (b - 3.4)
    squeeze = 0.9277 - 3.6224 / (b - 2.0)
    while True:
        u = _uniform(s) - 0.5
        v = _uniform(s)
        us = 0.5 - abs(u)
        k = np.floor((2.0 * a / us + b) * u + mean + 0.43)
        if us >= 0.07 and v <= squeeze:
            return k
        if k < 0.0 or (us < 0.013 and v > us):
            continue
        if np.log(v * inverse_alpha / (a / (us * us) + b)) <= -mean + k * log_mean - _log_factorial(k):
            return k


@njit(cache=True)
def _small_poisson(s, mean, none):
    """A Poisson number by inversion; `none` is the probability of zero, exp(-mean)."""
    u = _uniform(s)
    count, term, total = 0.0, none, none
    while u > total and count < 100.0:
        count += 1.0
        term *= mean / count
        total += term
    return count


@njit(cache=True)
def _sum_as_product(s, count):
    """exp of minus the sum of a few exponential numbers of mean 1: a product of uniform numbers, two from one draw."""
    product, done = 1.0, 0
    while done < count:
        bits = _next(s)
        product *= (np.float64(bits >> np.uint64(32)) + 0.5) * TWO_TO_MINUS_32
        done += 1
        if done < count:
            product *= (np.float64(bits & np.uint64(0xFFFFFFFF)) + 0.5) * TWO_TO_MINUS_32
            done += 1
    return product


@njit(cache=True)
def _pulses(s, mean, shape, out):
    """Fill `out` with exp(-sum) where few exponential pulses fell, else with minus the sum."""
    last, none = -1.0, 1.0
    for i in range(mean.size):
        expected = np.float64(mean[i])
        if expected <= 0.0:
            out[i] = 1.0
            continue
        if expected < SEARCH_BELOW:
            # Means that differ by rounding alone share one exponential function.
            if abs(expected - last) > 1e-6 * expected:
                last, none = expected, np.exp(-expected)
            count = _small_poisson(s, expected, none)
        else:
            count = _large_poisson(s, expected)
        if count == 0.0:
            out[i] = 1.0
        elif shape == 1.0 and count <= 24.0:
            out[i] = _sum_as_product(s, count)
        else:
            out[i] = -_gamma(s, count * shape) / shape


def pulse_sums(rng: np.random.Generator, mean: NDArray[np.float32], shape: float) -> NDArray[np.float32]:
    """Return sums of Poisson(mean) pulses, each of mean height 1 and gamma shape `shape`, of the mean's shape.

    The sum of n such pulses is gamma(n shape)/shape, exactly. Means below zero have no pulses.
    """
    sums = np.empty(mean.shape, np.float32)
    _pulses(state_from(rng), np.ascontiguousarray(mean, np.float32).ravel(), float(shape), sums.reshape(-1))
    # NumPy takes a million logarithms together in a tenth of the time that they take one by one.
    few = sums > 0.0
    return np.where(few, -np.log(sums, where=few, out=np.zeros_like(sums)), -sums)


def gamma_numbers(rng: np.random.Generator, shape: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return gamma numbers of unit scale, of the shapes given; 0 where a shape is not positive."""
    numbers = np.empty(shape.shape, np.float32)
    _gammas(state_from(rng), np.ascontiguousarray(shape, np.float32).ravel(), numbers.reshape(-1))
    return numbers


@njit(cache=True)
def _gammas(s, shape, out):
    for i in range(shape.size):
        out[i] = _gamma(s, np.float64(shape[i]))


def poisson_charge(rng: np.random.Generator, mean: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return Poisson numbers of the means given, of their shape; normal and rounded above `NORMAL_ABOVE`."""
    many = mean > NORMAL_ABOVE
    charge = np.empty(mean.shape, np.float32)
    if many.any():
        np.rint(mean + np.sqrt(np.maximum(mean, 0.0)) * rng.standard_normal(mean.shape, np.float32), out=charge)
    if not many.all():
        few = np.ascontiguousarray(mean[~many], np.float32)
        counts = np.empty_like(few)
        _charge(state_from(rng), few, counts)
        charge[~many] = counts
    return charge


@njit(cache=True)
def _charge(s, mean, out):
    last, none = -1.0, 1.0
    for i in range(mean.size):
        expected = np.float64(mean[i])
        if expected <= 0.0:
            out[i] = 0.0
        elif expected < SEARCH_BELOW:
            if abs(expected - last) > 1e-6 * expected:
                last, none = expected, np.exp(-expected)
            out[i] = _small_poisson(s, expected, none)
        else:
            out[i] = _large_poisson(s, expected)
