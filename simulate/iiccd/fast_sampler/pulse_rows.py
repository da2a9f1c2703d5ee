"""The compiled pass that lays single pulses on pixels, each from its own place, row by row."""

import numpy as np
from numba import njit

from simulate.iiccd.fast_sampler.kernel import REACH
from simulate.iiccd.fast_sampler.random_rows import FAST, ONE, PART, u8

# Pixels that the processor adds to at once; shares have a multiple of these columns.
ADDED_AT_ONCE = 8


@njit(**FAST)
def pulse_rows(first, last, exposure, pulses, shares, expected, decay, stored, shown):
    """Lay the pulses of one exposure on rows first..last of the frame, and let the screen decay.

    Parameters
    ----------
    first, last
        Rows of the frame, the last excluded.
    exposure
        (number, numbers, reach): which exposure of the frame it is, of how many; row r is read from exposure r modulo
        those; and how far the shares reach, px.
    pulses
        (rows, columns, charge, later): places in fractions of a pixel, counted from before the frame as the kernel
        says, shape (pulse,); electrons; and those that come later, shape (component, pulse).
    shares
        Share of a pulse on pixels by its place, shape (row of the place, col of the place, row, col).
    expected
        (light, later): mean charge by which pulses light the frame, shape (row, col), e-, and the share of it that
        each component stores, shape (component,).
    decay
        Share of what is stored that stays stored for one exposure more, shape (component,).
    stored
        Electrons still to come beyond the mean, shape (component, row, col); changed.
    shown
        Electrons beyond the mean that come out in this exposure, shape (row, col); the rows read from it are filled.
    """
    (number, numbers, reach), (rows, columns, charge, later), (light, stays) = exposure, pulses, expected
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
    """Add a pulse's shares to so many columns at once of every `step`-th row."""
    for r in range(begin, end, step):
        row, line, first, second = u8(r), u8(r - top), u8(left + column), u8(column)
        for c in range(ADDED_AT_ONCE):
            image[row, first + u8(c)] += charge * own[line, second + u8(c)]


@njit(**FAST)
def cells_beyond(parts, running, guide):
    """Return the first cell whose running sum exceeds each part, shape (part,): a search that begins at a guide."""
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
    """Sums over coarse cells of what comes out at once, then of what each component stores, shape (sum, row, col)."""
    sums = np.zeros((1 + later.shape[0], coarse_rows, coarse_columns), np.float32)
    for p in range(rows.size):
        row, col, now = rows[p] // side, columns[p] // side, charge[p]
        for i in range(later.shape[0]):
            sums[1 + i, row, col] += later[i, p]
            now -= later[i, p]
        sums[0, row, col] += now
    return sums
