"""Noise power spectrum of a camera that blurs after its gain.

Photoelectrons are Poisson distributed and blurred after the gain; the CCD electrons add white shot noise. The power is
(k F^2 |H(f)|^2 + K) mu, and its limit f -> 0 is the covariance summed over all separations. Image tubes have long wings
(transfer exp(-(f/fc)^n) with n near 1), so the spectrum is extrapolated with blur models instead of summed.
"""

import numpy as np
from numpy.typing import NDArray

from charact.noise.gain.pixel_readout_model import PixelReadoutModel
from charact.noise.thresholds import GAIN_PRIORS

Array = NDArray[np.float64]

NAMES = ("power", "fall_columns", "fall_rows", "strength", "exponent", "electron_share", "tail", "spread_share")
UNITS = ("DN", "1", "1", "1", "1", "1", "1", "1")


def transfer(parameters: Array, column: Array, row: Array, reading: PixelReadoutModel) -> Array:
    """Return |H|^2 of the blur after the gain including pixel readout, shape (draw, bin).

    (1 - q + q sqrt(C))^2 exp(-cx x^2 - cy y^2), C = (1 + t b r^n)^(-1/t), frequencies in units of the reference: the
    tube's exp(-b r^n) for tail t = 0 and fraction q = 1, times the leading term of every other aperture and filter.
    Known pixel readout is included exactly. The parameters are the falls b + cx and b + cy, b, n, t and q.
    """
    columns, rows, strength, exponent = (parameters[:, i, None] for i in range(1, 5))
    tail, share = np.maximum(parameters[:, 6, None], GAIN_PRIORS.min_tail), parameters[:, 7, None]
    known_columns, known_rows = (GAIN_PRIORS.reference_cy_per_px**2 * fall for fall in reading.falls)

    def before(column: Array, row: Array) -> Array:
        x, y = column / GAIN_PRIORS.reference_cy_per_px, row / GAIN_PRIORS.reference_cy_per_px
        gauss = (columns - strength - known_columns) * x**2 + (rows - strength - known_rows) * y**2
        core = -np.log1p(tail * strength * np.hypot(x, y) ** exponent) / tail
        if np.any(share < 1.0):
            core = 2.0 * np.log1p(np.maximum(share * np.expm1(0.5 * core), GAIN_PRIORS.min_transfer - 1.0))
        return np.minimum(core - gauss, GAIN_PRIORS.max_log_transfer)

    return reading.shown(before, column, row)


def spectrum_at(parameters: Array, column: Array, row: Array, reading: PixelReadoutModel) -> Array:
    """Return the power over signal at temporal lag 0, shape (draw, bin), DN."""
    share = parameters[:, 5:6]
    return parameters[:, :1] * ((1.0 - share) * transfer(parameters, column, row, reading) + share)


def leakage_ratio(
    point: Array, column: Array, row: Array, reading: PixelReadoutModel, leak_cy2_per_px2: tuple[float, float]
) -> Array:
    """Return the power of tapered modes over that of `spectrum_at`, shape (bin,), dimensionless.

    Each mode averages nearby frequencies, to second order two on either side.
    """
    across, down = np.sqrt(leak_cy2_per_px2)
    around = [spectrum_at(point, column + i * across, row + j * down, reading)[0] for i in (-1, 1) for j in (-1, 1)]
    return np.mean(around, axis=0) / spectrum_at(point, column, row, reading)[0]
