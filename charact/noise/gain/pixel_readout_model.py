"""How a camera reads the light behind its gain: touching pixels, rows of one field apart, a filter along the rows.

What blurs the light is smooth; what reads it is known, and its sharp corners would pass for blur.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.video_filter import VideoFilter
from labdata.sensor import Sensor

Array = NDArray[np.float64]

# Frequency at which the leading term of the filter is taken, cycles per column pitch.
LOW_CY_PER_PX = 0.02


@dataclass(frozen=True, kw_only=True)
class PixelReadoutModel:
    """Aperture and lattice of pixels, and the filter behind them.

    Parameters
    ----------
    row_pitch
        Distance of the rows of one exposure, and of a described camera the height of its pixels, column pitches.
    described
        Whether the camera is: how others read is not known, and counts as part of their blur.
    video
        The filter; None: none.
    """

    row_pitch: float = 1.0
    described: bool = False
    video: VideoFilter | None = None

    @classmethod
    def of(cls, row_pitch: float, sensor: Sensor | None) -> "PixelReadoutModel":
        """Return how a camera reads rows so far apart."""
        return cls(row_pitch=row_pitch, described=sensor is not None, video=VideoFilter.of(sensor))

    @cached_property
    def falls(self) -> tuple[float, float]:
        """What aperture and filter add to the fall of ln |H|^2 along rows and along columns, to leading order, px^2."""
        if not self.described:
            return 0.0, 0.0
        aperture = np.pi**2 / 3.0
        low = np.array([LOW_CY_PER_PX])
        filtered = 0.0 if self.video is None else -2.0 * float(np.log(np.abs(self.video(low)))[0]) / LOW_CY_PER_PX**2
        return aperture + filtered, aperture * self.row_pitch**2

    def shown(self, ln_power: Callable[[Array, Array], Array], column: Array, row: Array) -> Array:
        """Return the power that pixels show of light.

        Parameters
        ----------
        ln_power
            ln |H|^2 before the pixels, of frequencies along rows and columns, cycles per column pitch.
        column, row
            Frequencies, shape (bin,).

        Notes
        -----
        Pixels sample what their aperture passes, sinc^2, so that power beyond half a cycle per pixel folds back: the
        nearest order, and all of the rest as of the second. Light that nothing blurs stays white. An order that a blur
        would pass more of than of the frequency itself, as none does, counts at most twice as much.
        """
        own = ln_power(column, row)
        if not self.described:
            return np.exp(own)
        out = np.zeros_like(own)
        for x, across in _orders(column, 1.0):
            for y, down in _orders(row, self.row_pitch):
                out = out + _bounded_exponential(ln_power(x, y) - own) * across * down
        out = out * np.exp(own)
        return out if self.video is None else out * np.abs(self.video(column)) ** 2


def _bounded_exponential(difference: Array) -> Array:
    """Return exp of what is below 0, and above it what goes on as smoothly, but to no more than 2."""
    beyond = np.exp(-np.abs(difference))
    return np.where(difference < 0.0, beyond, 2.0 - beyond)


def _orders(frequency: Array, pitch: float) -> list[tuple[Array, Array]]:
    """Return frequencies before the sampling that are seen at one, cycles per column pitch, and how each is passed."""
    near, far = (1.0 / pitch + sign * np.abs(frequency) for sign in (-1.0, 1.0))
    own, beside = np.sinc(frequency * pitch) ** 2, np.sinc(near * pitch) ** 2
    return [(frequency, own), (near, beside), (far, 1.0 - own - beside)]
