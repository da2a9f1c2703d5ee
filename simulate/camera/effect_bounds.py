"""Noise budget of a frame, the bounded influence of every optional effect, and the selection of
effects.

Bounds follow from the expected photoelectrons and the camera's numbers: no frame is drawn. Every
stage bounds its own effects by the budget, see `Stage.bounds`. Three statistics of every pixel
count, and an effect's influence is the largest change of any of them: the mean, in units of the
temporal noise; the temporal noise itself, relative; and, where the law of the noise changes its
shape, the level that one frame in a thousand exceeds, in units of the noise. Each of the three
changes by no more than the sum of what the effects left out change, so the sum of influences bounds
them all.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from scipy.special import gammainccinv, gammaincinv, ndtri

from labdata import BadInput, Conditions
from simulate.arrays import Array, Mask
from simulate.camera.automatic_controls import UNTOUCHED, AutomaticControls, AutomaticState
from simulate.camera.camera import CameraModel
from simulate.camera.chain import Chain, Slot
from simulate.camera.fast_sampler.kernel import noise_kernel
from simulate.camera.grid import ACCURACY
from simulate.camera.moments import PulseMoments
from simulate.camera.stage_image import StageImage
from simulate.camera.transfer import StageBlur, product
from simulate.effect_selection import (
    DEFAULT_TOLERANCE,
    EffectSelection,
    OptionalEffect,
    select_effects,
)

# Seconds that effects cost for a million pixels, once and a frame, as `python -m benchmarks.economy
# --costs` measures them: medians, which scatter by some 0.05 s and 0.5 ms; what is not here costs
# less than that.
SETUP_S = {
    "pulse-height distribution": 1.5,
    "taper distortion and fibre shear": 0.6,
    "local gain depletion": 0.25,
    "phosphor granularity": 0.15,
    "MCP saturation": 0.15,
    "phosphor decay": 0.1,
    "multi-fibre pattern": 0.1,
}
FRAME_S = {
    "column blooming": 5.3e-3,
    "pulse-height distribution": 2.9e-3,
    "phosphor decay": 1.9e-3,
    "DSNU": 0.7e-3,
}


@dataclass(frozen=True)
class NoiseBudget:
    """Expected light and temporal noise of a frame, from which influences are bounded."""

    camera: CameraModel  # the camera, nothing left out
    # Photoelectrons that light frees per pixel as read and exposure, in the frame and in the margin
    # around it, see `CameraModel.photoelectrons_per_pixel`, shape (row, col).
    photoelectrons: Array
    conditions: Conditions  # gate, voltage and temperature
    # What may change in all, as a fraction of the temporal noise. Variances do not add like
    # standard deviations: how much a fraction of the variance counts depends on how much may be
    # left out.
    tolerance: float = DEFAULT_TOLERANCE
    state: AutomaticState = UNTOUCHED  # where the automatic controls stand
    # A level that noise exceeds so rarely, and how many standard deviations of normal noise it lies
    # above the mean.
    RARE: ClassVar[float] = 1e-3
    RARE_SD: ClassVar[float] = 3.09

    def __post_init__(self) -> None:
        if self.camera.left_out:
            raise BadInput(
                "a plan must begin with all effects, got a camera without "
                f"{sorted(self.camera.left_out)}"
            )

    @cached_property
    def chain(self) -> Chain:
        """The camera's stages, the MCP in the state of the brightness control."""
        return self.camera.chain(self.conditions, replace(self.state, gain=1.0))

    @cached_property
    def of_chain(self) -> PulseMoments:
        """Moments of the pulses of the chain."""
        return PulseMoments(self.chain)

    @property
    def mcp(self) -> Any:
        """The MCP."""
        return self.chain[Slot.MCP]

    @property
    def ccd(self) -> Any:
        """The CCD."""
        return self.chain[Slot.CCD]

    @cached_property
    def dark_pe(self) -> float:
        """Dark photoelectrons per pixel and exposure."""
        cathode = self.chain[Slot.PHOTOCATHODE]
        return cathode.ebi_per_s_cm2 * cathode.open_s * self.camera.field_pixel_area_cm2

    @property
    def cathode_lux(self) -> float:
        """Mean illuminance of 2856 K light over cathode and time, lux."""
        per_cell = np.full((1, 1), self.photoelectrons.mean(dtype=float))
        cells_per_pixel = self.camera.field_pixel_area_cm2 / self.camera.scene_cells.cell_area_cm2
        return self.camera.cathode_lux(StageImage(values=per_cell / cells_per_pixel))

    @cached_property
    def surroundings(self) -> Array:
        """Photoelectrons per pixel and exposure, dark ones included, in the frame and in the margin
        around it.
        """
        return np.asarray(self.photoelectrons, np.float64) + self.dark_pe

    def frame_of(self, scene_map: Array, margin: int = 0) -> Array:
        """Crop a map with the scene margin to the frame and `margin` pixels on each side."""
        offset, (rows, cols) = ACCURACY.scene_margin_px - margin, self.camera.shape
        return scene_map[offset : offset + rows + 2 * margin, offset : offset + cols + 2 * margin]

    @cached_property
    def mean_pe(self) -> Array:
        """Photoelectrons per pixel and exposure, dark ones included, shape (row, col)."""
        return self.frame_of(self.surroundings)

    def load(self, photoelectrons: Array) -> Array:
        """Unsaturated MCP output over its saturation output, from photoelectrons per pixel and
        exposure.
        """
        per_pe = (
            self.mcp.gain
            / self.camera.field_pixel_area_cm2
            / self.mcp.field_s
            / self.mcp.saturation_e_per_s_cm2
        )
        return np.asarray(photoelectrons * per_pe)

    @cached_property
    def mean_load(self) -> float:
        """Load of the whole MCP within the drawing margin."""
        return float(self.load(self.frame_of(self.surroundings, ACCURACY.draw_margin_px)).mean())

    @cached_property
    def charge_e(self) -> float:
        """CCD electrons per photoelectron under the mean load."""
        return max(self.of_chain.gain_e / (1.0 + self.mean_load), 1e-300)

    @cached_property
    def blurs(self) -> tuple[float, float]:
        """Factors by which blur behind the gain reduces the second and third moment of a pulse,
        dimensionless.

        The kernel is the one that frames of many pulses will be drawn with, so that it is worked
        out once.
        """
        height, taps = self.camera.fields_per_frame, self.chain[Slot.VIDEO].taps
        kernel = noise_kernel(
            self.of_chain.blurs, self.camera.cells, height, taps, ACCURACY.skewness_tolerance
        )
        return kernel.blur_factor, kernel.third_factor

    @cached_property
    def pulse_e(self) -> float:
        """CCD electrons of one mean pulse."""
        return self.charge_e / self.mcp.detection_probability

    @cached_property
    def pulses(self) -> tuple[float, float]:
        """Second and third moment of one photoelectron's fraction of a pixel, over the first
        moment, e- and e-^2.
        """
        height_factor = 1.0 + 1.0 / self.mcp.pulse_height_shape
        second = self.pulse_e * height_factor * self.blurs[0] * self.of_chain.decay[0]
        third = (
            self.pulse_e**2
            * height_factor
            * (height_factor + 1.0 / self.mcp.pulse_height_shape)
            * self.blurs[1]
            * self.of_chain.decay[1]
        )
        return second, third

    @cached_property
    def step_e(self) -> float:
        """Quantisation step, e-; 0 with gamma, whose smallest step tends to 0."""
        video = self.camera.description.video
        gain = float(video.conversion_gain_dn_per_e) * self.state.gain
        return 1.0 / gain if float(video.gamma) == 1.0 else 0.0

    @cached_property
    def line_noise_e(self) -> float:
        """Offset common to a line, e-."""
        return self.chain[Slot.VIDEO].line_noise_dn * self.step_e

    @cached_property
    def electronics(self) -> float:
        """Variance of all noise that is there without light, e-^2."""
        return (
            self.of_chain.white * (self.ccd.dark_e + self.ccd.read_noise_e**2)
            + self.line_noise_e**2
        )

    @cached_property
    def of_pulses(self) -> Array:
        """Temporal variance of pulses, ion feedback included, e-^2, shape (row, col)."""
        return self.mean_pe * self.charge_e * (self.pulses[0] + self.of_chain.white) + self.of_ions

    @cached_property
    def ions(self) -> float:
        """Ion events per pixel and exposure."""
        return self.mcp.ion_events_per_s_cm2 * self.mcp.gate_s * self.camera.field_pixel_area_cm2

    @cached_property
    def of_ions(self) -> float:
        """Temporal variance of ion feedback, e-^2: each event is a Poisson number of pulses."""
        size = self.mcp.ion_event_size_pe
        event_e2 = self.pulse_e**2 * (size**2 + size * (1.0 + 1.0 / self.mcp.pulse_height_shape))
        return self.ions * event_e2 * self.blurs[0] * self.of_chain.decay[0]

    @cached_property
    def variance(self) -> Array:
        """Temporal variance of every pixel as read, e-^2, rounding included, shape (row, col)."""
        return self.of_pulses + self.electronics + self.step_e**2 / 12.0 + 1e-12

    @cached_property
    def noise(self) -> Array:
        """Temporal noise of every pixel, in photoelectrons, shape (row, col)."""
        return np.sqrt(self.variance) / self.charge_e

    @cached_property
    def smear(self) -> Array:
        """Charge that smear adds to each pixel of a column, in photoelectrons, shape (col,)."""
        return self.mean_pe.sum(axis=0) * self.ccd.smear_fraction / (self.mean_pe.shape[0] / 10.0)

    @cached_property
    def brightest_e(self) -> Array:
        """Upper bound of the charge, e-, shape (row, col), without MCP saturation."""
        charge = (
            self.of_chain.gain_e * (self.mean_pe + self.smear) + self.ccd.dark_e + self.hottest_e
        )
        return charge + ACCURACY.overflow_sd * np.sqrt(self.variance)

    @cached_property
    def hottest_e(self) -> float:
        """Largest deviation of a pixel's level without light, e-: extremes of a gamma law and of
        the offsets.
        """
        probability = ACCURACY.extreme_probability / self.mean_pe.size
        if self.ccd.dsnu_e == 0.0 or self.ccd.dark_e == 0.0:
            return 0.0
        shape = (self.ccd.dark_e / self.ccd.dark_pattern_sd_e) ** 2
        offset_e = self.extreme(float(self.mean_pe.size)) * self.ccd.offset_sd_e
        hottest, coldest = (
            gammainccinv(shape, probability) / shape,
            gammaincinv(shape, probability) / shape,
        )
        return offset_e + self.ccd.dark_e * float(max(hottest - 1.0, 1.0 - coldest))

    @cached_property
    def running(self) -> Mask:
        """Columns that may bloom, shape (col,)."""
        limit = self.ccd.full_well_e * max(self.ccd.antibloom_ratio, 1.0)
        return np.asarray(self.brightest_e.max(axis=0) > limit)

    @cached_property
    def quiet(self) -> Array:
        """Variance of each pixel, e-^2; that of reading alone where the well may be full."""
        reading = (
            self.of_chain.white * self.ccd.read_noise_e**2
            + self.line_noise_e**2
            + self.step_e**2 / 12.0
            + 1e-12
        )
        full = (self.brightest_e > self.ccd.full_well_e) | self.running
        return np.where(full, reading, self.variance)

    def extreme(self, number: float) -> float:
        """Return the level, in sd, that the largest of so many normals exceeds with
        `extreme_probability`.
        """
        return float(-ndtri(ACCURACY.extreme_probability / max(number, 1.0)))

    def of_mean(self, change: Array | float) -> float:
        """Influence of a change of the mean that leaves the noise as it is, in photoelectrons.

        Notes
        -----
        What wells cannot take and drains do not carry off runs along its column: more charge
        anywhere in it can then raise any one pixel by as much as all the column gains, and no more
        (Diaconis and Fulton, Rend. Sem. Mat. Torino 49, 95, 1991).
        """
        size = np.broadcast_to(np.abs(change), self.noise.shape)
        column_change = size.sum(axis=0)[self.running] / self.noise.min(axis=0)[self.running]
        return float(max(np.max(size / self.noise), np.max(column_change, initial=0.0)))

    def of_light(self, change: Array | float) -> float:
        """Influence of a change of light, in photoelectrons per pixel, by its mean and by the noise
        of its pulses.

        Notes
        -----
        Where light is sparse the noise tells more of it than the mean: a standard deviation follows
        half the relative change of the light, whereas the mean changes by a fraction of the noise
        that falls with the root of the light.
        """
        noise = np.abs(change) * self.charge_e * (self.pulses[0] + self.of_chain.white)
        return max(self.of_mean(change), self.of_variance(noise))

    def of_gain(self, relative: Array | float) -> float:
        """Influence of a relative change of the gain: of the mean and of the noise of the pulses
        alike.
        """
        change = np.abs(relative)
        return max(
            self.of_mean(change * self.mean_pe),
            float(np.max(change * self.of_pulses / self.variance)),
        )

    def of_variance(self, variance_e2: Array | float) -> float:
        """Influence of a part of the variance, e-^2, that has the correlations of the rest.

        Notes
        -----
        Without a fraction s the standard deviation falls by 1 - sqrt(1 - s), which grows faster
        than s: fractions that are left out together count more than each alone. s/(2 - T) adds up,
        and reaches the tolerance T just where the standard deviation has fallen by T.
        """
        return float(np.max(variance_e2 / self.variance)) / (2.0 - min(self.tolerance, 1.0))

    def of_white(self, variance_e2: Array | float) -> float:
        """Influence of a part of the variance, e-^2, whose correlations differ from those of the
        rest.

        Notes
        -----
        Without a fraction s of the variance, correlations rise from r to r/(1 - s) at most, or fall
        as much: s (1 + T) adds up, and reaches T just where s/(1 - s) does. Where noise is smaller
        than a step of the digitiser, the variance of the codes follows it more steeply, by up to
        0.09, the largest x phi(x) (1 - 2 Phi(-x)) / 2, over its variance in steps^2 where the mean
        lies as unluckily as it can.
        """
        steeper = 0.09 * self.step_e**2 / max(self.electronics, 1e-300)
        return (
            float(np.max(np.minimum(variance_e2 / self.quiet, 1.0)))
            * max(1.0, steeper)
            * (1.0 + self.tolerance)
        )

    def of_skewness(self, photoelectrons: Array | float) -> float:
        """Influence of the skewness of pulses on the level that one frame in a thousand exceeds.

        Notes
        -----
        Cornish and Fisher: the level lies (z^2 - 1)/6 skewnesses higher; counted with the least
        noise that the tolerance leaves.
        """
        third = photoelectrons * self.charge_e * self.pulses[1]
        smallest_variance = self.variance * (1.0 - self.tolerance / (1.0 + self.tolerance))
        return float(np.max(third / smallest_variance**1.5)) * (self.RARE_SD**2 - 1.0) / 6.0

    def with_blur(self, blur: StageBlur) -> Array:
        """The frame after a blur, surroundings included."""
        cells, scene_map = self.camera.cells, self.surroundings
        fy = np.fft.fftfreq(scene_map.shape[0], cells.pitch_y_mm)[:, None]
        fx = np.fft.rfftfreq(scene_map.shape[1], cells.pitch_x_mm)[None, :]
        spectrum = np.fft.rfft2(scene_map) * product((blur,), *np.broadcast_arrays(fx, fy))
        return np.asarray(self.frame_of(np.fft.irfft2(spectrum, scene_map.shape)))


