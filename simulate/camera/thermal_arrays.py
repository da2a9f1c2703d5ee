"""Stages of infrared arrays: thermal lag, noise and fixed pattern of bolometers and of cooled
photodiodes.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Self

import numpy as np

from labdata.conditions import Conditions
from simulate.arrays import Array
from simulate.camera.chain import Stage, values_of
from simulate.camera.stage_image import StageImage
from simulate.camera.thermal_lens import KELVIN, Slot


@lru_cache(maxsize=8)
def _pattern(seed: tuple[int, ...], shape: tuple[int, int]) -> Array:
    """A fixed pattern of standard deviation 1, shape (row, col)."""
    return np.random.default_rng(seed).standard_normal(shape, np.float32)


@dataclass(frozen=True, kw_only=True)
class ThermalLag(
    Stage, slot=Slot.LAG, section="bolometer", takes="signal of pixels", emits="signal of samples"
):
    """Thermal time constant of a bolometer: exp(-T / tau) of the frame before stays; the first
    frame is steady.
    """

    effects: ClassVar = {"thermal lag": {"carry_over": 0.0}}
    carry_over: float

    @classmethod
    def of(cls, camera: Any, conditions: Conditions) -> Self:
        tau_ms = float(camera.description.bolometer.time_constant_ms)
        return cls(carry_over=float(np.exp(-1e3 * camera.frame_s / tau_ms)))

    def mean(self, light: StageImage) -> StageImage:
        if light.values.ndim < 3 or not self.carry_over:
            return light
        lagged = np.array(light.values)
        for frame in range(1, len(lagged)):
            lagged[frame] += self.carry_over * (lagged[frame - 1] - lagged[frame])
        return light.with_values(lagged)


@dataclass(frozen=True, kw_only=True)
class BolometerNoise(
    Stage, slot=Slot.NOISE, section="bolometer", takes="signal of samples", emits="noisy signal"
):
    """Temporal noise of single pixels, and that common to a row, a column and a frame."""

    effects: ClassVar = {
        "white noise": {"sigma": 0.0},
        "row, column and frame noise": {"row": 0.0, "column": 0.0, "frame": 0.0},
    }
    sigma: float
    row: float
    column: float
    frame: float

    @classmethod
    def of(cls, camera: Any, conditions: Conditions) -> Self:
        sigma, section = camera.sigma(), camera.description.bolometer
        return cls(
            sigma=sigma,
            row=sigma * float(section.row_noise),
            column=sigma * float(section.column_noise),
            frame=sigma * float(section.frame_noise),
        )

    def mean(self, light: StageImage) -> StageImage:
        return light

    def draw(self, light: StageImage, rng: np.random.Generator) -> StageImage:
        rows, cols = light.values.shape
        noise = rng.standard_normal((rows, cols), np.float32) * np.float32(self.sigma)
        noise += self.row * rng.standard_normal((rows, 1)) + self.column * rng.standard_normal(cols)
        return light.with_values(light.values + noise + self.frame * rng.standard_normal())


@dataclass(frozen=True, kw_only=True)
class BolometerPattern(
    Stage, slot=Slot.PATTERN, section="bolometer", takes="noisy signal", emits="corrected signal"
):
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

    @classmethod
    def of(cls, camera: Any, conditions: Conditions) -> Self:
        """Return the pattern just after a shutter."""
        sigma, section = camera.sigma(), camera.description.bolometer
        return cls(
            seed=camera.pattern_seed,
            time_s=0.0,
            interval_s=float(section.shutter_interval_s),
            after=sigma * float(section.pixel_pattern_after_shutter),
            before=sigma * float(section.pixel_pattern_before_shutter),
            column=sigma * float(section.column_pattern),
            row=sigma * float(section.row_pattern),
            drift_per_s=float(section.drift_mk_per_min) * 1e-3 / 60.0 * camera.signal_slope(),
        )

    def mean(self, light: StageImage) -> StageImage:
        rows, cols = light.values.shape[-2:]
        shutter, age_s = divmod(self.time_s, self.interval_s)
        drift = np.sqrt(max(self.before**2 - self.after**2, 0.0) * age_s / self.interval_s)
        pattern = self.after * _pattern((self.seed, 20), (rows, cols))
        pattern += drift * _pattern((self.seed, 21, int(shutter)), (rows, cols))
        pattern += self.column * _pattern((self.seed, 22), (1, cols)) + self.row * _pattern(
            (self.seed, 23), (rows, 1)
        )
        return light.with_values(light.values + (pattern + self.drift_per_s * age_s))


@dataclass(frozen=True, kw_only=True)
class PhotonNoise(
    Stage, slot=Slot.NOISE, section="cooled_array", takes="signal of pixels", emits="noisy signal"
):
    """Photon noise of the electrons of an exposure, the well, and the noise of reading."""

    effects: ClassVar = {"photon noise": {"photon": 0.0}, "read noise": {"read_noise_e": 0.0}}
    full_well_e: float
    read_noise_e: float
    photon: float = 1.0

    @classmethod
    def of(cls, camera: Any, conditions: Conditions) -> Self:
        return values_of(cls, camera.description.cooled_array)

    def mean(self, light: StageImage) -> StageImage:
        return light.with_values(np.minimum(light.values, self.full_well_e))

    def draw(self, light: StageImage, rng: np.random.Generator) -> StageImage:
        electrons = light.values
        shot = self.photon * np.sqrt(np.maximum(electrons, 0.0))
        # Wells hold 1e4 electrons and more, whose number is normal.
        charge = np.minimum(
            electrons + shot * rng.standard_normal(electrons.shape, np.float32), self.full_well_e
        )
        return light.with_values(
            charge + self.read_noise_e * rng.standard_normal(electrons.shape, np.float32)
        )


@dataclass(frozen=True, kw_only=True)
class TwoPointCorrection(
    Stage, slot=Slot.PATTERN, section="cooled_array", takes="noisy signal", emits="corrected signal"
):
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

    @classmethod
    def of(cls, camera: Any, conditions: Conditions) -> Self:
        section = camera.description.cooled_array
        low_k, high_k = (
            float(celsius) + KELVIN
            for celsius in (section.correction_low_c, section.correction_high_c)
        )
        sigma = camera.sigma(0.5 * (low_k + high_k))
        return cls(
            seed=camera.pattern_seed,
            low=float(camera.signal_of(low_k)),
            high=float(camera.signal_of(high_k)),
            midway=sigma * float(section.correction_residual),
            pixel=sigma * float(section.pixel_pattern),
        )

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
