"""The compiled passes over rows: pulses drawn and decaying, noise spread over pixels, charge read with its noise.

Rows are drawn from generators of their own, keyed by seed, stage, exposure and row: a row comes out the same whoever
draws it and in whatever order, so that two threads may share a picture. The passes release the interpreter's lock.
"""

import numpy as np
from numba import njit

from simulate.iiccd.streamed.law import HALF, MANTISSA_BITS, NODES, SMALLEST

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
# A uniform number of variance 1 from 16 bits.
UNIFORM = f4(np.sqrt(12.0) * 2.0**-16)
MIDDLE = f4(32767.5)
ZERO, HALF_ONE, ONE, TWO = f4(0.0), f4(0.5), f4(1.0), f4(2.0)
# Variance of u^2 - 1, and inverse of the third moment that adding a little of it to a uniform u brings.
FOUR_FIFTHS, PER_LEAN, MOST_LEAN = f4(0.8), f4(1.0 / 2.4), f4(0.9)

FAST = {"nogil": True, "fastmath": True, "error_model": "numpy", "cache": True}


@njit(**FAST)
def _row_key(key, row):
    z = key + u8(row) * ROW_STRIDE
    z = (z ^ (z >> u8(30))) * MIX_1
    z = (z ^ (z >> u8(27))) * MIX_2
    return z ^ (z >> u8(31))


@njit(**FAST)
def _fill(key, high, low):
    """Random words of one row, two for each column."""
    for c in range(high.size):
        z = key + u8(c) * GOLDEN
        z = (z ^ (z >> u8(30))) * MIX_1
        z = (z ^ (z >> u8(27))) * MIX_2
        z = z ^ (z >> u8(31))
        high[c] = u4(z >> u8(32))
        low[c] = u4(z)


@njit(**FAST)
def _to_nearer_end(probability, nearer):
    """Distance of probabilities to 0 or 1, whichever is nearer; no less than the rarest node."""
    for c in range(nearer.size):
        rest = ONE - probability[c]
        near = probability[c] if probability[c] < rest else rest
        nearer[c] = near if near > LEAST else LEAST


@njit(**FAST)
def _looked_up(probability, nearer, rows, quantiles, out):
    """Standardised quantiles at probabilities; the bits of the distance to the nearer end are the index."""
    bits = nearer.view(np.uint32)
    for c in range(out.size):
        b = bits[c]
        j = u4(rows[c]) * PER_ROW + (b >> SHIFT) - FIRST + (u4(0) if probability[c] < HALF_ONE else LOWER)
        fraction = f4(np.int32(b & FRACTION)) * PER_FRACTION
        q = quantiles[j]
        out[c] = q + fraction * (quantiles[j + u4(1)] - q)


@njit(**FAST)
def _normal_row(words, quantiles, out, probability, nearer):
    """Standard normal numbers from random words."""
    for c in range(out.size):
        probability[c] = (f4(words[c]) + HALF_ONE) * PER_WORD
    _to_nearer_end(probability, nearer)
    bits = nearer.view(np.uint32)
    for c in range(out.size):
        b = bits[c]
        j = (b >> SHIFT) - FIRST + (u4(0) if probability[c] < HALF_ONE else LOWER)
        fraction = f4(np.int32(b & FRACTION)) * PER_FRACTION
        q = quantiles[j]
        out[c] = q + fraction * (quantiles[j + u4(1)] - q)


@njit(**FAST)
def _pulse_row(key, expected, inverse, rows, gain, law, out, split, high, low, probability, nearer):
    """One row's charge beyond its mean, and the random part of its division in time, both in electrons."""
    quantiles, shape, lateness, brightness, ions = law
    _fill(key, high, low)
    for c in range(out.size):
        probability[c] = (f4(high[c]) + HALF_ONE) * PER_WORD * inverse[c]
    _to_nearer_end(probability, nearer)
    _looked_up(probability, nearer, rows, quantiles, out)
    relative = ONE + ONE / shape
    for c in range(out.size):
        # Mean and variance of a sum that is not zero.
        mean = expected[c]
        centre = mean * inverse[c]
        charge = centre + np.sqrt(centre * (relative + mean - centre)) * out[c]
        charge = charge if probability[c] < ONE else ZERO
        uniform = (f4(np.int32(low[c] & u4(0xFFFF))) - MIDDLE) * UNIFORM
        scale = brightness * gain[c]
        split[c] = scale * charge * _scatter(abs(charge), mean, shape, lateness, uniform)
        out[c] = (charge - mean - ions) * scale


