"""Transfers turned by phases, compiled: what shifts and bends an edge spread."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True)
def apply_phases(modulus: Array, turns: Array, fixed: Array) -> Array:
    """Return transfers delayed by phases, real and imaginary parts side by side, shape (n, 2 node).

    Parameters
    ----------
    modulus
        Shape (n, node).
    turns
        Phase by which each node is late, shape (n, node), in turns: shift times frequency.
    fixed
        Known part of the transfer, real and imaginary, shape (2, node).

    Notes
    -----
    Sine and cosine are their series within an eighth of a turn, to the last digit but one: a processor takes several
    of these at a time, and none of a library's.
    """
    count, size = modulus.shape
    out = np.empty((count, 2 * size))
    for i in range(count):
        for j in range(size):
            quarters = 4.0 * turns[i, j]
            whole = math.floor(quarters + 0.5)
            sine, cosine = _series((quarters - whole) * (0.5 * math.pi))
            half = math.floor(0.5 * whole)
            sign = 1.0 - 2.0 * (half - 2.0 * math.floor(0.5 * half))
            crossed = whole != 2.0 * half
            real = sign * (-sine if crossed else cosine)
            imaginary = sign * (cosine if crossed else sine)
            out[i, j] = modulus[i, j] * (fixed[0, j] * real + fixed[1, j] * imaginary)
            out[i, size + j] = modulus[i, j] * (fixed[1, j] * real - fixed[0, j] * imaginary)
    return out


@njit(cache=True, inline="always")
def _series(angle: float) -> tuple[float, float]:
    """Return sine and cosine of an angle of at most an eighth of a turn, rad, by Taylor's series."""
    square = angle * angle
    sine = 1.0 - square * (1.0 / 210.0)
    cosine = 1.0 - square * (1.0 / 240.0)
    sine, cosine = 1.0 - square * (1.0 / 156.0) * sine, 1.0 - square * (1.0 / 182.0) * cosine
    sine, cosine = 1.0 - square * (1.0 / 110.0) * sine, 1.0 - square * (1.0 / 132.0) * cosine
    sine, cosine = 1.0 - square * (1.0 / 72.0) * sine, 1.0 - square * (1.0 / 90.0) * cosine
    sine, cosine = 1.0 - square * (1.0 / 42.0) * sine, 1.0 - square * (1.0 / 56.0) * cosine
    sine, cosine = 1.0 - square * (1.0 / 20.0) * sine, 1.0 - square * (1.0 / 30.0) * cosine
    sine, cosine = 1.0 - square * (1.0 / 6.0) * sine, 1.0 - square * (1.0 / 12.0) * cosine
    return angle * sine, 1.0 - 0.5 * square * cosine
