"""Response and noise of a sensor, as the renderer needs them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulate.radiance.cube import band_widths

# Differences are compared with the noise, or with this fraction of the signal where that is larger. At a tolerance of
# 10 % light is then correct to 1 %, better than lamps and materials are specified.
KNOWN = 0.1


@dataclass(frozen=True, kw_only=True)
class RenderSensor:
    """A sensor's response and noise.

    Parameters
    ----------
    response_nm, response
        Signal of a pixel and exposure for each W m-2 sr-1 of radiance at wavelengths, linear between them and zero
        outside, in any unit, such as photoelectrons.
    dark_variance
        Variance of a pixel's signal in the dark, in that unit squared.
    variance_per_signal
        Growth of the variance with the signal, in that unit.
    noise_averaging_factor
        Factor by which blur after the pixels reduces the standard deviation of noise that is independent between
        pixels.
    name
        Name of the sensor.
    """

    response_nm: tuple[float, ...]
    response: tuple[float, ...]
    dark_variance: float
    variance_per_signal: float
    noise_averaging_factor: float = 1.0
    name: str = "sensor"

    def weight(self, wavelength_nm: ArrayLike) -> NDArray[np.float32]:
        """Return the signal for spectral radiance in the bands of a grid, shape (band,), per W m-2 sr-1 nm-1."""
        grid = np.asarray(wavelength_nm, float)
        at = np.interp(grid, self.response_nm, self.response, left=0.0, right=0.0)
        return (at * band_widths(grid)).astype(np.float32)

    def noise(self, signal: ArrayLike) -> NDArray[np.float64]:
        """Return the standard deviation of a pixel's signal in one frame, before blur, in the unit of the signal."""
        bright = np.maximum(np.asarray(signal, float), 0.0)
        return np.sqrt(self.dark_variance + self.variance_per_signal * bright)

    def noise_floor(self, signal: ArrayLike, *, smooth: bool = False) -> NDArray[np.float64]:
        """Return the noise floor that differences of signals are compared with, in the unit of the signal.

        Parameters
        ----------
        signal
            Signal of pixels.
        smooth
            Whether the differences extend over many pixels: blur does not change these and reduces the noise. Random
            differences between pixels are reduced like the noise.

        Notes
        -----
        The noise of one frame, at least `KNOWN` of the signal: ten times the change allowed at the usual tolerance.
        """
        bright = np.maximum(np.asarray(signal, float), 0.0)
        return np.maximum(self.noise(bright) * (self.noise_averaging_factor if smooth else 1.0), KNOWN * bright)

    @property
    def noise_equivalent_radiance(self) -> float:
        """Radiance at the wavelength of best response that gives a signal like the noise in the dark, W m-2 sr-1."""
        return float(self.dark_variance**0.5 / max(self.response))
