"""Data of the blur models: noise spectrum in its band, and integrals beyond."""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from charact.noise.gain.beyond import integrals
from charact.noise.gain.model import leakage_ratio, spectrum_at
from charact.noise.gain.pooled_noise import PooledNoise
from charact.noise.thresholds import GAIN_PRIORS

Array = NDArray[np.float64]

# Start values of tail and spread fraction.
BEGIN = (GAIN_PRIORS.tail[0], 0.2)


class SpectrumData:
    """Data of the fit: power in the used bins, and integrals beyond the band if available.

    Attributes
    ----------
    measured
        Shape (datum,), DN.
    root
        Inverse root of their covariance, shape (datum, datum), 1/DN, including the common error by pulse heights.
    whitened
        The same without the common error.
    log_volume
        ln of the determinant of the root.
    """

    def __init__(self, summary: PooledNoise, used: NDArray[np.bool_]) -> None:
        self.summary, self.used = summary, used
        self.column, self.row = summary.column_cy_per_px[used], summary.row_cy_per_px[used]
        self.measured = summary.power_dn[used]
        if summary.beyond is not None:
            self.measured = np.concatenate([self.measured, summary.beyond.value_dn])
        self.leak = np.ones(len(self.column))

    def start(self, exponent: float) -> Array:
        """Return start values of all parameters by a linear fit of the logarithm above the floor."""
        summary, used, beyond = self.summary, self.used, self.summary.beyond
        highest = summary.power_dn[used].max()
        floor = 0.0 if beyond is None else 0.8 * float(np.clip(beyond.value_dn[0] / beyond.share.sum(), 0.0, highest))
        x, y = (f / GAIN_PRIORS.reference_cy_per_px for f in (self.column, self.row))
        power = np.maximum(summary.power_dn[used] - floor, 1e-3 * highest)
        design = np.stack([np.ones_like(x), -(np.hypot(x, y) ** exponent), -(x**2), -(y**2)])
        root = np.sqrt(summary.modes[used])
        level, strength, columns, rows = np.linalg.lstsq((design * root).T, np.log(power) * root, rcond=None)[0]
        falls = np.clip([columns + strength, rows + strength, strength], -0.8, 5.0)
        whole = np.exp(level) + floor
        return np.array([whole, *falls, exponent, floor / whole if floor else GAIN_PRIORS.few_electrons[0], *BEGIN])

    def expected(self, points: Array) -> Array:
        """Return the model of the data, shape (draw, datum), DN."""
        reading, beyond = self.summary.reading, self.summary.beyond
        inside = self.leak * spectrum_at(points, self.column, self.row, reading)
        if beyond is None:
            return inside
        return np.concatenate([inside, integrals(beyond, partial(spectrum_at, points, reading=reading))], axis=1)

    def weigh(self, point: Array) -> None:
        """Compute leakage and errors at the parameters (1, parameter)."""
        summary, beyond = self.summary, self.summary.beyond
        self.leak = leakage_ratio(point, self.column, self.row, summary.reading, summary.leak_cy2_per_px2)
        model, bins = self.expected(point)[0], len(self.column)
        covariance = np.zeros((len(model), len(model)))
        own = summary.power_sd_dn[self.used] * model[:bins] / np.maximum(self.measured[:bins], 0.2 * model[:bins])
        covariance[np.arange(bins), np.arange(bins)] = own**2
        if beyond is not None:
            power = spectrum_at(point, beyond.column_cy_per_px, beyond.row_cy_per_px, summary.reading)[0]
            covariance[bins:, bins:] = beyond.covariance(power)
        self.whitened = _inverse_root(covariance)
        self.root = _inverse_root(covariance + summary.height_sd**2 * np.outer(model, model))
        self.log_volume = float(np.linalg.slogdet(self.root)[1])


def _inverse_root(covariance: Array) -> Array:
    """Return a matrix that whitens data of this covariance."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)).T, np.float64)
