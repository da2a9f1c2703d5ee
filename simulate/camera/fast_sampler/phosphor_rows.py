"""Compiled passes that draw pulses on cells or place them on pixels, with phosphor decay."""

import numpy as np
from numba import njit

from simulate.camera.fast_sampler.charge_rows import (
    HALF_ONE,
    MIN_PROBABILITY,
    ONE,
    PER_WORD,
    ZERO,
    f4,
    fill_end_distance,
    look_up_quantiles,
)
from simulate.camera.fast_sampler.kernel import REACH
from simulate.camera.random_numbers import FAST, PART, fill_random_words, row_key, u4, u8

TWO = f4(2.0)

# A uniform number of variance 1 from 16 bits.
UNIFORM = f4(np.sqrt(12.0) * 2.0**-16)
MIDDLE = f4(32767.5)
# Half the variance of u^2 - 1, and inverse of the third moment that adding a little of it to a
# uniform u brings.
TWO_FIFTHS, PER_LEAN = f4(0.4), f4(1.0 / 2.4)
# More lateness than this the scatter does not carry; phosphors that have it leave next to nothing
# to later exposures.
MAX_LATENESS = f4(2.1)


@njit(**PART)
def _pulse_row(key, row, law, brightness, out, split, high, low, probability, end_distance):
    """One row's charge beyond its mean, and the random part of its division in time, both in
    electrons.
    """
    (expected, inverse, rows, gain), (quantiles, shape, lateness, ions) = row, law
    fill_random_words(key, high, low)
    for c in range(out.size):
        probability[c] = (f4(high[c]) + HALF_ONE) * PER_WORD * inverse[c]
    fill_end_distance(probability, end_distance)
    look_up_quantiles(probability, end_distance, rows, quantiles, out)
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


@njit(**PART)
def _mean_inverse_number(charge, mean, shape):
    """1/(n k + 1), on average over the numbers n of pulses of gamma shape k that may have added up
    to a charge.

    n pulses that add up to x have a sum of squares of mean x^2 (k + 1)/(n k + 1). Given x, 1/(n k +
    1) is on average near 1/(c + sqrt((k + 1 - c)^2 + k^2 m^2)), m = N^(1/(k+1)) x^(k/(k+1)), c = 1
    - k/(2 (k + 1)): exact for few pulses and for many; for exponential ones in between it is Amos'
    bound on a ratio of Bessel functions (Math. Comp. 28, 239, 1974).
    """
    half = HALF_ONE * (shape - ONE) / (shape + ONE)
    power = ONE
    if half != ZERO:
        # (x/N)^half by its (1, 1) Pade approximant.
        upper, lower = ONE + half, ONE - half
        power = (upper * charge + lower * mean) / (lower * charge + upper * mean + MIN_PROBABILITY)
    constant = ONE - HALF_ONE * shape / (shape + ONE)
    square_term = shape * shape * charge * mean * power * power
    return ONE / (
        constant + np.sqrt((shape + ONE - constant) * (shape + ONE - constant) + square_term)
    )


@njit(**PART)
def _scatter(charge, mean, shape, lateness, uniform):
    """Random scatter of a sum's pulses over the exposure, as a fraction of the sum: its variance
    and third moment.

    The sum of cubes of n pulses that add up to x is x^3 (k + 1)(k + 2)/((n k + 1)(n k + 2)) on
    average.
    """
    inverse = _mean_inverse_number(charge, mean, shape)
    complement = inverse / (ONE + inverse)
    # What u^2 - 1 brings leans the scatter; it takes from the rest what it adds to the variance.
    asymmetry = min(lateness, MAX_LATENESS) * (shape + TWO) * PER_LEAN
    linear = ONE - TWO_FIFTHS * asymmetry * asymmetry / (shape + ONE) * complement * (
        ONE - complement
    )
    return linear * np.sqrt((shape + ONE) * inverse) * uniform + asymmetry * complement * (
        uniform * uniform - ONE
    )


