"""Strips of rows across long bars: their exact spectrum along one line, through a blur and the
pixel, and noise.
"""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from charact.study.edge.scene import TrueBlur
from charact.study.noise import correlate_noise
from labdata.frames import FrameStack

# Length of the tabulated profile and its step, px; highest frequency of its spectrum, cycles per
# pixel.
PERIOD_PX, STEP_PX, HIGHEST = 4096, 1 / 32, 3


@lru_cache(maxsize=64)
def _profile(blur: TrueBlur, bars: int, frequency: float, angle_deg: float) -> NDArray[np.floating]:
    """Blurred profile across the bars, 1 on a wide bar, every `STEP_PX`, centred."""
    v = np.arange(HIGHEST * PERIOD_PX) / PERIOD_PX
    width = 0.5 / frequency
    places = (np.arange(bars) - (bars - 1) / 2) / frequency
    comb = sum(np.cos(2 * np.pi * place * v) for place in places)
    spectrum = np.zeros(int(PERIOD_PX / STEP_PX) // 2 + 1)
    spectrum[: v.size] = width * np.sinc(v * width) * comb * blur.mtf(v, angle_deg)
    return np.fft.fftshift(np.fft.irfft(spectrum)) / STEP_PX


@dataclass(frozen=True, kw_only=True)
class StripScene:
    """Some rows across bars that run through them, as a camera would digitise them."""

    blur: TrueBlur = field(default_factory=TrueBlur)  # The blur whose MTF is the truth
    # bars, frequency_cy_per_px: number of bars, and their frequency across them
    bars: int = 4
    frequency_cy_per_px: float = 0.12
    # rows, reach_px, frames: rows, ground on either side of the bars, and frames
    rows: int = 20
    reach_px: int = 16
    frames: int = 1
    # angle_deg, phase_px: tilt of the bars from the columns, degrees, and where their middle lies,
    # px
    angle_deg: float = 4.0
    phase_px: float = 0.0
    turned: bool = False  # Whether rows and columns are exchanged: horizontal bars
    # Step of a wide bar over the standard deviation of one pixel's noise, dimensionless
    snr: float = 10.0
    # Gaussian blur of the noise behind the gain, px; the noise of a pixel stays what it is
    noise_blur_px: float = 0.0
    noise_sign: int = 1  # 1, or -1: the same draw with its noise upside down
    # pedestal_dn, level_dn, full_scale_dn: ground, step, and highest code, DN
    pedestal_dn: float = 400.0
    level_dn: float = 1000.0
    full_scale_dn: float = 4095.0

    @property
    def truth_mtf(self) -> float:
        """MTF at the bars' frequency across them, pixel included, dimensionless."""
        return float(self.blur.mtf(self.frequency_cy_per_px, self.angle_deg))

    def light(self) -> NDArray[np.floating]:
        """Noiseless picture, 1 on a wide bar, shape (row, col) before it is turned."""
        cols = int(np.ceil(self.bars / self.frequency_cy_per_px)) + 2 * self.reach_px
        row, col = np.mgrid[: self.rows, :cols]
        angle = np.deg2rad(self.angle_deg)
        across = (col - (cols - 1) / 2 - self.phase_px) * np.cos(angle) + (
            row - (self.rows - 1) / 2
        ) * np.sin(angle)
        profile = _profile(self.blur, self.bars, self.frequency_cy_per_px, self.angle_deg)
        return np.interp(across, (np.arange(profile.size) - profile.size // 2) * STEP_PX, profile)

    def frames_drawn(self, rng: np.random.Generator) -> FrameStack:
        """Draw the stack: the picture, noise, whole codes."""
        light = self.light()
        noise = correlate_noise(
            rng.standard_normal((self.frames, *light.shape)), self.noise_blur_px
        )
        drawn = self.pedestal_dn + self.level_dn * (light + self.noise_sign * noise / self.snr)
        codes = np.clip(np.rint(drawn), 0, self.full_scale_dn).astype(np.uint16)
        if self.turned:
            codes = np.ascontiguousarray(np.swapaxes(codes, 1, 2))
        return FrameStack(data=codes, full_scale_dn=self.full_scale_dn)
