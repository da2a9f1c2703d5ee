"""Pixel readout: aperture, row pitch of a field, video filter along the rows."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.noise.thresholds import GAIN
from charact.video_filter import VideoFilter
from labdata.sensor import Sensor

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class PixelReadoutModel:
    """Aperture and lattice of pixels, and the video filter.

    Parameters
    ----------
    row_pitch
        Row pitch of one exposure, and pixel height of a described camera, column pitches.
    described
        Whether the camera is described; otherwise readout counts as blur.
    video
        Video filter; None for none.
    """

    row_pitch: float = 1.0
    described: bool = False
    video: VideoFilter | None = None

    @classmethod
    def of(cls, row_pitch: float, sensor: Sensor | None) -> "PixelReadoutModel":
        """Return the readout model of a camera with a row pitch."""
        return cls(row_pitch=row_pitch, described=sensor is not None, video=VideoFilter.of(sensor))

    @cached_property
    def falls(self) -> tuple[float, float]:
        """Leading-order fall of ln |H|^2 by aperture and filter along rows and along columns, px^2."""
        if not self.described:
            return 0.0, 0.0
        aperture = np.pi**2 / 3.0
        low = np.array([GAIN.low_cy_per_px])
        filtered = (
            0.0 if self.video is None else -2.0 * float(np.log(np.abs(self.video(low)))[0]) / GAIN.low_cy_per_px**2
        )
        return aperture + filtered, aperture * self.row_pitch**2

    def shown(self, ln_power: Callable[[Array, Array], Array], column: Array, row: Array) -> Array:
        """Return |H|^2 including pixel readout.

        Parameters
        ----------
        ln_power
            ln |H|^2 before the pixels, of frequencies along rows and columns, cycles per column pitch.
        column, row
            Frequencies, shape (bin,).

        Notes
        -----
        Pixels sample light filtered by their aperture, sinc^2, so power beyond half a cycle per pixel is aliased: the
        nearest order, and the rest as the second order. Light without blur stays white. The gain of an aliased order
        over the baseband is limited to 2.
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
    """Return exp of negative values, continued smoothly to a limit of 2 for positive ones."""
    beyond = np.exp(-np.abs(difference))
    return np.where(difference < 0.0, beyond, 2.0 - beyond)


def _orders(frequency: Array, pitch: float) -> list[tuple[Array, Array]]:
    """Return the frequencies aliased to one, cycles per column pitch, and the aperture transfer of each."""
    near, far = (1.0 / pitch + sign * np.abs(frequency) for sign in (-1.0, 1.0))
    own, beside = np.sinc(frequency * pitch) ** 2, np.sinc(near * pitch) ** 2
    return [(frequency, own), (near, beside), (far, 1.0 - own - beside)]
