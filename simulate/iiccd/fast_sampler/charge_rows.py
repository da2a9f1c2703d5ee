"""The compiled pass over rows of pixels: noise of the cells spread over them, the mean and the charge's own added."""

import numpy as np
from numba import njit

from simulate.iiccd.fast_sampler.random_rows import FAST, PART, ZERO, f4, fill_random_words, normal_row, row_key
from simulate.iiccd.fast_sampler.read_rows import add_correlation, line_buffers, read_line, row_buffers


@njit(**FAST)
def charge_rows(first, last, key, shown, kernel, wing, mean, response, noise, normal, readout, charge, codes):
    """Spread the noise over the pixels of rows first..last, add the mean and the charge's own noise; read them.

    Parameters
    ----------
    first, last
        Rows of the frame; row r is read from exposure r modulo the number of exposures.
    key
        Key of this frame, none of whose rows is drawn twice.
    shown
        Electrons beyond the mean on cells, shape (exposure, plane, row, col); the first cell lies under the first
        pixel's kernel.
    kernel
        (down, along): separable kernels, shape (plane, rank, tap).
    wing
        (wide, places): what the kernel's far wing brings, on coarse rows and the frame's columns, shape (exposure,
        coarse row, col); and for every row of the frame the coarse row above it, fraction included, shape (row,).
    mean
        Mean charge, shape (row, col), e-, the dark charge's own mean left out.
    response
        Response of the pixels, mean 1, of shape (row, col), or (1, 1) where all pixels are alike.
    noise
        (counted, variance): whether the charge's own noise is drawn elsewhere, as whole electrons; and the variance of
        noise besides that of the mean charge, e-^2.
    normal
        Quantiles of the normal law.
    readout
        (apart, key, impulse, noise, levels): whether rows are read later, by `read_rows`; else its arguments.
    charge, codes
        One of them is filled, shape (row, col): charge, e-, where rows are read later, else codes.

    Returns
    -------
    float
        The largest charge.
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
    """Noise of one row of pixels: separable kernels, summed over their ranks and over the planes of cells."""
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
    """Fill images (image, row + 1, col) from coarse ones between two columns each; the last row is repeated."""
    for n in range(coarse.shape[0]):
        for r in range(wide.shape[1]):
            cells, out = coarse[n, min(r, coarse.shape[1] - 1)], wide[n, r]
            for c in range(out.size):
                before = cells[left[c]]
                out[c] = before + share[c] * (cells[right[c]] - before)
