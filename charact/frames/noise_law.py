"""Temporal noise of a pixel against its signal: one law for every method.

    sigma^2(mu) = r^2 + g mu + (b + p) mu^2

mu: signal above dark; r: noise without light, rounding included; g: covariance gain, K of EMVA 1288
without a tube and K + k F^2 behind one; b: nonlinearity, as of a microchannel plate that saturates;
p: squared PRNU, of frames without flat-field correction. White noise that is blurred after the gain
keeps g as its power at low frequency: the variance of a sum of many pixels exceeds that of as many
independent ones by the correlation factor.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labdata.errors import check

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class NoiseLaw:
    """Noise law of a camera at one setting; numbers, or draws of shape (draw, 1).

    Parameters
    ----------
    gain_dn, read_dn
        g and r, in the unit of the signal; g is 0 of a thermal imager, whose r is its NETD.
    bend, pattern
        b, per unit of the signal squared, and p, dimensionless.
    blur_px, read_blur_px
        Standard deviation of the Gaussian blur after the gain, and of that of the noise without
        light by a warp, px.
    correlation_factor
        Variance of a sum of many pixels over that of as many independent ones, dimensionless.
    is_known
        Whether the law was measured or described, not estimated from the frame that it is used for.
    """

    gain_dn: float | Array
    read_dn: float | Array
    bend: float | Array = 0.0
    pattern: float | Array = 0.0
    blur_px: float = 0.0
    read_blur_px: float = 0.0
    correlation_factor: float = 1.0
    is_known: bool = True

    def __post_init__(self) -> None:
        names = ("gain_dn", "read_dn", "blur_px", "read_blur_px")
        numbers = [name for name in names if np.ndim(getattr(self, name)) == 0]
        check(self, not_negative=numbers, of=" of a noise law")

    def sd(self, signal: Array | float, *, pattern: bool = False) -> Array:
        """Return sigma of signals, with or without PRNU; that of none where they are negative."""
        mu = np.maximum(signal, 0.0)
        square = self.bend + self.pattern * pattern
        variance = self.read_dn**2 + self.gain_dn * mu + square * mu**2
        return np.sqrt(np.maximum(variance, 1e-300))

    def sum_variance(self, total: float) -> float:
        """Return the variance of the sum of many pixels by the light in them, DN^2."""
        return float(self.correlation_factor * self.gain_dn * max(total, 0.0))

    def signal_at(self, snr: float) -> Array:
        """Return the signal at which mu / sigma(mu), PRNU included, is an SNR; inf if none is."""
        square = 1.0 - snr**2 * np.asarray(self.pattern + self.bend)
        shot = snr**2 * np.asarray(self.gain_dn)
        root = np.sqrt(shot**2 + 4.0 * np.maximum(square, 0.0) * (snr * self.read_dn) ** 2)
        return np.where(square > 0, (shot + root) / np.maximum(2.0 * square, 1e-12), np.inf)

    def scaled(self, ratio: float) -> "NoiseLaw":
        """Return the law with a ratio of the power of read and shot noise."""
        return replace(self, gain_dn=self.gain_dn * ratio, read_dn=self.read_dn * ratio**0.5)
