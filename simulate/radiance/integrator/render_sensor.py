"""What looks at the radiance: what a pixel makes of it, and how noisy it is; handed in by whoever has a sensor."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulate.radiance.cube import band_widths

# Differences are weighed by the noise, or by so large a share of the signal where that is more. At a tolerance of 10 %
# light is then right to 1 %, which is better than lamps and materials are known.
KNOWN = 0.1


@dataclass(frozen=True, kw_only=True)
class RenderSensor:
    """A sensor as a renderer needs it.

    Parameters
    ----------
    response_nm, response
        Signal of a pixel and exposure for each W m-2 sr-1 of radiance at wavelengths, linear between them and zero
        outside, in a unit of its own, such as photoelectrons.
    dark_variance
        Variance of a pixel's signal in the dark, in that unit squared.
    variance_per_signal
        Growth of the variance with the signal, in that unit.
    evened
        What blur behind the eye's pixels leaves of noise that is independent from pixel to pixel, as a share of its
        standard deviation.
    name
        Who looks.
    """

    response_nm: tuple[float, ...]
    response: tuple[float, ...]
    dark_variance: float
    variance_per_signal: float
    evened: float = 1.0
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

    def grain(self, signal: ArrayLike, *, smooth: bool = False) -> NDArray[np.float64]:
        """Return the unit in which differences of signals are weighed, in the unit of the signal.

        Parameters
        ----------
        signal
            Signal of pixels.
        smooth
            Whether differences are those of many neighbours together: blur leaves these as they are, but evens out the
            noise that they stand in. What differs by chance from pixel to pixel it evens out like the noise.

        Notes
        -----
        The noise of one frame, and never less than `KNOWN` of the signal: ten times what may change at the usual
        tolerance.
        """
        bright = np.maximum(np.asarray(signal, float), 0.0)
        return np.maximum(self.noise(bright) * (self.evened if smooth else 1.0), KNOWN * bright)

    @property
    def noise_equivalent_radiance(self) -> float:
        """Radiance at the wavelength of best response that gives a signal like the noise in the dark, W m-2 sr-1."""
        return float(self.dark_variance**0.5 / max(self.response))
