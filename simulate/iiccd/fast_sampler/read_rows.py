"""The compiled pass that reads rows of charge: amplifier and filter, noise of reading, lines that start late, codes."""

import numpy as np
from numba import njit

from simulate.iiccd.fast_sampler.random_rows import (
    FAST,
    HALF_ONE,
    ONE,
    PART,
    ZERO,
    fill_random_words,
    normal_row,
    row_key,
)


@njit(**FAST)
def read_rows(first, last, key, charge, impulse, noise, levels, normal, codes):
    """Read rows first..last through the amplifier and its filter into whole codes.

    Parameters
    ----------
    first, last
        Rows of the frame.
    key
        Key of this frame.
    charge
        Charge, shape (row, col), e-.
    impulse
        Impulse response along a line, shape (tap,).
    noise
        (read, jitter, offset): standard deviations of reading a pixel, e-, of the start of a line, pixels, and of an
        offset common to a line, DN.
    levels
        (gain, black, top, gamma): DN per electron, DN without charge, highest code, exponent.
    normal
        Quantiles of the normal law.
    codes
        Filled, shape (row, col).
    """
    cols = charge.shape[1]
    line, level, taps = line_buffers(cols, impulse)
    high, low, probability, nearer, own = row_buffers(cols)
    two = np.empty(2, np.float32)
    for r in range(first, last):
        fill_random_words(row_key(key, r), high, low)
        normal_row(low[:2], normal, two, probability[:2], nearer[:2])
        normal_row(high, normal, own, probability, nearer)
        inner = line[taps.size - 2 : taps.size - 2 + cols]
        for c in range(cols):
            inner[c] = charge[r, c] + noise[0] * own[c]
        read_line(line, impulse, two, noise, levels, taps, level, codes[r])


@njit(**PART)
def row_buffers(cols):
    """Room for the random numbers of a line, two of which are drawn for the line itself, however short it is."""
    size = max(cols, 2)
    words, numbers = np.empty((2, size), np.uint32), np.empty((3, size), np.float32)
    return words[0], words[1], numbers[0], numbers[1], numbers[2]


@njit(**PART)
def line_buffers(cols, impulse):
    """Room for a line with the pixels that its filter reaches back to and one beyond, its level, and its taps."""
    taps = np.empty(impulse.size + 2, np.float32)
    return np.empty(cols + taps.size - 1, np.float32), np.empty(cols, np.float32), taps


@njit(**PART)
def add_correlation(line, weights, out):
    """Add sum_j weights[j] line[c + j] to out[c], four taps at once."""
    whole, size = weights.size - weights.size % 4, out.size
    for j in range(0, whole, 4):
        w0, w1, w2, w3 = weights[j], weights[j + 1], weights[j + 2], weights[j + 3]
        p, q = line[j : j + size], line[j + 1 : j + 1 + size]
        r, s = line[j + 2 : j + 2 + size], line[j + 3 : j + 3 + size]
        for c in range(size):
            out[c] += w0 * p[c] + w1 * q[c] + w2 * r[c] + w3 * s[c]
    for j in range(whole, weights.size):
        weight, part = weights[j], line[j : j + size]
        for c in range(size):
            out[c] += weight * part[c]


@njit(**PART)
def read_line(line, impulse, two, noise, levels, taps, level, coded):
    """Read the charge that stands inside a line: late start, filter, gain, offset and digitiser."""
    gain, black, top, gamma = levels
    reach, cols = taps.size - 2, level.size
    line[:reach] = line[reach]
    line[reach + cols :] = line[reach + cols - 1]
    _late(impulse, noise[1] * two[0], gain, taps)
    level[:] = ZERO
    add_correlation(line, taps, level)
    if gamma != ONE:
        span = top - black
        for c in range(cols):
            level[c] = span * np.sign(level[c]) * (abs(level[c]) / span) ** gamma
    shift = black + noise[2] * two[1] + HALF_ONE
    for c in range(cols):
        coded[c] = np.int32(min(max(level[c] + shift, ZERO), top))


@njit(**PART)
def _late(impulse, late, gain, taps):
    """Weights of the oldest pixel to the next one, in a line that starts late: a parabola through three pixels."""
    ahead, behind = gain * HALF_ONE * (late * late - late), gain * HALF_ONE * (late * late + late)
    middle = gain * (ONE - late * late)
    taps[:] = ZERO
    last = taps.size - 1
    for j in range(impulse.size):
        taps[last - j] += ahead * impulse[j]
        taps[last - j - 1] += middle * impulse[j]
        taps[last - j - 2] += behind * impulse[j]
