"""Compiled passes over rows of pixels: random numbers, spread of the noise, charge and readout."""

import numpy as np
from numba import njit

from simulate.camera.fast_sampler.charge_distribution import HALF, MANTISSA_BITS, NODES, SMALLEST
from simulate.camera.random_numbers import FAST, PART, fill_random_words, row_key, u4

f4 = np.float32
SHIFT = u4(23 - MANTISSA_BITS)
FRACTION = u4((1 << (23 - MANTISSA_BITS)) - 1)
PER_FRACTION = f4(1.0 / (1 << (23 - MANTISSA_BITS)))
FIRST = u4(int(np.float32(SMALLEST).view(np.uint32)) >> (23 - MANTISSA_BITS))
LOWER, PER_ROW = u4(HALF), u4(NODES)
LEAST = f4(SMALLEST)
PER_WORD = f4(2.0**-32)
ZERO, HALF_ONE, ONE = f4(0.0), f4(0.5), f4(1.0)


@njit(**PART)
def to_nearer_end(probability, nearer):
    """Distance of probabilities to 0 or 1, whichever is nearer; no less than the rarest node."""
    for c in range(nearer.size):
        rest = ONE - probability[c]
        near = probability[c] if probability[c] < rest else rest
        nearer[c] = near if near > LEAST else LEAST


@njit(**PART)
def look_up_quantiles(probability, nearer, rows, quantiles, out):
    """Standardised quantiles at probabilities; the bits of the distance to the nearer end are the
    index.
    """
    bits = nearer.view(np.uint32)
    for c in range(out.size):
        b = bits[c]
        j = (
            u4(rows[c]) * PER_ROW
            + (b >> SHIFT)
            - FIRST
            + (u4(0) if probability[c] < HALF_ONE else LOWER)
        )
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


@njit(**FAST)
def charge_rows(
    first, last, key, shown, kernel, wing, mean, response, noise, normal, readout, charge, codes
):
    """Spread the noise over the pixels of rows first..last, add the mean and the charge's own
    noise; read them.

    `shown`: electrons beyond the mean on cells, (exposure, plane, row, col), the first cell under
    the first pixel's kernel; row r is read from exposure r modulo their number. `kernel`: separable
    kernels down and along, (plane, rank, tap). `wing`: what its far wing brings, on coarse rows and
    the frame's columns, and the coarse row above each row of the frame, fraction included. `mean`:
    mean charge, e-, that of the dark left out. `response`: of the pixels, or (1, 1). `noise`:
    whether the charge's own noise is drawn elsewhere, as whole electrons, and the variance of noise
    besides that of the mean charge. `normal`: quantiles of the normal law. `readout`: whether rows
    are read later, by `read_rows`, and its arguments. Filled: `charge`, e-, where rows are read
    later, else `codes`. Returns the largest charge.
    """
    cols = mean.shape[1]
    gathered, spread = np.empty(shown.shape[3], np.float32), np.empty(cols, np.float32)
    high, low, probability, nearer, own = row_buffers(cols)
    counted, variance = noise
    apart, read_key, impulse, read_noise, levels = readout
    line, level, taps = line_buffers(cols, impulse)
    largest = ZERO
    for r in range(first, last):
        exposure, above = r % shown.shape[0], int(wing[1][r])
        _blur_row(shown[exposure], r, kernel[0], kernel[1], gathered, spread)
        share = f4(wing[1][r] - above)
        upper, lower = wing[0][exposure, above], wing[0][exposure, above + 1]
        for c in range(cols):
            spread[c] += upper[c] + share * (lower[c] - upper[c])
        if response.shape[0] > 1:
            unequal = response[r]
            for c in range(cols):
                spread[c] *= unequal[c]
        average = mean[r]
        for c in range(cols):
            spread[c] += average[c]
        if not counted:
            fill_random_words(row_key(key, r), high, low)
            normal_row(high, normal, own, probability, nearer)
            for c in range(cols):
                spread[c] += np.sqrt(max(spread[c] + variance, ZERO)) * own[c]
        if apart:
            charge[r] = spread
            for c in range(cols):
                largest = max(largest, spread[c])
        else:
            line[taps.size - 2 : taps.size - 2 + cols] = spread
            fill_random_words(row_key(read_key, r), high[:2], low[:2])
            normal_row(high[:2], normal, own[:2], probability[:2], nearer[:2])
            read_line(line, impulse, own[:2], read_noise, levels, taps, level, codes[r])
    return largest


@njit(**PART)
def _blur_row(shown, top, down, along, gathered, out):
    """Noise of one row of pixels: separable kernels, summed over their ranks and over the planes of
    cells.
    """
    out[:] = ZERO
    for plane in range(down.shape[0]):
        for rank in range(down.shape[1]):
            weights, cells = down[plane, rank], shown[plane, top : top + down.shape[2]]
            gathered[:] = ZERO
            whole = weights.size - weights.size % 4
            for j in range(0, whole, 4):
                _add_four(gathered, weights, j, cells, 0)
            for j in range(whole, weights.size):
                weight, row = weights[j], cells[j]
                for c in range(gathered.size):
                    gathered[c] += weight * row[c]
            add_correlation(gathered, along[plane, rank], out)


@njit(**PART)
def _add_four(out, weights, first, rows, start):
    """Add four weighted stretches at once, so that the sum stays in registers."""
    size = out.size
    w0, w1, w2, w3 = weights[first], weights[first + 1], weights[first + 2], weights[first + 3]
    a, b = rows[first, start : start + size], rows[first + 1, start : start + size]
    c, d = rows[first + 2, start : start + size], rows[first + 3, start : start + size]
    for i in range(size):
        out[i] += w0 * a[i] + w1 * b[i] + w2 * c[i] + w3 * d[i]


@njit(**FAST)
def interpolate_columns(coarse, left, right, share, wide):
    """Fill images (image, row + 1, col) from coarse ones between two columns each; the last row is
    repeated.
    """
    for n in range(coarse.shape[0]):
        for r in range(wide.shape[1]):
            cells, out = coarse[n, min(r, coarse.shape[1] - 1)], wide[n, r]
            for c in range(out.size):
                before = cells[left[c]]
                out[c] = before + share[c] * (cells[right[c]] - before)


@njit(**FAST)
def read_rows(first, last, key, charge, impulse, noise, levels, normal, codes):
    """Read rows first..last of a charge, e-, through the amplifier and its filter into whole codes.

    `impulse`: impulse response along a line. `noise`: standard deviations of reading a pixel, e-,
    of the start of a line, pixels, and of an offset common to it, DN. `levels`: DN per electron, DN
    without charge, highest code, gamma.
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
    """Buffers for the random numbers of a line, at least two."""
    size = max(cols, 2)
    words, numbers = np.empty((2, size), np.uint32), np.empty((3, size), np.float32)
    return words[0], words[1], numbers[0], numbers[1], numbers[2]


@njit(**PART)
def line_buffers(cols, impulse):
    """Buffers for a line extended by its filter length, for its level and for its taps."""
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
    """Read one line: line jitter, filter, gain, offset and digitiser."""
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
    """Filter taps of a line delayed by jitter: a parabola through three pixels."""
    ahead, behind = gain * HALF_ONE * (late * late - late), gain * HALF_ONE * (late * late + late)
    middle = gain * (ONE - late * late)
    taps[:] = ZERO
    last = taps.size - 1
    for j in range(impulse.size):
        taps[last - j] += ahead * impulse[j]
        taps[last - j - 1] += middle * impulse[j]
        taps[last - j - 2] += behind * impulse[j]
