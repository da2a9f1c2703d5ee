"""Blurs of exactly known MTF, the square pixel included: Gaussian, image tube, Moffat, halo."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class TrueBlur:
    """A rotationally symmetric blur and the square pixel behind it.

    Parameters
    ----------
    form
        "gaussian": exp(-2 (pi f s)^2). "exponential": exp(-(f/fc)^n), the form of intensifier
        tubes. "moffat": the transform of (1 + r^2/a^2)^-b.
    sigma_px
        s of the Gaussian, px.
    frequency_cy_per_px, exponent
        fc and n of the exponential form, cycles per pixel and dimensionless.
    moffat_px, moffat_exponent
        a and b of the Moffat form, px and dimensionless.
    halo_share, halo_px
        Share of all light spread evenly over a disc, and the disc's diameter, px.
    """

    form: Literal["gaussian", "exponential", "moffat"] = "gaussian"
    sigma_px: float = 1.0
    frequency_cy_per_px: float = 0.25
    exponent: float = 1.184
    moffat_px: float = 1.5
    moffat_exponent: float = 2.5
    halo_share: float = 0.0
    halo_px: float = 30.0

    def mtf(self, frequency_cy_per_px: Array | float, angle_deg: float) -> Array:
        """MTF along the normal of an edge whose normal stands at an angle to the rows, pixel
        included.

        The square pixel's transform along the direction a is sinc(f cos a) sinc(f sin a), sinc(x) =
        sin(pi x)/(pi x).
        """
        f = np.asarray(frequency_cy_per_px, float)
        angle = np.deg2rad(angle_deg)
        return self.transfer(f * np.cos(angle), f * np.sin(angle))

    def transfer(self, fx: Array | float, fy: Array | float) -> Array:
        """MTF at frequencies along rows and columns, cycles per pixel, pixel included."""
        return self.before_pixel(np.hypot(fx, fy)) * np.sinc(fx) * np.sinc(fy)

    def before_pixel(self, f: Array) -> Array:
        """MTF at frequencies in any direction, cycles per pixel, without the pixel."""
        core = {
            "gaussian": self._gaussian,
            "exponential": self._exponential,
            "moffat": self._moffat,
        }[self.form](f)
        if self.halo_share == 0:
            return core
        from scipy.special import j1

        x = np.maximum(np.pi * self.halo_px * f, 1e-9)
        return core * (1 - self.halo_share + self.halo_share * 2 * j1(x) / x)

    def _gaussian(self, f: Array) -> Array:
        return np.exp(-2 * (np.pi * f * self.sigma_px) ** 2)

    def _exponential(self, f: Array) -> Array:
        return np.exp(-((f / self.frequency_cy_per_px) ** self.exponent))

    def _moffat(self, f: Array) -> Array:
        """The two-dimensional transform is 2^(2-b)/Gamma(b-1) x^(b-1) K_(b-1)(x), x = 2 pi a f."""
        from scipy.special import gamma, kv

        x, order = np.maximum(2 * np.pi * self.moffat_px * f, 1e-9), self.moffat_exponent - 1
        # Beyond x of 600 the Bessel function underflows, and so does the transfer.
        return np.where(
            x < 600, 2 ** (1 - order) / gamma(order) * x**order * kv(order, np.minimum(x, 600)), 0.0
        )

    def mtf50(self, angle_deg: float, level: float = 0.5) -> float:
        """Lowest frequency at which the MTF falls to a level, cycles per pixel along the normal."""
        return level_crossing(lambda f: self.mtf(f, angle_deg), level)


@dataclass(frozen=True, kw_only=True)
class BlurOf(TrueBlur):
    """A blur of any transfer: a function of the frequency, cycles per pixel, without the pixel."""

    of: Callable[[Any], Any]

    def before_pixel(self, f: Array) -> Array:
        return self.of(f)


def level_crossing(mtf: Callable[[Any], Any], level: float) -> float:
    """Lowest frequency at which a function of frequency falls to a level, cycles per pixel, by
    bisection.
    """
    grid = np.linspace(0, 2, 4001)
    first_below = int(np.argmax(mtf(grid) < level))
    low, high = grid[first_below - 1], grid[first_below]
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if mtf(middle) > level else (low, middle)
    return float((low + high) / 2)