@njit(inline="always", **FAST)
def _scatter(charge, mean, shape, lateness, uniform):
    """Random scatter of a sum's pulses over the exposure, as a share of the sum: its variance and third moment.

    n pulses of gamma shape k that add up to x have a sum of squares of mean x^2 (k + 1)/(n k + 1), and of cubes
    x^3 (k + 1)(k + 2)/((n k + 1)(n k + 2)). Given x, 1/(n k + 1) is on average near
    1/(c + sqrt((k + 1 - c)^2 + k^2 m^2)),
    with m = N^(1/(k+1)) x^(k/(k+1)) and c = 1 - k/(2 (k + 1)): exact for few pulses and for many; for exponential ones
    in between it is Amos' bound on a ratio of Bessel functions (Math. Comp. 28, 239, 1974).
    """
    half = HALF_ONE * (shape - ONE) / (shape + ONE)
    # (x/N)^half by its (1, 1) Pade approximant.
    more, less = ONE + half, ONE - half
    power = (more * charge + less * mean) / (less * charge + more * mean + LEAST)
    few = ONE - HALF_ONE * shape / (shape + ONE)
    many = shape * shape * charge * mean * power * power
    pulses = few + np.sqrt((shape + ONE - few) * (shape + ONE - few) + many)
    lean = lateness * (shape + TWO) / np.sqrt(shape + ONE) * np.sqrt(pulses) / (pulses + ONE) * PER_LEAN
    # More lateness than this the few bits do not carry; screens that have it leave next to nothing.
    lean = min(lean, MOST_LEAN)
    straight = np.sqrt(ONE - FOUR_FIFTHS * lean * lean)
    return np.sqrt((shape + ONE) / pulses) * (straight * uniform + lean * (uniform * uniform - ONE))


