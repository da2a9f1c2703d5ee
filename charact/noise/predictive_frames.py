"""Simulated light noise of one posterior draw: pulses with blur and image lag, and electrons."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from charact.noise.gain import model
from charact.noise.gain.model import PixelReadoutModel
from charact.noise.thresholds import PREDICTIVE
from labdata.measurement import Posterior

Array = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class LightNoise:
    """Noise of uniform light for one posterior draw."""

    pulse_dn: float  # mean pulse height, DN; 0: no intensifier
    height_variance: float  # relative variance of the pulse heights, dimensionless
    electron_gain_dn: float  # K, DN per electron of the CCD; 0: no electron noise
    blur: NDArray[np.float64] | None = None  # parameters of `charact.noise.gain.model.transfer`; None: no blur
    reading: PixelReadoutModel = field(default_factory=PixelReadoutModel)  # pixel readout
    kept: float = 0.0  # fraction of the light left one exposure later, dimensionless

    def frames(self, light_dn: Array, count: int, every: int, rng: np.random.Generator) -> Array:
        """Draw every `every`-th of successive exposures, shape (count, row, col), DN above the dark.

        `light_dn`: mean signal of every pixel, shape (row, col), DN.
        """
        if not self.pulse_dn:
            return self._electrons(np.broadcast_to(light_dn, (count, *light_dn.shape)), rng)
        before = (
            int(min(np.ceil(np.log(PREDICTIVE.min_lag) / np.log(self.kept)), PREDICTIVE.max_exposures))
            if self.kept > PREDICTIVE.min_lag
            else 0
        )
        blur = self._blur(light_dn.shape)
        glow, out = light_dn.astype(float), []
        for number in range(-before, 1 + (count - 1) * every):
            glow = self.kept * glow + (1.0 - self.kept) * self._pulses(light_dn, blur, rng)
            if number >= 0 and number % every == 0:
                out.append(glow)
        return self._electrons(np.array(out), rng)

    def _pulses(self, light_dn: Array, blur: Array | None, rng: np.random.Generator) -> Array:
        """Return the light of the pulses of one exposure."""
        number = rng.poisson(light_dn / self.pulse_dn)
        light = number * self.pulse_dn
        if self.height_variance > 0:
            light = self.pulse_dn * self.height_variance * rng.standard_gamma(number / self.height_variance)
        if blur is None:
            return light
        return np.fft.irfft2(np.fft.rfft2(light) * blur, s=light.shape)

    def _blur(self, shape: tuple[int, int]) -> Array | None:
        """Return the transfer at every frequency of an image."""
        if self.blur is None:
            return None
        column, row = np.meshgrid(np.fft.rfftfreq(shape[1]), np.abs(np.fft.fftfreq(shape[0])) / self.reading.row_pitch)
        frequency = column.ravel().astype(float), row.ravel().astype(float)
        power = model.transfer(self.blur[None], *frequency, self.reading)[0]
        return np.sqrt(power).reshape(column.shape)

    def _electrons(self, light_dn: Array, rng: np.random.Generator) -> Array:
        """Return the light with shot noise of electrons."""
        if not self.electron_gain_dn:
            return light_dn
        return self.electron_gain_dn * rng.poisson(np.maximum(light_dn, 0.0) / self.electron_gain_dn)


def pulse_noise(posterior: Posterior, index: int, share: float, reading: PixelReadoutModel, rng: np.random.Generator
              ) -> LightNoise:  # fmt: skip
    """Return the noise of an intensified camera for one draw of the noise-spectrum model.

    `posterior`, `index`: draws of `charact.noise.gain.model`, and the index of one; `share`: covariance over signal of
    this level over the pooled one, dimensionless; `reading`: pixel readout; `rng`: generator for the pulse-height
    variance.

    The spectrum gives k F^2; the relative variance of heights is drawn from its prior. Image lag that leaves the
    fraction r per exposure lowers the covariance of one exposure by (1 - r) / (1 + r).
    """
    at = {name: float(posterior[name][index]) for name in (*model.NAMES, "lag_factor")}
    electrons = max(at["electron_share"], 0.0)
    spread = float(rng.uniform(*PREDICTIVE.height_variances))
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
    """Return the noise of a camera without an intensifier; F^2 of a register is one plus the relative variance of
    heights.

    `gain_dn` is the gain per electron, DN.
    """
    if excess_factor > 1.0:
        return LightNoise(pulse_dn=gain_dn, height_variance=excess_factor - 1.0, electron_gain_dn=0.0)
    return LightNoise(pulse_dn=0.0, height_variance=0.0, electron_gain_dn=gain_dn)
