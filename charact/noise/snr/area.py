"""Noise of the mean of a square of pixels, from the spectrum of the noise: what blur shares does not average away.

The variance of the mean of n x n pixels is the mean over all modes of their power times the square's own response,
(sin(pi n f) / (n sin(pi f)))^2 along rows and columns: the power at low frequency, which tends to K + k F^2 for the
light, over n^2. The variance of a pixel over n^2, which holds for white noise, is too small by the blur factor.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.noise.stack.spectrum import BAND_CY_PER_PX, ROW_LIMIT_CY, Bins
from charact.noise.stack.stack_statistics import BlockSpectrum, StackStatistics

Array = NDArray[np.float64]

# Side of the square, pixels as read in one exposure: an angle that an eye resolves well, and larger than the blur.
SIDE_PX = 10
# Relative error of the variance that steps between the bins and the modes beyond them leave.
BINNING = 0.01


@dataclass(frozen=True, kw_only=True)
class Shares:
    """How much each part of the spectrum adds to the variance of a square's mean.

    Parameters
    ----------
    bins
        Weight of the power of each bin, shape (bin,).
    beyond
        Weight of the mean power of the modes beyond all bins.
    modes
        Share of all modes that lies in each bin, shape (bin,).
    edge
        The bins of the outermost ring, shape (bin,).
    """

    bins: Array
    beyond: float
    modes: Array
    edge: NDArray[np.bool_]


def shares_of(bins: Bins, side: int = SIDE_PX) -> Shares:
    """Return the weights of a square of so many pixels a side.

    Modes inside the band that belong to no bin, along the axes and in the smallest rings, count with the nearest.
    """
    rows, cols = bins.window.shape
    row, col = np.abs(np.fft.fftfreq(rows))[:, None].astype(float), np.fft.rfftfreq(cols)[None, :].astype(float)
    count = np.where((col == 0) | (col == 0.5), 1.0, 2.0) * np.ones((rows, 1)) / (rows * cols)
    weight = count * _response(row, side) * _response(col, side)
    y, x = np.broadcast_arrays(row / bins.row_pitch, col)
    inside = (np.hypot(x, y) < BAND_CY_PER_PX) & (row <= ROW_LIMIT_CY)
    place = np.array(bins.select)
    lost = inside & (place < 0)
    radius = np.hypot(bins.column_cy_per_px, bins.row_cy_per_px)
    across = (x[lost][:, None] - bins.column_cy_per_px) ** 2 + (y[lost][:, None] - bins.row_cy_per_px) ** 2
    outward = (np.hypot(x, y)[lost][:, None] - radius) ** 2
    # Power changes with the radius first, and with the direction little.
    place[lost] = (outward + 0.05 * across).argmin(axis=1)
    number = len(bins.modes)
    return Shares(
        bins=np.bincount(place[inside], weight[inside], number).astype(float),
        beyond=float(weight[~inside].sum()),
        modes=np.bincount(place[inside], count[inside], number).astype(float),
        edge=radius > 0.9 * radius.max(),
    )


def _response(frequency: Array, side: int) -> Array:
    """Squared response of the mean of so many pixels in a row."""
    sine = np.sin(np.pi * frequency)
    safe = np.where(sine == 0, 1.0, sine)
    return np.where(sine == 0, 1.0, (np.sin(np.pi * side * frequency) / (side * safe)) ** 2)


def area_variance(
    level: StackStatistics, spectrum: BlockSpectrum, shares: Shares, exposures: float
) -> tuple[float, float]:
    """Return the variance of a square's mean and its standard error, DN^2.

    Parameters
    ----------
    level, spectrum
        A stack and the spectrum of its noise.
    shares
        Weights of the square.
    exposures
        Independent exposures behind the spectrum.

    Notes
    -----
    What lies beyond the bins weighs little and is taken for midway between the power at their outer edge and the mean
    beyond, which the variance of a pixel tells. Noise of whole rows, columns and frames lies on the axes, where the
    spectrum is not kept; it is added from the 3-D noise of stacks long enough for that.
    """
    power = spectrum.power_dn2[:, 0]
    rest = float(spectrum.variance_dn2 - shares.modes @ power) / max(1.0 - shares.modes.sum(), 1e-6)
    edge = float(np.average(power[shares.edge], weights=level.bins.modes[shares.edge]))
    beyond = shares.beyond * 0.5 * (edge + rest)
    variance = float(shares.bins @ power) + beyond
    own = (shares.bins * power) ** 2 / (level.bins.modes * level.bins.efficiency * exposures)
    pulses = variance * level.variance_sd_dn2 / max(level.variance_dn2, 1e-12)
    parts = [np.sqrt(own.sum()), 0.3 * shares.beyond * abs(edge - rest), BINNING * variance, pulses]
    whole, whole_sd = _whole_lines(level)
    return variance + whole, float(np.sqrt(np.sum(np.square(parts)) + whole_sd**2))


def _whole_lines(level: StackStatistics, side: int = SIDE_PX) -> tuple[float, float]:
    """Variance that noise of whole frames, rows and columns adds to a square's mean, and its standard error, DN^2."""
    if level.cube is None:
        return 0.0, 0.0
    rng = np.random.default_rng(8)
    parts = level.cube.components
    shares = {"t": 1.0, "tv": 1.0 / side, "th": 1.0 / side}
    value = sum(share * parts[name].variance_dn2 for name, share in shares.items())
    draws = sum((share * parts[name].draws(rng, 400) for name, share in shares.items()), np.zeros(400))
    low, high = np.quantile(draws, [0.16, 0.84])
    return float(value), float(0.5 * (high - low))
