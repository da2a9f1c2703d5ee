"""Noise of a digital read-out that is not white: offsets of rows, neighbours along a row,
interference.
"""

import numpy as np
from numpy.typing import NDArray

# Most pixels by which the start of a frame lags the phase of an interfering clock.
LATEST_START_PX = 1024


def draw_row_offsets(
    rng: np.random.Generator, rows: int, density_dn2: float, exponent: float
) -> NDArray[np.float32]:
    """Return one frame's offset of each row, DN, shape (row, 1), of the spectral density s (4
    f)^-a.

    Parameters
    ----------
    rng
        Generator of the frame.
    rows
        Rows of the frame.
    density_dn2
        s, the density at f = 0.25 cy/row, DN^2; the variance of white offsets.
    exponent
        a, 0 for white offsets.

    Notes
    -----
    Drawn on twice the rows, so that the first and last row are no neighbours. Offsets that change
    more slowly than within four frames are left out: the density at f = 0 is that of 1/8 of a cycle
    per frame.
    """
    length = 2 * rows
    white = rng.standard_normal(length)
    if exponent == 0.0:
        return (np.sqrt(density_dn2) * white[:rows, None]).astype(np.float32)
    frequency = np.fft.rfftfreq(length)
    frequency[0] = 0.25 / length
    offsets = np.fft.irfft(np.fft.rfft(white) * (4.0 * frequency) ** (-0.5 * exponent), length)
    return (np.sqrt(density_dn2) * offsets[:rows, None]).astype(np.float32)


def draw_read_noise(
    rng: np.random.Generator, shape: tuple[int, ...], fine_ratio: float
) -> NDArray[np.float32]:
    """Return noise of unit variance, shape (..., row, col), of a given ratio of densities along
    rows.

    Notes
    -----
    The density 1 + 2 r cos(2 pi f) of a moving average of two pixels with the neighbour correlation
    r; its ratio q of 0.5 to 0 cy/px is (1 - 2 r)/(1 + 2 r).
    """
    if fine_ratio == 1.0:
        return rng.standard_normal(shape, dtype=np.float32)
    correlation = neighbour_correlation(fine_ratio)
    low, high = np.sqrt(1.0 + 2.0 * correlation), np.sqrt(1.0 - 2.0 * correlation)
    white = rng.standard_normal((*shape[:-1], shape[-1] + 1), dtype=np.float32)
    same_row, previous_row = np.float32(0.5 * (low + high)), np.float32(0.5 * (low - high))
    return (same_row * white[..., 1:] + previous_row * white[..., :-1]).astype(np.float32)


def neighbour_correlation(fine_ratio: float) -> float:
    """Return the correlation of neighbours along a row, (1 - q)/(2 (1 + q)) for a ratio q of
    densities.
    """
    return 0.5 * (1.0 - fine_ratio) / (1.0 + fine_ratio)


def draw_interference(
    rng: np.random.Generator,
    shape: tuple[int, int],
    variance_dn2: float,
    x_cy_per_px: float,
    y_cy_per_px: float,
) -> NDArray[np.float32]:
    """Return a sinusoid over one frame, DN, shape (row, col), of a given variance.

    Notes
    -----
    Interfering clocks of a camera are divided from its pixel clock: the phase of a frame is that of
    a whole number of pixels. The phase of 1/8 cycle at the origin gives the frequencies 0.5 and
    0.25 cy/px the same variance as others.
    """
    row, column = np.arange(shape[0])[:, None], np.arange(shape[1])[None, :]
    start_px = int(rng.integers(LATEST_START_PX))
    cycles = x_cy_per_px * (column + start_px) + y_cy_per_px * row + 0.125
    return (np.sqrt(2.0 * variance_dn2) * np.cos(2.0 * np.pi * cycles)).astype(np.float32)
