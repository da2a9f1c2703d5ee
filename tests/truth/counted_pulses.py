"""Cameras of exactly known gain, made here from counted pulses: no simulator of ours is asked for
its opinion.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from charact.method import Context
from labdata import Conditions, FrameStack, Session
from tests.truth.sessions import session_in_memory, stack_in_memory

MARGIN = 16
QUICK = Context(seed=1, quick=True)
METHODS = ("covariance-sum", "variance")


def one(result, quantity: str, unit: str | None = None) -> Any:
    """The only measurement of a quantity."""
    (measurement,) = (m for m in result.find(quantity) if unit in (None, m.unit))
    return measurement


def errors(measurement, truth: float) -> float:
    """Distance from the truth in standard errors."""
    low, high = measurement.interval68
    return (measurement.value - truth) / (0.5 * (high - low))


def gaussian(sigma_px: float) -> Callable[[Any], Any]:
    """Transfer of a Gaussian blur."""
    return lambda f: np.exp(-2.0 * (np.pi * f * sigma_px) ** 2)


@dataclass(frozen=True, kw_only=True)
class Pulses:
    """An intensified camera: Poisson counts, exponential pulse heights, blur, memory of earlier
    frames, read noise.

    `transfer` maps frequency (cy/px) to the transfer of the blur after the gain; none leaves the
    noise white. With `gain_dn` = 0 the camera has no intensifier and K = `electron_gain_dn`.
    `smoothing_px` is a Gaussian that the camera lays over the finished image; `bend_per_dn` the
    share of the response lost per DN of signal; `offset_dn` the spread of the pixels' dark levels.
    """

    gain_dn: float = 20.0
    electron_gain_dn: float = 0.05
    transfer: Callable[[Any], Any] | None = None
    memory: tuple[float, ...] = (1.0,)
    read_noise_dn: float = 2.0
    black_dn: float = 100.0
    full_scale_dn: float = 65535.0
    pattern: float = 0.0
    offset_dn: float = 0.0
    smoothing_px: float = 0.0
    bend_per_dn: float = 0.0
    shape: tuple[int, int] = (192, 256)
    light_of_frame: Callable[[int], float] = field(default=lambda frame: 1.0)

    def frames(self, rng: np.random.Generator, level: float, count: int) -> FrameStack:
        """Frames of `level` photoelectrons (or electrons) per pixel."""
        rows, cols = (length + 2 * MARGIN for length in self.shape)
        before = len(self.memory) - 1
        blur = self._transfer(rows, cols)
        light = [
            self._light(rng, level * self.light_of_frame(max(0, n - before)), (rows, cols), blur)
            for n in range(count + before)
        ]
        mixed = [
            sum(w * light[n + before - j] for j, w in enumerate(self.memory)) for n in range(count)
        ]
        gains = 1.0 + self.pattern * np.random.default_rng(7).standard_normal(self.shape)
        inner = np.s_[MARGIN:-MARGIN, MARGIN:-MARGIN]
        data = np.stack([self._read(rng, image[inner] * gains) for image in mixed])
        return FrameStack(data=data, full_scale_dn=self.full_scale_dn)

    def _transfer(self, rows: int, cols: int) -> Any:
        """Transfer of the blur at the frequencies of a frame with its margin."""
        radius = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(cols)[None, :])
        return None if self.transfer is None else self.transfer(radius)

    def _light(self, rng: np.random.Generator, level: float, shape: tuple[int, int], blur: Any):
        if not self.gain_dn:
            return np.full(shape, level * self.electron_gain_dn)
        count = rng.poisson(level, shape)
        heights = np.zeros(shape)
        heights[count > 0] = rng.gamma(count[count > 0], self.gain_dn)
        return heights if blur is None else np.fft.irfft2(np.fft.rfft2(heights) * blur, s=shape)

    def _read(self, rng: np.random.Generator, dn):
        charge = rng.poisson(np.clip(dn / self.electron_gain_dn, 0, None)) * self.electron_gain_dn
        bent = charge * (1.0 - self.bend_per_dn * charge)
        level = self.black_dn
        if self.offset_dn:
            level = level + self.offset_dn * np.random.default_rng(11).standard_normal(dn.shape)
        read = level + bent + self.read_noise_dn * rng.standard_normal(dn.shape)
        if self.smoothing_px:
            read = gaussian_filter(read, self.smoothing_px, mode="wrap")
        return np.clip(np.rint(read), 0, self.full_scale_dn).astype(np.uint16)

    @property
    def covariance_gain_dn(self) -> float:
        """K + k F^2 with F^2 = 2 for exponential pulse heights."""
        return self.electron_gain_dn + 2.0 * self.gain_dn


def memory_of(fraction: float) -> tuple[float, ...]:
    """Light of a screen that keeps a share from frame to frame, as far back as a thousandth."""
    if not fraction:
        return (1.0,)
    weights = (1.0 - fraction) * fraction ** np.arange(
        int(np.ceil(np.log(1e-3) / np.log(fraction))) + 1
    )
    return tuple(weights / weights.sum())


def session_of(stacks: list[tuple[str, str, FrameStack, Conditions]]) -> Session:
    """A session of stacks in memory: label, kind, frames, conditions."""
    return session_in_memory(
        stack_in_memory(kind, frames, conditions, label=label)
        for label, kind, frames, conditions in stacks
    )


def flat_series(
    camera: Pulses,
    rng: np.random.Generator,
    levels: tuple[float, ...],
    *,
    frames: int = 8,
    dark_frames: int = 16,
    tube: bool = True,
) -> Session:
    """Darks and flats; the light is recorded as illuminance in proportion to the level, and a
    tube's voltage.
    """
    state = {"mcp_v": 800.0} if camera.gain_dn and tube else {}
    stacks = []
    if dark_frames:
        stacks.append(
            (
                "dark",
                "dark",
                camera.frames(rng, 0.0, dark_frames),
                Conditions(illuminance_lux=0.0, **state),
            )
        )
    for index, level in enumerate(levels):
        lit = camera.frames(rng, level, frames)
        stacks.append((f"flat-{index}", "flat", lit, Conditions(illuminance_lux=level, **state)))
    return session_of(stacks)
