"""The noise spectrum of a camera that blurs after its gain.

Photoelectrons arrive independently and everything after the gain blurs them; the electrons of the CCD that each of them
makes are counted at random once more, which no blur touches. The power of the noise is (k F^2 |H(f)|^2 + K) mu: at
f -> 0 it is the covariance summed over all lags, whatever the blur. Blur of image tubes has long wings (transfer
exp(-(f/fc)^n) with n near 1), so that no window of lags holds all of the sum; the spectrum is extrapolated instead with
the forms that such transfers have (`charact.noise.gain.forms`), and what they leave open is in the interval.
"""

import numpy as np
from numpy.typing import NDArray

from charact.noise.gain.pixel_readout_model import PixelReadoutModel

Array = NDArray[np.float64]

NAMES = ("power", "fall_columns", "fall_rows", "strength", "exponent", "electron_share", "tail", "spread_share")
UNITS = ("DN", "1", "1", "1", "1", "1", "1", "1")
# Frequency at which the fall of the logarithm is stated, cycles per column pitch.
REFERENCE_CY_PER_PX = 0.1
# ln of the most that the form may pass of a frequency over frequency 0, far from where it is fitted.
MOST = 1.0
# A tail that is none to the sixth digit.
NO_TAIL = 1e-6
# Least share of the light at any frequency: its logarithm is finite.
LEAST = 1e-9


def transfer(parameters: Array, column: Array, row: Array, reading: PixelReadoutModel) -> Array:
    """Return |H|^2 of the blur after the gain as it is read, shape (draw, bin).

    (1 - q + q sqrt(C))^2 exp(-cx x^2 - cy y^2), C = (1 + t b r^n)^(-1/t), frequencies in units of the reference: the
    tube's form exp(-b r^n) for no tail t and all of the light, q = 1, times the leading term of every other aperture
    and filter, of which those that read are put in as they are. The parameters are the falls b + cx and b + cy, b, n,
    t and q.
    """
    columns, rows, strength, exponent = (parameters[:, i, None] for i in range(1, 5))
    tail, share = np.maximum(parameters[:, 6, None], NO_TAIL), parameters[:, 7, None]
    known_columns, known_rows = (REFERENCE_CY_PER_PX**2 * fall for fall in reading.falls)

    def before(column: Array, row: Array) -> Array:
        x, y = column / REFERENCE_CY_PER_PX, row / REFERENCE_CY_PER_PX
        gauss = (columns - strength - known_columns) * x**2 + (rows - strength - known_rows) * y**2
        core = -np.log1p(tail * strength * np.hypot(x, y) ** exponent) / tail
        if np.any(share < 1.0):
            core = 2.0 * np.log1p(np.maximum(share * np.expm1(0.5 * core), LEAST - 1.0))
        return np.minimum(core - gauss, MOST)

    return reading.shown(before, column, row)


def spectrum_at(parameters: Array, column: Array, row: Array, reading: PixelReadoutModel) -> Array:
    """Return the power per DN of signal at one time lag 0, shape (draw, bin), DN."""
    share = parameters[:, 5:6]
    return parameters[:, :1] * ((1.0 - share) * transfer(parameters, column, row, reading) + share)


def leakage_ratio(
    point: Array, column: Array, row: Array, reading: PixelReadoutModel, leak_cy2_per_px2: tuple[float, float]
) -> Array:
    """Return the power that the modes of faded images have over that of `spectrum_at`, shape (bin,), dimensionless.

    Each mode is a mean over frequencies nearby, which to second order is the mean of two on either side.
    """
    across, down = np.sqrt(leak_cy2_per_px2)
    around = [spectrum_at(point, column + i * across, row + j * down, reading)[0] for i in (-1, 1) for j in (-1, 1)]
    return np.mean(around, axis=0) / spectrum_at(point, column, row, reading)[0]
