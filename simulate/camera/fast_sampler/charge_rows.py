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
MIN_PROBABILITY = f4(SMALLEST)
PER_WORD = f4(2.0**-32)
ZERO, HALF_ONE, ONE = f4(0.0), f4(0.5), f4(1.0)


@njit(**PART)
def fill_end_distance(probability, end_distance):
    """Distance of probabilities to 0 or 1, whichever is nearer; no less than the rarest node."""
    for c in range(end_distance.size):
        complement = ONE - probability[c]
        distance = probability[c] if probability[c] < complement else complement
        end_distance[c] = distance if distance > MIN_PROBABILITY else MIN_PROBABILITY


@njit(**PART)
def look_up_quantiles(probability, end_distance, rows, quantiles, out):
    """Standardised quantiles at probabilities; the bits of the distance to the nearer end are the
    index.
    """
    bits = end_distance.view(np.uint32)
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
def normal_row(words, quantiles, out, probability, end_distance):
    """Standard normal numbers from random words."""
    for c in range(out.size):
        probability[c] = (f4(words[c]) + HALF_ONE) * PER_WORD
    fill_end_distance(probability, end_distance)
    bits = end_distance.view(np.uint32)
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
    column_sum, electrons = np.empty(shown.shape[3], np.float32), np.empty(cols, np.float32)
    high, low, probability, end_distance, normals = row_buffers(cols)
    counts_electrons, variance = noise
    reads_later, read_key, impulse, read_noise, levels = readout
    line, level, taps = line_buffers(cols, impulse)
    largest = ZERO
    for r in range(first, last):
        exposure, wing_row = r % shown.shape[0], int(wing[1][r])
        _blur_row(shown[exposure], r, kernel[0], kernel[1], column_sum, electrons)
        fraction = f4(wing[1][r] - wing_row)
        upper, lower = wing[0][exposure, wing_row], wing[0][exposure, wing_row + 1]
        for c in range(cols):
            electrons[c] += upper[c] + fraction * (lower[c] - upper[c])
        if response.shape[0] > 1:
            row_response = response[r]
            for c in range(cols):
                electrons[c] *= row_response[c]
        row_mean = mean[r]
        for c in range(cols):
            electrons[c] += row_mean[c]
        if not counts_electrons:
            fill_random_words(row_key(key, r), high, low)
            normal_row(high, normal, normals, probability, end_distance)
            for c in range(cols):
                electrons[c] += np.sqrt(max(electrons[c] + variance, ZERO)) * normals[c]
        # Loops: an assignment of arrays compiles the sentence of an error as well.
        if reads_later:
            for c in range(cols):
                charge[r, c] = electrons[c]
                largest = max(largest, electrons[c])
        else:
            for c in range(cols):
                line[taps.size - 2 + c] = electrons[c]
            fill_random_words(row_key(read_key, r), high[:2], low[:2])
            normal_row(high[:2], normal, normals[:2], probability[:2], end_distance[:2])
            read_line(line, impulse, normals[:2], read_noise, levels, taps, level, codes[r])
    return largest


@njit(**PART)
def _blur_row(shown, first_row, row_kernels, column_kernels, column_sum, out):
    """Noise of one row of pixels: separable kernels, summed over their ranks and over the planes of
    cells.
    """
    out[:] = ZERO
    for plane in range(row_kernels.shape[0]):
        for rank in range(row_kernels.shape[1]):
            weights, cells = (
                row_kernels[plane, rank],
                shown[plane, first_row : first_row + row_kernels.shape[2]],
            )
            column_sum[:] = ZERO
            n_in_fours = weights.size - weights.size % 4
            for j in range(0, n_in_fours, 4):
                _add_four(column_sum, weights, j, cells, 0)
            for j in range(n_in_fours, weights.size):
                weight, row = weights[j], cells[j]
                for c in range(column_sum.size):
                    column_sum[c] += weight * row[c]
            add_correlation(column_sum, column_kernels[plane, rank], out)


