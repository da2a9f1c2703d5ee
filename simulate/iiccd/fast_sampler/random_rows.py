"""Random numbers of a row, compiled: words of a generator of its own, and what a table of quantiles makes of them.

Rows are drawn from generators of their own, keyed by seed, stage, exposure and row: a row comes out the same whoever
draws it and in whatever order, so that two threads may share a picture. The passes release the interpreter's lock.
"""

import numpy as np
from numba import njit

from simulate.iiccd.fast_sampler.charge_distribution import HALF, MANTISSA_BITS, NODES, SMALLEST

f4, u4, u8 = np.float32, np.uint32, np.uint64
# SplitMix64 (Steele, Lea and Flood, OOPSLA 2014), one stream a row.
GOLDEN, MIX_1, MIX_2 = u8(0x9E3779B97F4A7C15), u8(0xBF58476D1CE4E5B9), u8(0x94D049BB133111EB)
ROW_STRIDE = u8(0xD1342543DE82EF95)
SHIFT = u4(23 - MANTISSA_BITS)
FRACTION = u4((1 << (23 - MANTISSA_BITS)) - 1)
PER_FRACTION = f4(1.0 / (1 << (23 - MANTISSA_BITS)))
FIRST = u4(int(np.float32(SMALLEST).view(np.uint32)) >> (23 - MANTISSA_BITS))
LOWER, PER_ROW = u4(HALF), u4(NODES)
LEAST = f4(SMALLEST)
PER_WORD = f4(2.0**-32)
ZERO, HALF_ONE, ONE, TWO = f4(0.0), f4(0.5), f4(1.0), f4(2.0)

FAST = {"nogil": True, "fastmath": True, "error_model": "numpy", "cache": True}
# What a pass is made of becomes part of it: a function by itself is compiled once more for a pass that comes from the
# cache, and rounds otherwise, so that a first run would not draw the frames of the next.
PART = {"inline": "always", **FAST}


@njit(**PART)
def row_key(key, row):
    z = key + u8(row) * ROW_STRIDE
    z = (z ^ (z >> u8(30))) * MIX_1
    z = (z ^ (z >> u8(27))) * MIX_2
    return z ^ (z >> u8(31))


@njit(**PART)
def fill_random_words(key, high, low):
    """Random words of one row, two for each column."""
    for c in range(high.size):
        z = key + u8(c) * GOLDEN
        z = (z ^ (z >> u8(30))) * MIX_1
        z = (z ^ (z >> u8(27))) * MIX_2
        z = z ^ (z >> u8(31))
        high[c] = u4(z >> u8(32))
        low[c] = u4(z)


@njit(**PART)
def to_nearer_end(probability, nearer):
    """Distance of probabilities to 0 or 1, whichever is nearer; no less than the rarest node."""
    for c in range(nearer.size):
        rest = ONE - probability[c]
        near = probability[c] if probability[c] < rest else rest
        nearer[c] = near if near > LEAST else LEAST


@njit(**PART)
def look_up_quantiles(probability, nearer, rows, quantiles, out):
    """Standardised quantiles at probabilities; the bits of the distance to the nearer end are the index."""
    bits = nearer.view(np.uint32)
    for c in range(out.size):
        b = bits[c]
        j = u4(rows[c]) * PER_ROW + (b >> SHIFT) - FIRST + (u4(0) if probability[c] < HALF_ONE else LOWER)
        fraction = f4(np.int32(b & FRACTION)) * PER_FRACTION
        q = quantiles[j]
        out[c] = q + fraction * (quantiles[j + u4(1)] - q)


@njit(**PART)
def normal_row(words, quantiles, out, probability, nearer):
    """Standard normal numbers from random words."""
    for c in range(out.size):
        probability[c] = (f4(words[c]) + HALF_ONE) * PER_WORD
    to_nearer_end(probability, nearer)
    bits = nearer.view(np.uint32)
    for c in range(out.size):
        b = bits[c]
        j = (b >> SHIFT) - FIRST + (u4(0) if probability[c] < HALF_ONE else LOWER)
        fraction = f4(np.int32(b & FRACTION)) * PER_FRACTION
        q = quantiles[j]
        out[c] = q + fraction * (quantiles[j + u4(1)] - q)
