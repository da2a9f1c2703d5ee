"""What the light's noise is made of under one draw of the posterior, and frames of it: pulses, blurred, glowing on."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from charact.noise.gain import model
from charact.noise.gain.pixel_readout_model import PixelReadoutModel
from labdata.measurement import Posterior

Array = NDArray[np.floating]

# Relative variance of the pulse heights of a plate: anything from all alike to a little beyond exponential.
HEIGHTS = (0.0, 1.2)
# Glow of earlier exposures below this share is left out.
FAINTEST = 0.02
LONGEST = 12


@dataclass(frozen=True, kw_only=True)
class LightNoise:
    """Noise of even light as one draw of the posterior has it.

    Parameters
    ----------
    pulse_dn
        Mean height of a pulse, DN; 0: no intensifier, light arrives as electrons.
    height_variance
        Variance of the heights over their squared mean, dimensionless.
    electron_gain_dn
        K, DN per electron of the CCD; 0: their own noise is none.
    blur
        Parameters of the blur as `charact.noise.gain.model.transfer` takes them, shape (6,); None: no blur.
    reading
        How the light is read.
    kept
        Share of the glow that is left one exposure later, dimensionless.
    """

    pulse_dn: float
    height_variance: float
    electron_gain_dn: float
    blur: NDArray[np.float64] | None = None
    reading: PixelReadoutModel = field(default_factory=PixelReadoutModel)
    kept: float = 0.0

    def frames(self, light_dn: Array, count: int, every: int, rng: np.random.Generator) -> Array:
        """Draw exposures, `every` so many one of them, shape (count, row, col), DN above the dark.

        Parameters
        ----------
        light_dn
            Mean signal of every pixel, shape (row, col), DN.
        """
        if not self.pulse_dn:
            return self._electrons(np.broadcast_to(light_dn, (count, *light_dn.shape)), rng)
        before = int(min(np.ceil(np.log(FAINTEST) / np.log(self.kept)), LONGEST)) if self.kept > FAINTEST else 0
        blur = self._blur(light_dn.shape)
        glow, out = light_dn.astype(float), []
        for number in range(-before, 1 + (count - 1) * every):
            glow = self.kept * glow + (1.0 - self.kept) * self._pulses(light_dn, blur, rng)
            if number >= 0 and number % every == 0:
                out.append(glow)
        return self._electrons(np.array(out), rng)

    def _pulses(self, light_dn: Array, blur: Array | None, rng: np.random.Generator) -> Array:
        """Light of the pulses of one exposure."""
        number = rng.poisson(light_dn / self.pulse_dn)
        light = number * self.pulse_dn
        if self.height_variance > 0:
            light = self.pulse_dn * self.height_variance * rng.standard_gamma(number / self.height_variance)
        if blur is None:
            return light
        return np.fft.irfft2(np.fft.rfft2(light) * blur, s=light.shape)

    def _blur(self, shape: tuple[int, int]) -> Array | None:
        """Transfer at every frequency of an image."""
        if self.blur is None:
            return None
        column, row = np.meshgrid(np.fft.rfftfreq(shape[1]), np.abs(np.fft.fftfreq(shape[0])) / self.reading.row_pitch)
        frequency = column.ravel().astype(float), row.ravel().astype(float)
        power = model.transfer(self.blur[None], *frequency, self.reading)[0]
        return np.sqrt(power).reshape(column.shape)

    def _electrons(self, light_dn: Array, rng: np.random.Generator) -> Array:
        """The same counted in electrons."""
        if not self.electron_gain_dn:
            return light_dn
        return self.electron_gain_dn * rng.poisson(np.maximum(light_dn, 0.0) / self.electron_gain_dn)


def pulse_noise(posterior: Posterior, index: int, share: float, reading: PixelReadoutModel, rng: np.random.Generator
              ) -> LightNoise:  # fmt: skip
    """Return the noise of an intensified camera at one draw of the model of the noise spectrum.

    Parameters
    ----------
    posterior, index
        Draws of `charact.noise.gain.model`, and which of them.
    share
        Covariance over signal of this level over that of all, dimensionless.
    reading
        How the light is read.
    rng
        Generator of what the spectrum does not tell.

    Notes
    -----
    The spectrum tells k F^2 and not how unequal pulses are: their relative variance is drawn from its prior. A screen
    that keeps the share r from one exposure to the next shows (1 - r) / (1 + r) of the covariance in one of them.
    """
    at = {name: float(posterior[name][index]) for name in (*model.NAMES, "lag_factor")}
    electrons = max(at["electron_share"], 0.0)
    spread = float(rng.uniform(*HEIGHTS))
    factor = max(at["lag_factor"], 1.0)
    return LightNoise(
        pulse_dn=share * at["power"] * factor * (1.0 - electrons) / (1.0 + spread),
        height_variance=spread,
        electron_gain_dn=share * at["power"] * electrons,
        blur=np.array([at[name] for name in model.NAMES]),
        reading=reading,
        kept=(factor - 1.0) / (factor + 1.0),
    )


def electron_noise(gain_dn: float, excess_factor: float) -> LightNoise:
    """Return the noise of a camera without an intensifier; F^2 of a register is one plus the variance of its heights.

    `gain_dn` is the gain per electron, DN.
    """
    if excess_factor > 1.0:
        return LightNoise(pulse_dn=gain_dn, height_variance=excess_factor - 1.0, electron_gain_dn=0.0)
    return LightNoise(pulse_dn=0.0, height_variance=0.0, electron_gain_dn=gain_dn)