@njit(**PART)
def _add_four(out, weights, first, rows, start):
    """Add four weighted rows at once, so that the sum stays in registers."""
    size = out.size
    w0, w1, w2, w3 = weights[first], weights[first + 1], weights[first + 2], weights[first + 3]
    a, b = rows[first, start : start + size], rows[first + 1, start : start + size]
    c, d = rows[first + 2, start : start + size], rows[first + 3, start : start + size]
    for i in range(size):
        out[i] += w0 * a[i] + w1 * b[i] + w2 * c[i] + w3 * d[i]


@njit(**FAST)
def interpolate_columns(coarse, left, right, fraction, images):
    """Fill images (image, row + 1, col) from coarse ones between two columns each; the last row is
    repeated.
    """
    for n in range(coarse.shape[0]):
        for r in range(images.shape[1]):
            cells, out = coarse[n, min(r, coarse.shape[1] - 1)], images[n, r]
            for c in range(out.size):
                left_value = cells[left[c]]
                out[c] = left_value + fraction[c] * (cells[right[c]] - left_value)


@njit(**FAST)
def read_rows(first, last, key, charge, impulse, noise, levels, normal, codes):
    """Read rows first..last of a charge, e-, through the amplifier and its filter into whole codes.

    `impulse`: impulse response along a line. `noise`: standard deviations of reading a pixel, e-,
    of the start of a line, pixels, and of an offset common to it, DN. `levels`: DN per electron, DN
    without charge, highest code, gamma.
    """
    cols = charge.shape[1]
    line, level, taps = line_buffers(cols, impulse)
    high, low, probability, end_distance, normals = row_buffers(cols)
    line_noise = np.empty(2, np.float32)
    for r in range(first, last):
        fill_random_words(row_key(key, r), high, low)
        normal_row(low[:2], normal, line_noise, probability[:2], end_distance[:2])
        normal_row(high, normal, normals, probability, end_distance)
        inner = line[taps.size - 2 : taps.size - 2 + cols]
        for c in range(cols):
            inner[c] = charge[r, c] + noise[0] * normals[c]
        read_line(line, impulse, line_noise, noise, levels, taps, level, codes[r])


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
    n_in_fours, size = weights.size - weights.size % 4, out.size
    for j in range(0, n_in_fours, 4):
        w0, w1, w2, w3 = weights[j], weights[j + 1], weights[j + 2], weights[j + 3]
        p, q = line[j : j + size], line[j + 1 : j + 1 + size]
        r, s = line[j + 2 : j + 2 + size], line[j + 3 : j + 3 + size]
        for c in range(size):
            out[c] += w0 * p[c] + w1 * q[c] + w2 * r[c] + w3 * s[c]
    for j in range(n_in_fours, weights.size):
        weight, shifted = weights[j], line[j : j + size]
        for c in range(size):
            out[c] += weight * shifted[c]


@njit(**PART)
def read_line(line, impulse, line_noise, noise, levels, taps, level, row_codes):
    """Read one line: line jitter, filter, gain, offset and digitiser."""
    gain, black, max_code, gamma = levels
    extension, cols = taps.size - 2, level.size
    line[:extension] = line[extension]
    line[extension + cols :] = line[extension + cols - 1]
    _delayed_taps(impulse, noise[1] * line_noise[0], gain, taps)
    level[:] = ZERO
    add_correlation(line, taps, level)
    if gamma != ONE:
        span = max_code - black
        for c in range(cols):
            level[c] = span * np.sign(level[c]) * (abs(level[c]) / span) ** gamma
    shift = black + noise[2] * line_noise[1] + HALF_ONE
    for c in range(cols):
        row_codes[c] = np.int32(min(max(level[c] + shift, ZERO), max_code))


@njit(**PART)
def _delayed_taps(impulse, delay, gain, taps):
    """Filter taps of a line delayed by jitter: a parabola through three pixels."""
    next_weight, previous_weight = (
        gain * HALF_ONE * (delay * delay - delay),
        gain * HALF_ONE * (delay * delay + delay),
    )
    centre_weight = gain * (ONE - delay * delay)
    taps[:] = ZERO
    last_tap = taps.size - 1
    for j in range(impulse.size):
        taps[last_tap - j] += next_weight * impulse[j]
        taps[last_tap - j - 1] += centre_weight * impulse[j]
        taps[last_tap - j - 2] += previous_weight * impulse[j]
