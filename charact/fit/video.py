"""Transfer of the video chain: the CCD's staircase through a causal low pass, read again once a pixel.

The output register holds each pixel's charge for one clock; a Butterworth filter rounds the stairs, and the digitiser
reads once a clock. From pixel to pixel this is a causal digital filter whose weights are differences of the low
pass's step response.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Weights beyond this many pixels are below 1e-6 for any bandwidth that a camera of this clock would have.
LENGTH_PX = 14


def video_filter_weights(bandwidth_mhz: Array, clock_mhz: float, order: int, phase: float = 1.0) -> Array:
    """Return the weights with which earlier pixels enter one, shape (n, LENGTH_PX), their sum 1.

    Parameters
    ----------
    bandwidth_mhz
        Frequency where the low pass has lost 3 dB, shape (n,), MHz.
    clock_mhz
        Pixel clock, MHz.
    order
        Order of the Butterworth filter.
    phase
        When in its clock a pixel is read, 0 (start) to 1 (end).

    Notes
    -----
    Poles p_k = w exp(i pi (2k + order + 1)/(2 order)); step response 1 + sum_k r_k exp(p_k t)/p_k with the residues
    r_k = w^order / prod_{j != k} (p_k - p_j). A stair that begins j clocks before the pixel read has by then risen to
    s(j + phase) and, its successor taking over, counts s(j + phase) - s(j + phase - 1).
    """
    angle = np.pi * (2.0 * np.arange(order) + order + 1) / (2.0 * order)
    unit = np.exp(1j * angle)
    others = np.where(np.eye(order, dtype=bool), 1.0, unit[:, None] - unit[None, :])
    residue_over_pole = 1.0 / (others.prod(axis=1) * unit)
    omega = 2.0 * np.pi * np.asarray(bandwidth_mhz, float) / clock_mhz
    time = np.arange(LENGTH_PX) + phase
    rise = np.exp(unit[None, :, None] * omega[:, None, None] * time[None, None, :])
    step = 1.0 + np.einsum("k,nkt->nt", residue_over_pole, rise).real
    found = np.diff(step, axis=1, prepend=0.0)
    return found / found.sum(axis=1, keepdims=True)


def video_filter_transfer(weight: Array, frequency_cy_per_px: Array) -> Array:
    """Return |sum_j w_j exp(-2 pi i f j)| of weights (n, pixel) at frequencies (m,), shape (n, m)."""
    turns = np.exp(-2j * np.pi * np.outer(np.arange(weight.shape[1]), frequency_cy_per_px))
    return np.abs(weight @ turns)
