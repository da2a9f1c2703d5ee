"""Spots of closed-form transfer: noise-free pictures by plain sums over frequencies, noise of every
kind on top.

Unlike `tests.truth.point` no photoelectron is drawn, so that a picture without noise
exists; nothing here is shared with the methods measured.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import special

from labdata import FrameStack
from tests.truth.blur import Array, level_crossing
from tests.truth.camera_effects import correlate_noise

# Frequencies, cycles per px: copies of the spot stand 1/step apart and turn their sign.
STEP, TOP = 1.0 / 256.0, 2.0

Form = Literal["gaussian", "exponential", "moffat", "halo"]


@dataclass(frozen=True, kw_only=True)
class Spot:
    """A point as a camera of known transfer shows it.

    Parameters
    ----------
    form
        "gaussian": exp(-2 (pi f s)^2); "exponential": exp(-(f/fc)^n); "moffat": that of (1 +
        r^2/a^2)^-b; "halo": a Gaussian with a share of the light in a disc. A square pixel comes on
        top.
    width
        s, px; fc, cycles per px; a, px; s, px.
    exponent
        n or b.
    stretch
        ln of the ratio of horizontal to vertical frequencies at one level.
    share, disc_px
        Share and diameter of the disc.
    pinhole_px
        Diameter of the source; it is no part of the truth.
    row_px, col_px
        Place off the middle of the frame, px.
    """

    form: Form = "gaussian"
    width: float = 1.0
    exponent: float = 1.4
    stretch: float = 0.0
    share: float = 0.05
    disc_px: float = 20.0
    pinhole_px: float = 0.0
    row_px: float = 0.0
    col_px: float = 0.0

    def blur(self, fx: Array, fy: Array) -> Array:
        """Return the transfer at frequencies along rows and columns, cycles per px, without pixel
        and pinhole.
        """
        f = np.sqrt(fx**2 * np.exp(-self.stretch) + fy**2 * np.exp(self.stretch))
        if self.form == "exponential":
            return np.exp(-((f / self.width) ** self.exponent))
        if self.form == "moffat":
            x, order = np.maximum(2.0 * np.pi * self.width * f, 1e-9), self.exponent - 1.0
            return 2.0 ** (1.0 - order) / special.gamma(order) * x**order * special.kv(order, x)
        core = np.exp(-2.0 * (np.pi * f * self.width) ** 2)
        if self.form == "gaussian":
            return core
        return core * (1.0 - self.share + self.share * _disc(np.hypot(fx, fy), self.disc_px))

    def mtf(self, frequency: Array, *, vertical: bool = False) -> Array:
        """Return the camera's MTF along rows or columns, pixel included."""
        f = np.asarray(frequency, float)
        return self.blur(*((np.zeros_like(f), f) if vertical else (f, np.zeros_like(f)))) * np.sinc(
            f
        )

    def level(self, level: float, *, vertical: bool = False) -> float:
        """Return the lowest frequency at which the MTF falls to a level, cycles per px."""
        return level_crossing(lambda f: self.mtf(np.maximum(f, 1e-9), vertical=vertical), level)

    def picture(self, rows: int, cols: int) -> Array:
        """Return the pixels of unit light, shape (row, col)."""
        f = np.arange(STEP / 2, TOP, STEP)
        transfer = self.blur(f, f[:, None]) * np.sinc(f) * np.sinc(f[:, None])
        transfer *= _disc(np.hypot(f, f[:, None]), self.pinhole_px) * 4.0 * STEP**2
        along = np.cos(2.0 * np.pi * f[:, None] * (np.arange(cols) - (cols - 1) / 2 - self.col_px))
        down = np.cos(2.0 * np.pi * f[:, None] * (np.arange(rows) - (rows - 1) / 2 - self.row_px))
        return down.T @ transfer @ along


def _disc(frequency: Array, diameter_px: float) -> Array:
    u = np.maximum(np.pi * diameter_px * frequency, 1e-9)
    return 2.0 * special.j1(u) / u


@dataclass(frozen=True, kw_only=True)
class SpotCamera:
    """What a camera makes of a spot.

    Parameters
    ----------
    peak_dn
        Height of the brightest pixel above the background, before it is cut at full scale, DN.
    snr
        That height over the noise of one frame at it, dimensionless; infinite: no noise.
    shot_share
        Share of that variance which grows with the light; the rest is the dark noise.
    noise_blur_px
        Standard deviation of a Gaussian that correlates all noise, px; 0: white.
    frames, size
        Number and rows and columns.
    full_scale_dn
        Where values are cut, DN; infinite: nowhere.
    """

    peak_dn: float = 150.0
    snr: float = 30.0
    shot_share: float = 0.5
    noise_blur_px: float = 0.0
    frames: int = 4
    size: int = 72
    full_scale_dn: float = np.inf

    def taken(self, spot: Spot, rng: np.random.Generator) -> FrameStack:
        """Draw frames of a spot: floating-point values, cut at full scale."""
        light = spot.picture(self.size, self.size)
        light *= self.peak_dn / light.max()
        variance = 0.0 if not np.isfinite(self.snr) else (self.peak_dn / self.snr) ** 2
        noise = [
            np.sqrt(variance * (1.0 - self.shot_share)) * self._noise(rng)
            + np.sqrt(np.maximum(variance * self.shot_share * light / self.peak_dn, 0.0))
            * self._noise(rng)
            for _ in range(self.frames if variance else 1)
        ]
        data = np.minimum(20.0 + light + np.array(noise), self.full_scale_dn)
        full = self.full_scale_dn if np.isfinite(self.full_scale_dn) else None
        return FrameStack(data=data, full_scale_dn=full)

    def _noise(self, rng: np.random.Generator) -> Array:
        """Noise of unit variance."""
        return correlate_noise(rng.standard_normal((1, self.size, self.size)), self.noise_blur_px)[
            0
        ]
