"""Compiled passes that draw pulses on cells or place them on pixels, with phosphor decay."""

import numpy as np
from numba import njit

from simulate.camera.fast_sampler.charge_rows import (
    HALF_ONE,
    LEAST,
    ONE,
    PER_WORD,
    ZERO,
    f4,
    look_up_quantiles,
    to_nearer_end,
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
MOST_LATENESS = f4(2.1)


@njit(**PART)
def _pulse_row(key, row, law, brightness, out, split, high, low, probability, nearer):
    """One row's charge beyond its mean, and the random part of its division in time, both in
    electrons.
    """
    (expected, inverse, rows, gain), (quantiles, shape, lateness, ions) = row, law
    fill_random_words(key, high, low)
    for c in range(out.size):
        probability[c] = (f4(high[c]) + HALF_ONE) * PER_WORD * inverse[c]
    to_nearer_end(probability, nearer)
    look_up_quantiles(probability, nearer, rows, quantiles, out)
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
def _likeness(charge, mean, shape):
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
        more, less = ONE + half, ONE - half
        power = (more * charge + less * mean) / (less * charge + more * mean + LEAST)
    few = ONE - HALF_ONE * shape / (shape + ONE)
    many = shape * shape * charge * mean * power * power
    return ONE / (few + np.sqrt((shape + ONE - few) * (shape + ONE - few) + many))


@njit(**PART)
def _scatter(charge, mean, shape, lateness, uniform):
    """Random scatter of a sum's pulses over the exposure, as a fraction of the sum: its variance
    and third moment.

    The sum of cubes of n pulses that add up to x is x^3 (k + 1)(k + 2)/((n k + 1)(n k + 2)) on
    average.
    """
    inverse = _likeness(charge, mean, shape)
    further = inverse / (ONE + inverse)
    # What u^2 - 1 brings leans the scatter; it takes from the rest what it adds to the variance.
    lean = min(lateness, MOST_LATENESS) * (shape + TWO) * PER_LEAN
    straight = ONE - TWO_FIFTHS * lean * lean / (shape + ONE) * further * (ONE - further)
    return straight * np.sqrt((shape + ONE) * inverse) * uniform + lean * further * (
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
    probability, nearer = np.empty(cols, np.float32), np.empty(cols, np.float32)
    charge, split = np.empty(cols, np.float32), np.empty(cols, np.float32)
    gathered = np.zeros((keys.size, cols), np.float32)
    for r in range(first, last):
        row = expected[r], inverse[r], rows[r], gain[r]
        for n in range(keys.size):
            key = row_key(keys[n], r)
            _pulse_row(key, row, law, brightness[n], charge, split, high, low, probability, nearer)
            for event in range(ions[0].size):
                if ions[0][event] == n and ions[1][event] == r:
                    c = ions[2][event]
                    charge[c] += ions[3][event] * brightness[n] * gain[r, c]
            own, sums = shown[n, plane, r], gathered[n]
            own[:] = charge
            for i in range(decay.shape[1]):
                _linger(charge, split, decay[0, i], decay[1, i], decay[2, i], stored[i, r], own)
            for c in range(cols):
                sums[c] += own[c]
            if (r + 1) % block == 0:
                _block_sums(sums, block, coarse[n, plane, r // block])
                sums[:] = ZERO


@njit(**PART)
def _linger(charge, split, later, spread, kept, old, own):
    """One phosphor component: stores part of the new pulses and emits part of the stored light."""
    released = ONE - kept
    for c in range(own.size):
        new, before = later * charge[c] + spread * split[c], old[c]
        own[c] += released * before - new
        old[c] = kept * before + new


@njit(**PART)
def _block_sums(row, block, sums):
    for b in range(sums.size):
        total = ZERO
        for c in range(b * block, (b + 1) * block):
            total += row[c]
        sums[b] = total


# Pixels that the processor adds to at once; fractions have a multiple of these columns.
ADDED_AT_ONCE = 8


@njit(**FAST)
def pulse_rows(first, last, exposure, pulses, shares, expected, decay, stored, shown):
    """Lay the pulses of one exposure on rows first..last of the frame, and let the phosphor decay.

    `exposure`: its number in the frame, of how many (row r is read from exposure r modulo those),
    and how far `shares` reach, px. `pulses`: rows and columns in fractions of a pixel, counted from
    before the frame as the kernel says; electrons; and those that come later, (component, pulse).
    `shares`: fraction of a pulse on pixels by its place, (row and col of the place, row, col).
    `expected`: mean charge of the frame by pulses, e-, and the fraction of it that each component
    stores. `decay`: fraction of what is stored that stays stored. `stored`: electrons beyond the
    mean still to come, (component, row, col), changed. `shown`: electrons beyond the mean that come
    out; filled.
    """
    (number, numbers, reach), (rows, columns, charge, later), (light, stays) = (
        exposure,
        pulses,
        expected,
    )
    places, taps, breadth = shares.shape[0], shares.shape[2], shares.shape[3]
    cols, components, further = shown.shape[1], stored.shape[0], REACH - reach
    at_once = ONE
    for i in range(components):
        at_once -= stays[i]
    for r in range(first, last):
        for c in range(cols):
            shown[r, c] = -at_once * light[r, c]
        for i in range(components):
            for c in range(cols):
                before = stored[i, r, c]
                shown[r, c] += (ONE - decay[i]) * before
                stored[i, r, c] = decay[i] * before - stays[i] * light[r, c]
    for p in range(rows.size):
        row, col = rows[p] // places, columns[p] // places
        top, left = row - taps + 1 - further, col - 2 * reach - further
        own = shares[rows[p] - row * places, columns[p] - col * places]
        now = charge[p]
        for i in range(components):
            now -= later[i, p]
        begin, end = max(top, first), min(top + taps, last)
        shows = begin + (number - begin) % numbers
        if left >= 0 and left + breadth <= cols:
            # Places that are never negative save a look at every one of them.
            for column in range(0, breadth, ADDED_AT_ONCE):
                _add_rows(shown, own, now, shows, end, numbers, top, left, column)
                for i in range(components):
                    _add_rows(stored[i], own, later[i, p], begin, end, 1, top, left, column)
        else:
            start, stop = max(left, 0), min(left + breadth, cols)
            for r in range(shows, end, numbers):
                for c in range(start, stop):
                    shown[r, c] += now * own[r - top, c - left]
            for i in range(components):
                for r in range(begin, end):
                    for c in range(start, stop):
                        stored[i, r, c] += later[i, p] * own[r - top, c - left]


@njit(**PART)
def _add_rows(image, own, charge, begin, end, step, top, left, column):
    """Add a pulse's fractions to so many columns at once of every `step`-th row."""
    for r in range(begin, end, step):
        row, line, first, second = u8(r), u8(r - top), u8(left + column), u8(column)
        for c in range(ADDED_AT_ONCE):
            image[row, first + u8(c)] += charge * own[line, second + u8(c)]


@njit(**FAST)
def cells_beyond(parts, running, guide):
    """Return the first cell whose running sum exceeds each part, shape (part,): a search that
    begins at a guide.
    """
    cells, per_guide = np.empty(parts.size, np.int64), guide.size / running[-1]
    for p in range(parts.size):
        cell = guide[min(int(parts[p] * per_guide), guide.size - 1)]
        # Rounding may put a part before its guide.
        while cell > 0 and running[cell - 1] > parts[p]:
            cell -= 1
        while cell < running.size - 1 and running[cell] <= parts[p]:
            cell += 1
        cells[p] = cell
    return cells


@njit(**FAST)
def coarse_sums(rows, columns, charge, later, side, coarse_rows, coarse_columns):
    """Sums over coarse cells of what comes out at once, then of what each component stores, shape
    (sum, row, col).
    """
    sums = np.zeros((1 + later.shape[0], coarse_rows, coarse_columns), np.float32)
    for p in range(rows.size):
        row, col, now = rows[p] // side, columns[p] // side, charge[p]
        for i in range(later.shape[0]):
            sums[1 + i, row, col] += later[i, p]
            now -= later[i, p]
        sums[0, row, col] += now
    return sums