def bound_effects(budget: NoiseBudget) -> list[OptionalEffect]:
    """Return each optional effect of the camera's stages with its influence on the frame."""
    millions = budget.mean_pe.size / 1e6
    return [
        OptionalEffect(
            name=name,
            influence=influence,
            setup_s=SETUP_S.get(name, 0.0) * millions,
            frame_s=FRAME_S.get(name, 0.0) * millions,
        )
        for stage in budget.chain.stages
        for name, influence in stage.bounds(budget).items()
    ]


def select_camera_effects(
    camera: CameraModel,
    photoelectrons: StageImage,
    conditions: Conditions,
    tolerance: float = DEFAULT_TOLERANCE,
) -> tuple[CameraModel, EffectSelection]:
    """Return the camera without the effects that this light does not need, and the selection.

    Parameters
    ----------
    camera
        The camera, nothing left out.
    photoelectrons
        Photoelectrons that light frees from the cathode, per cell of `camera.scene_cells` and
        exposure.
    conditions
        Gate, voltage and temperature, and which automatic controls were on.
    tolerance
        What may change, as a fraction of the temporal noise of each pixel.

    Notes
    -----
    Controls that are on pass from where they start to where they settle; an effect counts as it
    does in the worse of both states.
    """
    budget = NoiseBudget(
        camera, camera.photoelectrons_per_pixel(photoelectrons), conditions, tolerance
    )
    effects = (bound_effects(replace(budget, state=state)) for state in _extreme_states(budget))
    largest = (
        max(by_state, key=lambda effect: effect.influence)
        for by_state in zip(*effects, strict=True)
    )
    plan = select_effects(largest, tolerance)
    return replace(camera, left_out=plan.names), plan


def _extreme_states(budget: NoiseBudget) -> Iterable[AutomaticState]:
    """Initial and extreme states of the automatic controls."""
    controls, brightness = AutomaticControls.of(budget.camera, budget.conditions), 1.0
    if controls.brightness is not None:
        n = float(budget.frame_of(budget.surroundings, ACCURACY.draw_margin_px).mean())
        output = budget.mcp.gain * n / budget.camera.field_pixel_area_cm2 / budget.mcp.field_s
        brightness = min(1.0, controls.brightness.limit_e_per_s_cm2 / max(output, 1e-300))
    highest = 1.0 if controls.gain is None else controls.gain.highest
    return dict.fromkeys(
        AutomaticState(brightness=b, gain=g) for g in (1.0, highest) for b in (1.0, brightness)
    )
