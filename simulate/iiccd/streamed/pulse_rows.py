"""The compiled pass that lays single pulses on pixels, each from its own place, row by row."""

from numba import njit

from simulate.iiccd.streamed.kernel import REACH
from simulate.iiccd.streamed.random_rows import FAST, ONE, PART

BREADTH = 2 * REACH + 1


@njit(**FAST)
def pulse_rows(first, last, exposure, pulses, shares, expected, decay, stored, shown):
    """Lay the pulses of one exposure on rows first..last of the frame, and let the screen decay.

    Parameters
    ----------
    first, last
        Rows of the frame, the last excluded.
    exposure
        (number, numbers): which exposure of the frame it is, of how many; row r is read from exposure r modulo those.
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
    (number, numbers), (rows, columns, charge, later), (light, stays) = exposure, pulses, expected
    places, taps, breadth = shares.shape[0], shares.shape[2], shares.shape[3]
    cols, components = shown.shape[1], stored.shape[0]
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
        top, left = row - taps + 1, col - breadth + 1
        own = shares[rows[p] - row * places, columns[p] - col * places]
        now = charge[p]
        for i in range(components):
            now -= later[i, p]
        inside = left >= 0 and left + BREADTH <= cols
        start, stop = max(left, 0), min(left + breadth, cols)
        for r in range(max(top, first), min(top + taps, last)):
            line = own[r - top]
            if r % numbers == number:
                if inside:
                    _add(shown[r, left : left + BREADTH], line, now)
                else:
                    for c in range(start, stop):
                        shown[r, c] += now * line[c - left]
            for i in range(components):
                if inside:
                    _add(stored[i, r, left : left + BREADTH], line, later[i, p])
                else:
                    for c in range(start, stop):
                        stored[i, r, c] += later[i, p] * line[c - left]


@njit(**PART)
def _add(row, line, charge):
    for c in range(BREADTH):
        row[c] += charge * line[c]
