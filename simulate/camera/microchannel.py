"""Microchannel plate: detection, pulse heights, saturation and local gain depletion."""

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from labdata.conditions import Conditions
from labdata.errors import BadInput, check
from simulate.arrays import Array, Array32
from simulate.camera import pattern, tube_photometry
from simulate.camera.chain import Slot, Stage, values_of
from simulate.camera.grid import CameraFrame, Grid
from simulate.camera.stage_image import StageImage
from simulate.camera.transfer import GapSpread


@dataclass(frozen=True, kw_only=True)
class MicrochannelPlate(
    Stage,
    slot=Slot.MCP,
    section="microchannel_plate",
    quantity="electrons per exposure and cell",
    takes="photoelectrons at the plate",
    emits="electrons",
):
    """Microchannel plate, or a stack of MCPs: all numbers are those of the stack.

    Notes
    -----
    Thinned Poisson counts with independent pulses of gamma heights: of a cell that expects m
    photoelectrons, the output is G/p times gamma(shape n)/shape with n ~ Poisson(p m), exact at
    every level. Variance over mean is G F^2 with F^2 = (1 + 1/shape)/p. Gain saturates over the
    whole MCP alike, G / (1 + j/j_s), j the mean output, or with `depletion_blur_um` place by place,
    j the blurred output: flat light sees the same gain, a bright core less. In changing light the
    state u of the channels, whose gain is G / (1 + u), follows the load j/j_s with the channels'
    time constant, du/dt = (load - u)/tau. The map u is carried by the caller; None is an MCP that
    has rested.
    """

    detection_probability: float  # fraction of the photoelectrons that start a pulse, dimensionless
    # Shape of the gamma (Polya) law of pulse heights; 1 is exponential. Its relative variance is
    # 1/shape.
    pulse_height_shape: float
    gain: float  # electrons out per photoelectron in, the undetected counted, at low current
    # output current at which the gain has halved, electrons per s and cm2
    saturation_e_per_s_cm2: float
    # time from one exposure to the next, s; the strip current recharges the MCP all along
    field_s: float
    # Rate and mean size (detected photoelectrons) of ion pulses while the gate is open.
    ion_events_per_s_cm2: float = 0.0
    ion_event_size_pe: float = 0.0
    gate_s: float = 0.0
    # Depth, pitch and width of the lines of lower gain where the MCP's multi-fibres meet; the mean
    # gain is `gain`.
    pattern_contrast: float = 0.0
    pattern_pitch_um: float = 700.0
    line_um: float = 6.0
    # Width of the neighbourhood whose own output lowers the gain of a place; None: the whole MCP's
    # mean does.
    depletion_blur_um: float | None = None
    recovery_ms: float = 10.0  # time constant with which channels recharge, ms
    # Gain over `gain`, shape (row, col), of an MCP under a known load; None for none.
    gain_map: Array | None = field(default=None, compare=False)
    # Whether a normal law of the same mean and variance stands for that of the sum of many pulses.
    normal_law: bool = False
    effects: ClassVar = {
        "MCP saturation": {"saturation_e_per_s_cm2": np.inf},
        "local gain depletion": {"depletion_blur_um": None},
        "ion feedback": {"ion_events_per_s_cm2": 0.0},
        "multi-fibre pattern": {"pattern_contrast": 0.0},
        "pulse-height distribution": {"normal_law": True},
    }

    @classmethod
    def of(cls, camera: CameraFrame, conditions: Conditions) -> Self:
        """Return the MCP at the voltage or control word of the conditions.

        Raises
        ------
        BadInput
            If the conditions set the MCP twice, or a gain that a tube does not have.
        """
        if conditions.em_gain is not None:
            raise BadInput(
                f"em_gain must be left out of a camera with a tube, got {conditions.em_gain:g}"
            )
        sensor, plate = camera.description, camera.description.microchannel_plate
        gain = tube_photometry.photons_per_photoelectron(sensor) / float(
            sensor.phosphor.photons_per_electron
        )
        strip = float(plate.strip_current_ua_per_cm2) * float(plate.saturation_fraction) * 1e-6
        return values_of(
            cls,
            plate,
            gain=gain
            * tube_photometry.gain_factor(sensor, conditions.mcp_v, conditions.gain_control),
            saturation_e_per_s_cm2=strip / tube_photometry.ELEMENTARY_CHARGE_C,
            field_s=camera.field_s,
            gate_s=camera.open_s(conditions),
            ion_events_per_s_cm2=float(plate.ion_event_rate_per_s_cm2),
            line_um=float(plate.channel_pitch_um),
            depletion_blur_um=float(plate.saturation_blur_um),
            recovery_ms=float(plate.channel_recovery_ms),
            pattern_contrast=float(plate.pattern_contrast) * camera.specimen.drawn_light,
        )

    def __post_init__(self) -> None:
        if not 0.0 < self.detection_probability <= 1.0:
            raise BadInput(
                f"detection_probability must lie in (0, 1], got {self.detection_probability:g}"
            )
        if not 0.0 <= self.pattern_contrast < 1.0:
            raise BadInput(f"pattern_contrast must lie in [0, 1), got {self.pattern_contrast:g}")
        if not self.saturation_e_per_s_cm2 > 0.0:
            raise BadInput(
                f"saturation_e_per_s_cm2 must be positive, got {self.saturation_e_per_s_cm2:g}"
            )
        check(
            self,
            positive="pulse_height_shape recovery_ms field_s",
            not_negative="gain depletion_blur_um",
        )

    @property
    def excess_noise_factor(self) -> float:
        """F^2 = (1 + relative variance of pulse heights)/p, dimensionless."""
        return (1.0 + 1.0 / self.pulse_height_shape) / self.detection_probability

    def load(self, photoelectrons: Array, grid: Grid) -> Array:
        """Return the load of each cell's neighbourhood by photoelectrons per cell and exposure,
        (..., row, col).
        """
        from scipy.ndimage import gaussian_filter

        width_mm = (self.depletion_blur_um or 0.0) * 1e-3
        per_cell = self.saturation_e_per_s_cm2 * grid.cell_area_cm2 * self.field_s
        widths = (
            width_mm / grid.pitch_y_mm * grid.per_row,
            width_mm / grid.pitch_x_mm * grid.per_column,
        )
        output = np.asarray(self.gain * photoelectrons, np.float64)
        return (
            gaussian_filter(output, (*(0.0 for _ in output.shape[:-2]), *widths), mode="nearest")
            / per_cell
        )

    def states_under(self, state: Array | None, load: Array) -> tuple[Array, Array]:
        """Return the mean state of the channels over a field under a load, and the state at its
        end.
        """
        fade = self.field_s / (self.recovery_ms * 1e-3)
        mean, decay = -np.expm1(-fade) / fade, np.exp(-fade)
        initial = 0.0 if state is None else state
        return load * (1.0 - mean) + initial * mean, load * (1.0 - decay) + initial * decay

    def with_depletion(self, state: Array) -> "MicrochannelPlate":
        """Return the MCP whose channels are in a state, shape (row, col)."""
        return replace(
            self, gain_map=(1.0 / (1.0 + state)).astype(np.float32), saturation_e_per_s_cm2=np.inf
        )

    def gain_under_load(self, light: StageImage) -> NDArray[np.float64]:
        """Gain under the load of an image, electrons per photoelectron, (..., 1, 1), or a map (...,
        row, col).
        """
        if light.grid is None:
            raise ValueError("the plate needs light on cells of known size")
        if self.gain_map is not None:
            return np.asarray(self.gain * self.gain_map, np.float64)
        if self.depletion_blur_um is not None and np.isfinite(self.saturation_e_per_s_cm2):
            return np.asarray(
                self.gain * (1.0 / (1.0 + self.load(light.values, light.grid))), np.float64
            )
        per_cell = light.values.mean(axis=(-2, -1), keepdims=True, dtype=np.float64)
        output = self.gain * per_cell / light.grid.cell_area_cm2 / self.field_s
        return self.gain / (1.0 + output / self.saturation_e_per_s_cm2)

    def under_load(self, light: StageImage, parts: int = 1) -> "MicrochannelPlate":
        """Return the MCP as it works on one of several equal parts of an exposure: its gain is that
        of the whole.
        """
        loaded = self.gain_under_load(light)
        gate_part = replace(self, saturation_e_per_s_cm2=np.inf, gate_s=self.gate_s / parts)
        if loaded.shape[-1] == 1:
            return replace(gate_part, gain=float(loaded.mean()))
        return replace(
            gate_part, gain_map=(loaded / self.gain).astype(np.float32) if self.gain > 0.0 else None
        )

    def ions_per_cell(self, light: StageImage) -> float:
        """Return the expected ion events per cell and exposure."""
        area = 0.0 if light.grid is None else light.grid.cell_area_cm2
        return self.ion_events_per_s_cm2 * self.gate_s * area

    def mean(self, light: StageImage) -> StageImage:
        ions = self.ions_per_cell(light) * self.ion_event_size_pe / self.detection_probability
        electrons = (light.values + np.float32(ions)) * self.gain_under_load(light).astype(
            np.float32
        )
        return light.with_values(self._with_multifibres(electrons, light.grid))

    def draw(self, light: StageImage, rng: np.random.Generator) -> StageImage:
        """Return electrons per cell, each photoelectron detected or lost, each pulse of its own
        height.

        Where resampling has left a ripple below zero, the ripple passes with the mean gain and no
        noise, so that it still cancels further on.
        """
        from simulate.camera.random_numbers import poisson_numbers

        detected = light.values * np.float32(self.detection_probability)
        pulses = poisson_numbers(rng.integers(2**64, dtype=np.uint64), detected)
        ions = rng.poisson(self.ions_per_cell(light) * pulses.size)
        np.add.at(
            pulses.reshape(-1),
            rng.integers(pulses.size, size=ions),
            rng.poisson(self.ion_event_size_pe, ions),
        )
        electrons = rng.standard_gamma(
            pulses * np.float32(self.pulse_height_shape), dtype=np.float32
        )
        electrons /= np.float32(self.pulse_height_shape)
        electrons += np.minimum(detected, 0.0)
        electrons *= (self.gain_under_load(light) / self.detection_probability).astype(np.float32)
        return light.with_values(self._with_multifibres(electrons, light.grid))

    def _with_multifibres(self, electrons: Array32, grid: Grid | None) -> Array32:
        if self.pattern_contrast == 0.0 or grid is None:
            return electrons
        pitch_mm, line_mm = self.pattern_pitch_um * 1e-3, self.line_um * 1e-3
        return electrons * pattern.multifibre_gain(grid, self.pattern_contrast, pitch_mm, line_mm)

    def bounds(self, budget: Any) -> dict[str, float]:
        """Return the influence of saturation, depletion, ions, pattern and law of the pulse
        heights.

        Notes
        -----
        An ion event is seen by as many pixels as its light is spread over, about three times the
        reciprocal of what blur leaves of the variance, in as many fields as the phosphor remembers.
        A chance p of that shifts the level that normal noise exceeds with a chance q by p/(q z).
        """
        mean, pixels = budget.mean_load, 3.0 / budget.blurs[0]
        influences = {"MCP saturation": budget.of_gain(mean)}
        if self.depletion_blur_um is not None:
            local_load = budget.with_blur(
                GapSpread(radius_um=float(np.sqrt(2.0)) * self.depletion_blur_um)
            )
            local = np.maximum(budget.load(local_load), 0.0)
            # Relative to whichever gain is the lower.
            influences["local gain depletion"] = budget.of_gain(
                (local - mean) / (1.0 + np.minimum(local, mean))
            )
            influences["MCP saturation"] = max(influences["MCP saturation"], budget.of_gain(local))
        fields = 1 + int(np.sum(budget.of_chain.shares.mean(axis=0)[1:] > 0.01))
        pushed = min(budget.ions * pixels * fields / budget.RARE / budget.RARE_SD, 1.0)
        ion_mean = budget.of_mean(budget.ions * self.ion_event_size_pe / self.detection_probability)
        return {
            **influences,
            "ion feedback": max(budget.of_variance(budget.of_ions) + ion_mean, pushed),
            "multi-fibre pattern": self.pattern_contrast * budget.of_gain(1.0),
            "pulse-height distribution": budget.of_skewness(budget.mean_pe),
        }
