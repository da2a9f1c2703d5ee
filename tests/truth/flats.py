"""Flat series of exactly known covariance gain: counted pulses through an exact cascade, from no
simulator.
"""

from dataclasses import dataclass

import numpy as np

from labdata import Array, FrameStack, Kind, Session, StackEntry
from tests.truth.sessions import session_in_memory, tube_stack


@dataclass(frozen=True, kw_only=True)
class FlatScene:
    """A flat series of an intensified camera, with one knob for each way in which gain estimators
    break.
    """

    photoelectron_gain_dn: float = 20.0  # k, DN per photoelectron
    # F^2 = 1 + relative variance of the pulse heights; every photoelectron is detected. 1: equal
    # pulses. 0: a camera without an intensifier, whose light comes without pulses
    excess_noise_factor: float = 2.0
    electron_gain_dn: float = 0.05  # K, DN per CCD electron
    blur_px: float = 0.6  # standard deviation of the Gaussian blur after the gain, px
    # frequency fc of the blur exp(-(f/fc)^1.2) of an image tube that comes on top, cycles per px;
    # infinite: none
    wings_cy_per_px: float = np.inf
    # mean photoelectrons per pixel and frame at each level; the first stack is dark
    photoelectrons: tuple[float, ...] = (2.0, 4.0, 8.0, 16.0, 32.0)
    # rows, cols, frames: size of each stack
    rows: int = 192
    cols: int = 256
    frames: int = 24
    # read_noise_dn, black_dn, full_scale_dn: white read noise, offset and highest code, DN
    read_noise_dn: float = 1.5
    black_dn: float = 60.0
    full_scale_dn: float = 4095.0
    lag: float = 0.0  # share of a frame's light that returns in the next, dimensionless
    flicker: float = 0.0  # relative standard deviation of the light from frame to frame
    # whether an automatic gain holds the mean of every level at that of the brightest
    agc: bool = False
    # standard deviation of a Gaussian that smooths the frames as recorded, px: noise of the camera
    # shared afterwards
    resampling_px: float = 0.0

    @property
    def truth_covariance_gain(self) -> float:
        """K + k F^2, DN (Poisson pulses of random height, each unfolded into Poisson electrons)."""
        return self.electron_gain_dn + self.photoelectron_gain_dn * self.excess_noise_factor

    def session_drawn(self, rng: np.random.Generator) -> Session:
        """Draw the dark stack and one flat stack for each level."""
        levels = (0.0, *self.photoelectrons)
        stacks = tuple(self._entry(number, level, rng) for number, level in enumerate(levels))
        return session_in_memory(stacks, name="flats of known gain")

    def _entry(self, number: int, level: float, rng: np.random.Generator) -> StackEntry:
        kind: Kind = "flat" if number else "dark"
        light = self._light(level, rng)
        if self.agc and number:
            light = light * max(self.photoelectrons) / level
        noisy = self.black_dn + light + self.read_noise_dn * rng.standard_normal(light.shape)
        if self.resampling_px > 0:
            from scipy.ndimage import gaussian_filter

            noisy = gaussian_filter(noisy, (0, self.resampling_px, self.resampling_px), mode="wrap")
        codes = np.clip(np.rint(noisy), 0, self.full_scale_dn).astype(np.uint16)
        stack = FrameStack(
            data=codes, time_s=np.arange(self.frames) / 30, full_scale_dn=self.full_scale_dn
        )
        return tube_stack(kind, f"{kind}-{number}", stack, 1e-6 * level)

    def _light(self, level: float, rng: np.random.Generator) -> Array:
        """Light signal, DN, shape (frame, row, col): pulses, blur after the gain, then
        electrons.
        """
        from scipy.ndimage import gaussian_filter

        shape = (self.frames + 1, self.rows, self.cols)
        strength = 1 + self.flicker * rng.standard_normal((self.frames + 1, 1, 1))
        light = np.broadcast_to(np.maximum(level * strength, 0), shape)
        counted = light if self.excess_noise_factor == 0 else rng.poisson(light)
        pulses = _pulse_heights(counted, self.excess_noise_factor, rng) * self.photoelectron_gain_dn
        if self.blur_px > 0:
            pulses = gaussian_filter(
                pulses, (0, self.blur_px, self.blur_px), mode="wrap", truncate=6
            )
        if np.isfinite(self.wings_cy_per_px):
            pulses = _with_wings(pulses, self.wings_cy_per_px)
        lagged = (1 - self.lag) * pulses[1:] + self.lag * pulses[:-1]
        return self.electron_gain_dn * rng.poisson(np.maximum(lagged, 0) / self.electron_gain_dn)


def _with_wings(pulses: Array, frequency_cy_per_px: float) -> Array:
    """Blur by exp(-(f/fc)^1.2), as image tubes do."""
    from scipy.fft import irfft2, rfft2

    rows, cols = pulses.shape[1:]
    radius = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(cols)[None, :])
    return np.asarray(
        irfft2(rfft2(pulses) * np.exp(-((radius / frequency_cy_per_px) ** 1.2)), s=(rows, cols))
    )


def _pulse_heights(counts: Array, factor: float, rng: np.random.Generator) -> Array:
    """Summed heights of pulses of mean 1: a sum of n gamma heights of shape m is gamma of shape n
    m.
    """
    if factor <= 1:
        return counts.astype(float)
    shape = 1 / (factor - 1)
    return rng.standard_gamma(np.maximum(counts, 1e-12) * shape) / shape * (counts > 0)
