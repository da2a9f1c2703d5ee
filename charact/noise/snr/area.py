"""Noise of the mean of a square of pixels, from the noise spectrum."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.noise.stack.spectrum import BAND_CY_PER_PX, ROW_LIMIT_CY, Bins
from charact.noise.stack.stack_statistics import BlockSpectrum, StackStatistics
from charact.noise.thresholds import STACK

Array = NDArray[np.float64]

# Side of the square, pixels of one exposure; larger than the blur.
SIDE_PX = 10


@dataclass(frozen=True, kw_only=True)
class Shares:
    """Weights of the noise spectrum in the variance of a square's mean.

    Parameters
    ----------
    bins
        Weight of the power of each bin, shape (bin,).
    beyond
        Weight of the mean power of the modes beyond all bins.
    modes
        Fraction of all modes in each bin, shape (bin,).
    edge
        Bins of the outermost ring, shape (bin,).
    """

    bins: Array
    beyond: float
    modes: Array
    edge: NDArray[np.bool_]


def shares_of(bins: Bins, side: int = SIDE_PX) -> Shares:
    """Return the weights of a square of `side` pixels.

    Modes of the band without a bin (on the axes and in the smallest rings) count with the nearest bin.
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
    # Power depends mainly on the radius.
    place[lost] = (outward + 0.05 * across).argmin(axis=1)
    number = len(bins.modes)
    return Shares(
        bins=np.bincount(place[inside], weight[inside], number).astype(float),
        beyond=float(weight[~inside].sum()),
        modes=np.bincount(place[inside], count[inside], number).astype(float),
        edge=radius > 0.9 * radius.max(),
    )


def _response(frequency: Array, side: int) -> Array:
    """Return the squared transfer of the mean of `side` pixels."""
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
    The variance is the sum over modes of power times (sin(pi n f) / (n sin(pi f)))^2 along rows and columns. For white
    noise it is the pixel variance over n^2, for blurred noise larger by the inverse blur factor. Beyond the bins the
    power is taken midway between their outer edge and the mean beyond, which follows from the pixel variance. Row,
    column and frame noise lies on the excluded axes and is added from the 3-D noise if available.
    """
    power = spectrum.power_dn2[:, 0]
    rest = float(spectrum.variance_dn2 - shares.modes @ power) / max(1.0 - shares.modes.sum(), 1e-6)
    edge = float(np.average(power[shares.edge], weights=level.bins.modes[shares.edge]))
    beyond = shares.beyond * 0.5 * (edge + rest)
    variance = float(shares.bins @ power) + beyond
    own = (shares.bins * power) ** 2 / (level.bins.modes * level.bins.efficiency * exposures)
    pulses = variance * level.variance_sd_dn2 / max(level.variance_dn2, 1e-12)
    parts = [np.sqrt(own.sum()), 0.3 * shares.beyond * abs(edge - rest), STACK.binning_sd * variance, pulses]
    whole, whole_sd = _whole_lines(level)
    return variance + whole, float(np.sqrt(np.sum(np.square(parts)) + whole_sd**2))


def _whole_lines(level: StackStatistics, side: int = SIDE_PX) -> tuple[float, float]:
    """Return the variance of a square's mean by frame, row and column noise, and its standard error, DN^2."""
    if level.cube is None:
        return 0.0, 0.0
    rng = np.random.default_rng(8)
    parts = level.cube.components
    shares = {"t": 1.0, "tv": 1.0 / side, "th": 1.0 / side}
    value = sum(share * parts[name].variance_dn2 for name, share in shares.items())
    draws = sum((share * parts[name].draws(rng, 400) for name, share in shares.items()), np.zeros(400))
    low, high = np.quantile(draws, [0.16, 0.84])
    return float(value), float(0.5 * (high - low))
