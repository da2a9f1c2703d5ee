"""Dark frames of exactly known pulses, event by event, from no simulator and no formula of the analysis."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from charact.study.flats import HeldStack
from labdata.conditions import Conditions
from labdata.frames import FrameStack
from labdata.session import Session

# Pulses that fall beside the image still send light into it from so far, px.
BESIDE_PX = 12


@dataclass(frozen=True, kw_only=True)
class DarkScene:
    """Dark frames of an intensified camera, with one knob for each way in which counting photoelectrons breaks.

    Parameters
    ----------
    density
        Detected events per pixel and frame.
    height_dn, relative_variance
        Mean pulse height, DN, and relative variance of the gamma law of heights; 0: all alike.
    spot_px
        Standard deviation of the Gaussian spot, px; pixels gather its light over their area.
    read_noise_dn, offset_dn, pattern_dn, full_scale_dn
        White noise, mean level, standard deviation of the pixels' levels, highest code, DN.
    ions, ion_height_dn
        Ion events per pixel and frame, and their mean height, DN, gamma of shape 10.
    glow
        Share of a pulse's light that each frame hands on to the next.
    hot
        Share of the pixels that flicker by themselves.
    frames, rows, cols
        Size of the stack.
    exposure_s
        Exposure, s; None leaves it unknown.
    """

    density: float = 0.01
    height_dn: float = 80.0
    relative_variance: float = 1.0
    spot_px: float = 0.7
    read_noise_dn: float = 2.0
    offset_dn: float = 100.3
    pattern_dn: float = 1.0
    full_scale_dn: float = 4095.0
    ions: float = 0.0
    ion_height_dn: float = 2500.0
    glow: float = 0.0
    hot: float = 0.0
    frames: int = 64
    rows: int = 128
    cols: int = 128
    exposure_s: float | None = 0.02

    def session_drawn(self, rng: np.random.Generator) -> Session:
        """Draw the dark stack as a session."""
        level = self.offset_dn + self.pattern_dn * rng.standard_normal((self.rows, self.cols))
        hot = rng.random((self.rows, self.cols)) < self.hot
        light, codes = self._light(rng), []
        for _ in range(self.frames):
            light = (1.0 - self.glow) * self._light(rng) + self.glow * light if self.glow else self._light(rng)
            noise = self.read_noise_dn * rng.standard_normal(light.shape)
            noise += hot * 40.0 * self.read_noise_dn * (rng.random(light.shape) < 0.3)
            codes.append(np.clip(np.rint(level + light + noise), 0, self.full_scale_dn).astype(np.uint16))
        stack = FrameStack(data=np.stack(codes), full_scale_dn=self.full_scale_dn)
        conditions = Conditions(exposure_s=self.exposure_s, mcp_v=800.0)
        entry = HeldStack(label="dark", kind="dark", frames="", conditions=conditions, folder=Path("."), held=stack)
        return Session(folder=Path("."), name="darks of known pulses", stacks=(entry,))

    def _light(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Light of the events of one frame, DN, shape (row, col)."""
        rows, cols = self.rows + 2 * BESIDE_PX, self.cols + 2 * BESIDE_PX
        count = rng.poisson(self.density * rows * cols)
        height = np.full(count, self.height_dn)
        if self.relative_variance > 0:
            height = height * rng.gamma(1.0 / self.relative_variance, self.relative_variance, count)
        ions = rng.poisson(self.ions * rows * cols)
        height = np.concatenate([height, self.ion_height_dn * rng.gamma(10.0, 0.1, ions)])
        y, x = rng.uniform(0.0, rows, len(height)), rng.uniform(0.0, cols, len(height))
        return self._spots(y, x, height, rows, cols)

    def _spots(self, y, x, height, rows: int, cols: int) -> NDArray[np.float64]:
        """Sum of spots at places counted from the corner, the borders cut off."""
        from scipy.special import ndtr

        reach = int(np.ceil(5.0 * self.spot_px)) + 1
        step = np.arange(-reach, reach + 2)
        image = np.zeros((rows + 2 * reach, cols + 2 * reach))
        row, col = np.floor(y).astype(int), np.floor(x).astype(int)
        width = max(self.spot_px, 1e-6)
        down = np.diff(ndtr((row[:, None] + step - y[:, None]) / width), axis=1) * height[:, None]
        across = np.diff(ndtr((col[:, None] + step - x[:, None]) / width), axis=1)
        for index, offset in enumerate(step[:-1]):
            place = row[:, None] + offset + reach, col[:, None] + step[:-1] + reach
            np.add.at(image, place, down[:, index : index + 1] * across)
        cut = reach + BESIDE_PX
        return image[cut : cut + self.rows, cut : cut + self.cols]