@njit(**FAST)
def glow_rows(first, last, plane, exposures, cells, law, ions, decay, stored, shown, coarse):
    """Draw the pulses of consecutive exposures, cell rows first..last of a plane, and let the
    phosphor decay.

    `exposures`: keys and factors of the gain. `cells`: mean number of pulses, inverse of the
    probability of any, row of the law, and electrons per mean pulse, (row, col). `law`: its rows,
    flat; gamma shape of pulses; skewness of what they leave to later exposures; mean pulses that
    ions bring to a cell. `ions`: exposure, row, column and pulses of each event. `decay`: mean
    fraction stored, its standard deviation, and fraction kept, of each component. `stored`:
    electrons still to come, (component, row, col), changed. Filled: `shown`, electrons beyond the
    mean in each exposure, (exposure, plane, row, col), and `coarse`, their sums over blocks; rows
    first..last are whole blocks.
    """
    (keys, brightness), (expected, inverse, rows, gain) = exposures, cells
    cols, block = gain.shape[1], gain.shape[1] // coarse.shape[3]
    high, low = np.empty(cols, np.uint32), np.empty(cols, np.uint32)
    probability, end_distance = np.empty(cols, np.float32), np.empty(cols, np.float32)
    charge, split = np.empty(cols, np.float32), np.empty(cols, np.float32)
    block_rows = np.zeros((keys.size, cols), np.float32)
    for r in range(first, last):
        row = expected[r], inverse[r], rows[r], gain[r]
        for n in range(keys.size):
            key = row_key(keys[n], r)
            _pulse_row(
                key, row, law, brightness[n], charge, split, high, low, probability, end_distance
            )
            for event in range(ions[0].size):
                if ions[0][event] == n and ions[1][event] == r:
                    c = ions[2][event]
                    charge[c] += ions[3][event] * brightness[n] * gain[r, c]
            emitted, sums = shown[n, plane, r], block_rows[n]
            for c in range(cols):
                emitted[c] = charge[c]
            for i in range(decay.shape[1]):
                _decay_component(
                    charge, split, decay[0, i], decay[1, i], decay[2, i], stored[i, r], emitted
                )
            for c in range(cols):
                sums[c] += emitted[c]
            if (r + 1) % block == 0:
                _block_sums(sums, block, coarse[n, plane, r // block])
                sums[:] = ZERO


@njit(**PART)
def _decay_component(charge, split, stored_fraction, spread, kept_fraction, stored, emitted):
    """One phosphor component: stores part of the new pulses and emits part of the stored light."""
    emitted_fraction = ONE - kept_fraction
    for c in range(emitted.size):
        increase, previous = stored_fraction * charge[c] + spread * split[c], stored[c]
        emitted[c] += emitted_fraction * previous - increase
        stored[c] = kept_fraction * previous + increase


@njit(**PART)
def _block_sums(row, block, sums):
    for b in range(sums.size):
        total = ZERO
        for c in range(b * block, (b + 1) * block):
            total += row[c]
        sums[b] = total


# Pixels that the processor adds to at once; fractions have a multiple of these columns.
VECTOR_COLUMNS = 8


@njit(**FAST)
def pulse_rows(first, last, exposure, pulses, fractions, expected, decay, stored, shown):
    """Lay the pulses of one exposure on rows first..last of the frame, and let the phosphor decay.

    `exposure`: its number in the frame, of how many (row r is read from exposure r modulo those),
    and the half-width of `fractions`, px. `pulses`: rows and columns in fractions of a pixel,
    counted from before the frame as the kernel says; electrons; and those that each component
    stores, (component, pulse). `fractions`: fraction of a pulse on pixels by its position, (row and
    col of the position, row, col).
    `expected`: mean charge of the frame by pulses, e-, and the fraction of it that each component
    stores. `decay`: fraction of what is stored that stays stored. `stored`: electrons beyond the
    mean still to come, (component, row, col), changed. `shown`: electrons beyond the mean that come
    out; filled.
    """
    (
        (number, n_exposures, half_width),
        (rows, columns, charge, stored_charge),
        (light, stored_fractions),
    ) = (
        exposure,
        pulses,
        expected,
    )
    divisions, taps, n_columns = fractions.shape[0], fractions.shape[2], fractions.shape[3]
    cols, components, margin = shown.shape[1], stored.shape[0], REACH - half_width
    emitted_fraction = ONE
    for i in range(components):
        emitted_fraction -= stored_fractions[i]
    for r in range(first, last):
        for c in range(cols):
            shown[r, c] = -emitted_fraction * light[r, c]
        for i in range(components):
            for c in range(cols):
                previous = stored[i, r, c]
                shown[r, c] += (ONE - decay[i]) * previous
                stored[i, r, c] = decay[i] * previous - stored_fractions[i] * light[r, c]
    for p in range(rows.size):
        row, col = rows[p] // divisions, columns[p] // divisions
        top_row, first_col = row - taps + 1 - margin, col - 2 * half_width - margin
        pulse = fractions[rows[p] - row * divisions, columns[p] - col * divisions]
        emitted = charge[p]
        for i in range(components):
            emitted -= stored_charge[i, p]
        start_row, stop_row = max(top_row, first), min(top_row + taps, last)
        first_shown = start_row + (number - start_row) % n_exposures
        if first_col >= 0 and first_col + n_columns <= cols:
            # Places that are never negative save a look at every one of them.
            for column in range(0, n_columns, VECTOR_COLUMNS):
                _add_rows(
                    shown,
                    pulse,
                    emitted,
                    first_shown,
                    stop_row,
                    n_exposures,
                    top_row,
                    first_col,
                    column,
                )
                for i in range(components):
                    _add_rows(
                        stored[i],
                        pulse,
                        stored_charge[i, p],
                        start_row,
                        stop_row,
                        1,
                        top_row,
                        first_col,
                        column,
                    )
        else:
            start, stop = max(first_col, 0), min(first_col + n_columns, cols)
            for r in range(first_shown, stop_row, n_exposures):
                for c in range(start, stop):
                    shown[r, c] += emitted * pulse[r - top_row, c - first_col]
            for i in range(components):
                for r in range(start_row, stop_row):
                    for c in range(start, stop):
                        stored[i, r, c] += stored_charge[i, p] * pulse[r - top_row, c - first_col]


@njit(**PART)
def _add_rows(image, pulse, charge, start_row, stop_row, step, top_row, first_col, column):
    """Add a pulse's fractions to so many columns at once of every `step`-th row."""
    for r in range(start_row, stop_row, step):
        row, line, image_col, pulse_col = u8(r), u8(r - top_row), u8(first_col + column), u8(column)
        for c in range(VECTOR_COLUMNS):
            image[row, image_col + u8(c)] += charge * pulse[line, pulse_col + u8(c)]


@njit(**FAST)
def find_cells(sums, running_sum, guide):
    """Return the first cell whose running sum exceeds each sum, shape (sum,): a search that
    begins at a guide.
    """
    cells, per_guide = np.empty(sums.size, np.int64), guide.size / running_sum[-1]
    for p in range(sums.size):
        cell = guide[min(int(sums[p] * per_guide), guide.size - 1)]
        # Rounding may put a sum before its guide.
        while cell > 0 and running_sum[cell - 1] > sums[p]:
            cell -= 1
        while cell < running_sum.size - 1 and running_sum[cell] <= sums[p]:
            cell += 1
        cells[p] = cell
    return cells


@njit(**FAST)
def coarse_sums(rows, columns, charge, stored_charge, side, coarse_rows, coarse_columns):
    """Sums over coarse cells of what comes out at once, then of what each component stores, shape
    (sum, row, col).
    """
    sums = np.zeros((1 + stored_charge.shape[0], coarse_rows, coarse_columns), np.float32)
    for p in range(rows.size):
        row, col, emitted = rows[p] // side, columns[p] // side, charge[p]
        for i in range(stored_charge.shape[0]):
            sums[1 + i, row, col] += stored_charge[i, p]
            emitted -= stored_charge[i, p]
        sums[0, row, col] += emitted
    return sums