@njit(**FAST)
def glow_rows(first, last, key, expected, inverse, rows, gain, law, ions, decay, stored, shown, coarse):
    """Draw the pulses of one exposure, cell rows first..last, and let the screen decay.

    Parameters
    ----------
    first, last
        Rows of cells, the last excluded.
    key
        Key of this exposure.
    expected, inverse, rows, gain
        Mean number of pulses, the inverse of the probability of any, the row of the law, and electrons per mean pulse,
        shape (row, col).
    law
        (quantiles, shape, lateness, brightness, ions): the law's rows, flat; gamma shape of pulses; skewness of what
        pulses leave to later exposures; factor of the gain; mean number of pulses that ions bring to a cell.
    ions
        (rows, columns, pulses) of the ion events of this exposure, each of shape (event,).
    decay
        (later, spread, kept) of each component, shape (3, component): mean share of a pulse that is stored for later,
        its standard deviation, and the share of what is stored that stays stored for one exposure more.
    stored
        Electrons still to come from each component, shape (component, row, col); changed.
    shown
        Electrons beyond the mean that come out in this exposure, shape (row, col); filled.
    coarse
        Their sums over blocks, shape (coarse row, coarse col); added to. Rows first..last are whole blocks.
    """
    cols, block = gain.shape[1], gain.shape[1] // coarse.shape[1]
    high, low = np.empty(cols, np.uint32), np.empty(cols, np.uint32)
    probability, nearer = np.empty(cols, np.float32), np.empty(cols, np.float32)
    charge, split = np.empty(cols, np.float32), np.empty(cols, np.float32)
    gathered = np.zeros(cols, np.float32)
    for r in range(first, last):
        cells = expected[r], inverse[r], rows[r], gain[r]
        _pulse_row(_row_key(key, r), *cells, law, charge, split, high, low, probability, nearer)
        for event in range(ions[0].size):
            if ions[0][event] == r:
                charge[ions[1][event]] += ions[2][event] * law[3] * gain[r, ions[1][event]]
        own = shown[r]
        own[:] = charge
        for i in range(decay.shape[1]):
            later, spread, kept = decay[0, i], decay[1, i], decay[2, i]
            released, old = ONE - kept, stored[i, r]
            for c in range(cols):
                new, before = later * charge[c] + spread * split[c], old[c]
                own[c] += released * before - new
                old[c] = kept * before + new
        for c in range(cols):
            gathered[c] += own[c]
        if (r + 1) % block == 0:
            _block_sums(gathered, block, coarse[r // block])
            gathered[:] = ZERO


@njit(**FAST)
def _block_sums(row, block, sums):
    for b in range(sums.size):
        total = ZERO
        for c in range(b * block, (b + 1) * block):
            total += row[c]
        sums[b] += total


@njit(**FAST)
def _blurred_row(shown, top, down, along, gathered, out):
    """Noise of one row of pixels: separable kernels, summed over their ranks and over the planes of cells."""
    out[:] = ZERO
    for plane in range(down.shape[0]):
        for rank in range(down.shape[1]):
            gathered[:] = ZERO
            for j in range(down.shape[2]):
                weight, cells = down[plane, rank, j], shown[plane, top + j]
                for c in range(gathered.size):
                    gathered[c] += weight * cells[c]
            for j in range(along.shape[2]):
                weight, under = along[plane, rank, j], gathered[j : j + out.size]
                for c in range(out.size):
                    out[c] += weight * under[c]


@njit(**FAST)
def charge_rows(first, last, step, key, shown, kernel, wing, light, patterns, noise, normal, charge):
    """Spread the noise over the pixels of rows first, first + step, ... and add the mean and the charge's own noise.

    Parameters
    ----------
    first, last, step
        Rows of the frame.
    key
        Key of this frame, none of whose rows is drawn twice.
    shown
        Electrons beyond the mean on cells, shape (plane, row, col); the first cell lies under the first pixel's kernel.
    kernel
        (down, along): separable kernels, shape (plane, rank, tap).
    wing
        (wide, places): what the kernel's far wing brings, on coarse rows and the frame's columns, shape (coarse row,
        col); and for every row of the frame the coarse row above it, fraction included, shape (row,).
    light
        Mean charge of the light, shape (row, col), e-.
    patterns
        (response, dark): response of the pixels, mean 1, and dark charge about its mean, e-, each of shape (row, col),
        or (1, 1) where all pixels are alike.
    noise
        (brightness, counted, variance): factor of the light; whether the charge's own noise is drawn elsewhere, as
        whole electrons; and the variance of noise besides that of the light's own charge, e-^2.
    normal
        Quantiles of the normal law.
    charge
        Filled, shape (row, col), e-.

    Returns
    -------
    float
        The largest charge.
    """
    cols = charge.shape[1]
    gathered, spread = np.empty(shown.shape[2], np.float32), np.empty(cols, np.float32)
    high, low = np.empty(cols, np.uint32), np.empty(cols, np.uint32)
    probability, nearer, own = np.empty(cols, np.float32), np.empty(cols, np.float32), np.zeros(cols, np.float32)
    (response, dark), (brightness, counted, variance) = patterns, noise
    largest = ZERO
    for r in range(first, last, step):
        _blurred_row(shown, r, kernel[0], kernel[1], gathered, spread)
        above = int(wing[1][r])
        share, upper, lower = f4(wing[1][r] - above), wing[0][above], wing[0][above + 1]
        for c in range(cols):
            spread[c] += upper[c] + share * (lower[c] - upper[c])
        if response.shape[0] > 1:
            unequal = response[r]
            for c in range(cols):
                spread[c] *= unequal[c]
        average, filled = light[r], charge[r]
        for c in range(cols):
            filled[c] = brightness * average[c] + spread[c]
        if dark.shape[0] > 1:
            pattern = dark[r]
            for c in range(cols):
                filled[c] += pattern[c]
        if not counted:
            _fill(_row_key(key, r), high, low)
            _normal_row(high, normal, own, probability, nearer)
            for c in range(cols):
                filled[c] += np.sqrt(max(filled[c] + variance, ZERO)) * own[c]
        for c in range(cols):
            largest = max(largest, filled[c])
    return largest


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
    cols, count = charge.shape[1], impulse.size + 2
    line, level = np.empty(cols + count - 1, np.float32), np.empty(cols, np.float32)
    high, low = np.empty(cols, np.uint32), np.empty(cols, np.uint32)
    probability, nearer, own = np.empty(cols, np.float32), np.empty(cols, np.float32), np.empty(cols, np.float32)
    two, weights = np.empty(2, np.float32), np.empty(count, np.float32)
    (read, jitter, offset), (gain, black, top, gamma) = noise, levels
    span = top - black
    for r in range(first, last):
        _fill(_row_key(key, r), high, low)
        _normal_row(low[: two.size], normal, two, probability[: two.size], nearer[: two.size])
        _late(impulse, jitter * two[0], gain, weights)
        inner = line[count - 2 : count - 2 + cols]
        inner[:] = charge[r]
        if read > ZERO:
            _normal_row(high, normal, own, probability, nearer)
            for c in range(cols):
                inner[c] += read * own[c]
        line[: count - 2] = inner[0]
        line[count - 2 + cols :] = inner[cols - 1]
        level[:] = ZERO
        for j in range(count):
            weight, earlier = weights[j], line[count - 1 - j : count - 1 - j + cols]
            for c in range(cols):
                level[c] += weight * earlier[c]
        if gamma != ONE:
            for c in range(cols):
                level[c] = span * np.sign(level[c]) * (abs(level[c]) / span) ** gamma
        shift, coded = black + offset * two[1] + HALF_ONE, codes[r]
        for c in range(cols):
            coded[c] = np.int32(min(max(level[c] + shift, ZERO), top))


@njit(**FAST)
def _late(impulse, late, gain, weights):
    """Weights of the next pixel, this one and those before in a line that starts late: a parabola through three."""
    ahead, behind = gain * HALF_ONE * (late * late - late), gain * HALF_ONE * (late * late + late)
    middle = gain * (ONE - late * late)
    weights[:] = ZERO
    for j in range(impulse.size):
        weights[j] += ahead * impulse[j]
        weights[j + 1] += middle * impulse[j]
        weights[j + 2] += behind * impulse[j]
