"""Stages of infrared arrays: thermal lag, noise and fixed pattern of bolometers and of cooled
photodiodes.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from simulate.camera.chain import Stage
from simulate.camera.stage_image import StageImage
from simulate.camera.thermal_lens import Slot

Array = NDArray[np.floating]


@lru_cache(maxsize=8)
def _pattern(seed: tuple[int, ...], shape: tuple[int, int]) -> Array:
    """A fixed pattern of standard deviation 1, shape (row, col)."""
    return np.random.default_rng(seed).standard_normal(shape, np.float32)


@dataclass(frozen=True, kw_only=True)
class ThermalLag(Stage, slot=Slot.LAG, takes="signal of pixels", emits="signal of samples"):
    """Thermal time constant of a bolometer: exp(-T / tau) of the frame before stays; the first
    frame is steady.
    """

    effects: ClassVar = {"thermal lag": {"carry_over": 0.0}}
    carry_over: float

    def mean(self, light: StageImage) -> StageImage:
        if light.values.ndim < 3 or not self.carry_over:
            return light
        out = np.array(light.values)
        for frame in range(1, len(out)):
            out[frame] += self.carry_over * (out[frame - 1] - out[frame])
        return light.with_values(out)


@dataclass(frozen=True, kw_only=True)
class BolometerNoise(Stage, slot=Slot.NOISE, takes="signal of samples", emits="noisy signal"):
    """Temporal noise of single pixels, and that common to a row, a column and a frame."""

    effects: ClassVar = {
        "white noise": {"sigma": 0.0},
        "row, column and frame noise": {"row": 0.0, "column": 0.0, "frame": 0.0},
    }
    sigma: float
    row: float
    column: float
    frame: float

    def mean(self, light: StageImage) -> StageImage:
        return light

    def draw(self, light: StageImage, rng: np.random.Generator) -> StageImage:
        rows, cols = light.values.shape
        noise = rng.standard_normal((rows, cols), np.float32) * np.float32(self.sigma)
        noise += self.row * rng.standard_normal((rows, 1)) + self.column * rng.standard_normal(cols)
        return light.with_values(light.values + noise + self.frame * rng.standard_normal())


@dataclass(frozen=True, kw_only=True)
class BolometerPattern(Stage, slot=Slot.PATTERN, takes="noisy signal", emits="corrected signal"):
    """Fixed pattern behind the correction by a shutter, which grows until the next one, and drift
    of the housing.

    The variance of the pixels' pattern rises linearly from one shutter to the next; the part that
    has grown is another one after each shutter.
    """

    effects: ClassVar = {
        "fixed pattern": {"after": 0.0, "before": 0.0, "column": 0.0, "row": 0.0},
        "housing drift": {"drift_per_s": 0.0},
    }
    seed: int
    time_s: float  # since the first shutter
    interval_s: float
    after: float
    before: float
    column: float
    row: float
    drift_per_s: float

    def mean(self, light: StageImage) -> StageImage:
        rows, cols = light.values.shape[-2:]
        shutter, age_s = divmod(self.time_s, self.interval_s)
        grown = np.sqrt(max(self.before**2 - self.after**2, 0.0) * age_s / self.interval_s)
        pattern = self.after * _pattern((self.seed, 20), (rows, cols))
        pattern += grown * _pattern((self.seed, 21, int(shutter)), (rows, cols))
        pattern += self.column * _pattern((self.seed, 22), (1, cols)) + self.row * _pattern(
            (self.seed, 23), (rows, 1)
        )
        return light.with_values(light.values + (pattern + self.drift_per_s * age_s))


@dataclass(frozen=True, kw_only=True)
class PhotonNoise(Stage, slot=Slot.NOISE, takes="signal of pixels", emits="noisy signal"):
    """Photon noise of the electrons of an exposure, the well, and the noise of reading."""

    effects: ClassVar = {"photon noise": {"photon": 0.0}, "read noise": {"read_noise_e": 0.0}}
    full_well_e: float
    read_noise_e: float
    photon: float = 1.0

    def mean(self, light: StageImage) -> StageImage:
        return light.with_values(np.minimum(light.values, self.full_well_e))

    def draw(self, light: StageImage, rng: np.random.Generator) -> StageImage:
        electrons = light.values
        shot = self.photon * np.sqrt(np.maximum(electrons, 0.0))
        # Wells hold 1e4 electrons and more, whose number is normal.
        filled = np.minimum(
            electrons + shot * rng.standard_normal(electrons.shape, np.float32), self.full_well_e
        )
        return light.with_values(
            filled + self.read_noise_e * rng.standard_normal(electrons.shape, np.float32)
        )


@dataclass(frozen=True, kw_only=True)
class TwoPointCorrection(Stage, slot=Slot.PATTERN, takes="noisy signal", emits="corrected signal"):
    """What a correction of gain and offset at two black bodies leaves.

    Notes
    -----
    Pixels whose response curves by q_i S^2 keep q_i (S - S_1)(S - S_2): nothing at the two points,
    most midway and beyond. With the pattern that no correction removes, its standard deviation over
    S has the shape of a W.
    """

    effects: ClassVar = {"correction residual": {"midway": 0.0}, "pixel pattern": {"pixel": 0.0}}
    seed: int
    low: float  # signal at the two black bodies
    high: float
    midway: float  # standard deviation midway
    pixel: float

    def mean(self, light: StageImage) -> StageImage:
        shape = light.values.shape[-2:]
        curve = (
            4.0
            * (light.values - self.low)
            * (light.values - self.high)
            / (self.high - self.low) ** 2
        )
        pattern = self.midway * curve * _pattern((self.seed, 24), shape) + self.pixel * _pattern(
            (self.seed, 25), shape
        )
        return light.with_values(light.values + pattern)
