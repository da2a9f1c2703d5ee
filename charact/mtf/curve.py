"""MTF curves and crossing frequencies from posterior draws."""

import numpy as np
from numpy.typing import NDArray

from labdata.measurement import QUANTILES, Curve

Array = NDArray[np.float64]

# Frequencies of a reported curve, and the finer grid for crossing frequencies, cy/px.
REPORTED = np.linspace(0.0, 0.5, 101)
FINE = np.concatenate([[1e-6], np.geomspace(0.003, 1.5, 230)])


def curve_of(frequency: Array, draws: Array) -> Curve:
    """Return median and pointwise credible intervals of drawn curves, shape (draw, frequency)."""
    low95, low68, middle, high68, high95 = quantiles(draws, QUANTILES)
    return Curve(
        frequency_cy_per_px=frequency,
        value=middle,
        interval68=np.stack([low68, high68]),
        interval95=np.stack([low95, high95]),
        draws=draws,
    )


def quantiles(draws: Array, shares: tuple[float, ...]) -> Array:
    """Return quantiles of draws (draw, ...), shape (quantile, ...); equal to `numpy.quantile`, with a single sort."""
    ordered = np.sort(np.ascontiguousarray(draws.T)).T
    place = np.asarray(shares) * (len(draws) - 1)
    low = np.minimum(place.astype(int), max(len(draws) - 2, 0))
    rest = (place - low).reshape(-1, *[1] * (draws.ndim - 1))
    return ordered[low] + rest * (ordered[np.minimum(low + 1, len(draws) - 1)] - ordered[low])


def crossing_frequency(frequency: Array, curves: Array, level: float) -> Array:
    """Return the lowest frequency at which each curve falls to a level, NaN where it does not.

    Parameters
    ----------
    frequency
        Shape (f,).
    curves
        Shape (n, f).
    """
    below = curves < level
    first = np.argmax(below, axis=1)
    found = below.any(axis=1) & (first > 0)
    index = np.where(found, first, 1)
    rows = np.arange(len(curves))
    high, low = curves[rows, index - 1], curves[rows, index]
    share = (high - level) / np.where(high > low, high - low, 1.0)
    crossing = frequency[index - 1] + share * (frequency[index] - frequency[index - 1])
    return np.where(found, crossing, np.nan)


# Frequencies at which the MTF is reported as a quantity of its own, cy/px.
PINNED = (0.1, 0.2, 0.3)
