"""Dark frames of exactly known pulses, event by event, from no simulator and no formula of the analysis."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from charact.study.flats.flat_cases import InMemoryStack
from labdata.conditions import Conditions
from labdata.frames import FrameStack
from labdata.session import Session

Array = NDArray[np.float64]

# Pulses that fall beside the image still send light into it from so far, px.
OUTSIDE_PX = 12
# Light of earlier exposures is followed for so many.
FOLLOWED = 24
# Light of a pulse below this is none, DN.
LEAST_DN = 0.02


@dataclass(frozen=True, kw_only=True)
class DarkScene:
    """Dark frames of an intensified camera, with one knob for each way in which counting photoelectrons breaks.

    Parameters
    ----------
    density
        Detected events per pixel and exposure; of interlaced frames, per pixel of a field, which holds two rows.
    height_dn, relative_variance
        Mean pulse height, DN, and relative variance of the gamma law of heights; 0: all alike.
    spot_px
        Standard deviation of the Gaussian spot, px; pixels gather its light over their area.
    read_noise_dn, offset_dn, pattern_dn, full_scale_dn
        White noise, mean level, standard deviation of the pixels' levels, highest code, DN.
    ions, ion_height_dn
        Ion events per pixel and exposure, and their mean height, DN, gamma of shape 10.
    glow
        Share of a pulse's light that the screen gives off slowly.
    glow_exposures, fast_exposures
        Times in which the slow light and the rest fall to 1/e, exposures.
    interlaced
        Whether frames are made of two fields, each exposed by itself, whose pixels gather the light of two rows.
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
    glow_exposures: float = 2.0
    fast_exposures: float = 0.0
    interlaced: bool = False
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
        for number in range(self.frames):
            frame = light[number]
            noise = self.read_noise_dn * rng.standard_normal(frame.shape)
            noise += hot * 40.0 * self.read_noise_dn * (rng.random(frame.shape) < 0.3)
            codes.append(np.clip(np.rint(level + frame + noise), 0, self.full_scale_dn).astype(np.uint16))
        stack = FrameStack(data=np.stack(codes), full_scale_dn=self.full_scale_dn)
        conditions = Conditions(exposure_s=self.exposure_s, mcp_v=800.0)
        entry = InMemoryStack(label="dark", kind="dark", frames="", conditions=conditions, folder=Path("."), held=stack)
        return Session(folder=Path("."), name="darks of known pulses", stacks=(entry,))

    def _light(self, rng: np.random.Generator) -> Array:
        """Light of all frames, DN, shape (frame, row, col); the screen has glowed for long when they begin."""
        fields = 2 if self.interlaced else 1
        out = np.zeros((self.frames, self.rows, self.cols))
        before = FOLLOWED if self.glow or self.fast_exposures else 0
        for exposure in range(-before, fields * self.frames):
            y, x, height = self._events(rng)
            share = self._shares(rng.random(len(height)))
            for late in range(share.shape[1]):
                # What no code would ever show takes time for nothing.
                if len(height) == 0 or np.max(share[:, late] * height) < LEAST_DN:
                    break
                frame, field = divmod(exposure + late, fields)
                if not 0 <= frame < self.frames:
                    continue
                rows = out[frame, field::fields]
                # A field's pixel gathers two rows from its own on.
                rows += self._spots((y - 0.5 * field * (fields - 1)) / fields, x, height * share[:, late], len(rows))
        return out

    def _events(self, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        """Rows and columns of one exposure's events, in rows of the frame, and their heights, DN."""
        rows, cols = self.rows + 4 * OUTSIDE_PX, self.cols + 2 * OUTSIDE_PX
        area = rows * cols / (2.0 if self.interlaced else 1.0)
        count, ions = rng.poisson(self.density * area), rng.poisson(self.ions * area)
        height = np.full(count, self.height_dn)
        if self.relative_variance > 0:
            height = height * rng.gamma(1.0 / self.relative_variance, self.relative_variance, count)
        height = np.concatenate([height, self.ion_height_dn * rng.gamma(10.0, 0.1, ions)])
        return (rng.uniform(0.0, rows, len(height)) - 2 * OUTSIDE_PX,
                rng.uniform(0.0, cols, len(height)) - OUTSIDE_PX, height)  # fmt: skip

    def _shares(self, moment: Array) -> Array:
        """Shares of the light in each event's own and the following exposures, shape (event, exposure)."""
        if not self.glow and not self.fast_exposures:
            return np.ones((len(moment), 1))
        late = np.zeros((len(moment), FOLLOWED + 1))
        for share, time in ((self.glow, self.glow_exposures), (1.0 - self.glow, self.fast_exposures)):
            if time > 0:
                late += share * np.exp(-(np.arange(1.0, FOLLOWED + 2) - moment[:, None]) / time)
        return np.concatenate([1.0 - late[:, :1], late[:, :-1] - late[:, 1:]], axis=1)

    def _spots(self, y: Array, x: Array, height: Array, rows: int) -> Array:
        """Sum of spots at places in rows of the exposure and in columns, shape (row, col)."""
        from scipy.special import ndtr

        reach = int(np.ceil(5.0 * self.spot_px)) + 1
        step = np.arange(-reach, reach + 2)
        high, wide = rows + 2 * (reach + 1), self.cols + 2 * (reach + 1)
        inside = (y > -reach) & (y < rows + reach) & (x > -reach) & (x < self.cols + reach)
        y, x, height = y[inside] + reach + 1, x[inside] + reach + 1, height[inside]
        row, col = np.floor(y).astype(int), np.floor(x).astype(int)
        across, along = max(self.spot_px, 1e-6), max(self.spot_px, 1e-6) / (2.0 if self.interlaced else 1.0)
        down = np.diff(ndtr((row[:, None] + step - y[:, None]) / along), axis=1) * height[:, None]
        over = np.diff(ndtr((col[:, None] + step - x[:, None]) / across), axis=1)
        places = ((row[:, None] + step[:-1])[:, :, None] * wide) + (col[:, None] + step[:-1])[:, None, :]
        kept = (row[:, None] + step[:-1] >= 0) & (row[:, None] + step[:-1] < high)
        fits = kept[:, :, None] & ((col[:, None] + step[:-1] >= 0) & (col[:, None] + step[:-1] < wide))[:, None, :]
        light = down[:, :, None] * over[:, None, :]
        image = np.asarray(np.bincount(places[fits], light[fits], high * wide), np.float64).reshape(high, wide)
        cut = reach + 1
        return image[cut : cut + rows, cut : cut + self.cols]
