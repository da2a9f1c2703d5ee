"""Bow and wave of an edge: what the displacements of its rows share beyond a straight line."""

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.frames.robust import median

Array = NDArray[np.float64]

# 2 k + 1 of the Legendre polynomials of a bow and a wave.
LEGENDRE_ORDERS = np.array([5.0, 7.0])


def rms_of(coefficients: Array) -> float:
    """Return the root mean square of Legendre polynomials of the second and third order."""
    return float(np.sqrt(np.sum(coefficients**2 / LEGENDRE_ORDERS)))


def bow_of(offset: Array) -> Array:
    """Return the bow and wave that the rows' displacements follow: amplitudes of the second and
    third Legendre polynomial over the rows that have one, px; 0: none.

    The scatter of block means is estimated from rows, with the correlation of neighbouring rows
    (Geyer's initial positive sequence, Stat. Sci. 7, 473, 1992), and from differences of
    neighbouring blocks; the largest counts.
    """
    finite = np.isfinite(offset)
    if np.count_nonzero(finite) < 24:
        return np.zeros(2)
    rows, value = np.flatnonzero(finite), offset[finite]
    # The polynomials span exactly the valid rows: beyond them they would grow.
    design = np.polynomial.legendre.legvander(
        2.0 * (rows - rows[0]) / (rows[-1] - rows[0]) - 1.0, 3
    )
    begin = np.arange(ACCURACY.bow_blocks) * value.size // ACCURACY.bow_blocks
    size = np.diff(begin, append=value.size)
    means = np.add.reduceat(value, begin) / size
    row_variance = np.mean((np.add.reduceat(value**2, begin) / size - means**2) / (size - 1.0))
    coefficients = np.linalg.lstsq(design, value, rcond=None)[0]
    residual = value - design @ coefficients
    differences = 0.5 * median(np.diff(means) ** 2) / 0.455
    shared = np.array(
        [
            float(np.mean(residual[:-lag] * residual[lag:]))
            for lag in range(1, ACCURACY.bow_lags + 1)
        ]
    )
    correlated = float(np.mean(residual**2)) + 2.0 * float(
        np.sum(shared[np.cumprod(shared > 0.0).astype(bool)])
    )
    error = np.sqrt(
        max(row_variance, differences, correlated / value.size * ACCURACY.bow_blocks)
        * ACCURACY.bow_blocks
    )
    # A Legendre amplitude of evenly spread values has the variance (2 k + 1) s^2 / n.
    sd = error / ACCURACY.bow_blocks * np.sqrt(LEGENDRE_ORDERS)
    shape = np.abs(coefficients[2:])
    is_bow = np.any((shape > THRESHOLDS.bow_sd * sd) & (shape > THRESHOLDS.bow_px / 1.5))
    return coefficients[2:] if is_bow else np.zeros(2)
