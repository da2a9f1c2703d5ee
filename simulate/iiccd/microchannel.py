"""Microchannel plate: detection, pulse heights, saturation and local gain depletion."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.iiccd import pattern
from simulate.iiccd.grid import Grid
from simulate.iiccd.stage_image import StageImage

Map = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class Depletion:
    """Local gain depletion of the channels.

    Parameters
    ----------
    saturation_e_per_s_cm2
        Steady output, were the gain undiminished, at which it has halved, electrons per s and cm2.
    blur_um
        Width (standard deviation) of the neighbourhood whose output counts, um.
    recovery_ms
        Time constant with which channels recharge, ms.
    field_s
        Time from one exposure to the next, s.

    Notes
    -----
    h(u) = 1/(1 + u): in steady light u is the undiminished output over the saturating one, blurred by a Gaussian; in
    changing light u follows that load with the channels' time constant, du/dt = (load - u)/tau. The state between
    fields is the map u, carried by the caller; None is an MCP that has rested.
    """

    saturation_e_per_s_cm2: float
    blur_um: float
    recovery_ms: float
    field_s: float

    def __post_init__(self) -> None:
        for name in ("saturation_e_per_s_cm2", "recovery_ms", "field_s"):
            if not getattr(self, name) > 0.0:
                raise BadInput(f"{name} must be positive, got {getattr(self, name):g}")
        if not self.blur_um >= 0.0:
            raise BadInput(f"blur_um must not be negative, got {self.blur_um:g}")

    def load(self, output_e: Map, grid: Grid) -> Map:
        """Return the load of an undiminished output, electrons per cell and exposure, shape (..., row, col)."""
        from scipy.ndimage import gaussian_filter

        per_cell = self.saturation_e_per_s_cm2 * grid.cell_area_cm2 * self.field_s
        widths = (
            self.blur_um * 1e-3 / grid.pitch_y_mm * grid.per_row,
            self.blur_um * 1e-3 / grid.pitch_x_mm * grid.per_column,
        )
        sigma = (*(0.0 for _ in output_e.shape[:-2]), *widths)
        return gaussian_filter(np.asarray(output_e, np.float64), sigma, mode="nearest") / per_cell

    def gain(self, state: Map) -> Map:
        """Return the gain that is left, dimensionless."""
        return 1.0 / (1.0 + state)

    def during(self, state: Map | None, load: Map) -> Map:
        """Return the mean state over a field that starts from `state` under a load."""
        fade = self.field_s / (self.recovery_ms * 1e-3)
        kept = -np.expm1(-fade) / fade
        return load * (1.0 - kept) + (0.0 if state is None else state * kept)

    def next(self, state: Map | None, load: Map) -> Map:
        """Return the state at the end of that field."""
        kept = np.exp(-self.field_s / (self.recovery_ms * 1e-3))
        return load * (1.0 - kept) + (0.0 if state is None else state * kept)


@dataclass(frozen=True, kw_only=True)
class MicrochannelPlate:
    """Microchannel plate, or a stack of MCPs.

    Parameters
    ----------
    detection_probability
        Fraction of the photoelectrons that start a pulse, dimensionless.
    pulse_height_shape
        Shape of the gamma (Polya) law of pulse heights; 1 is exponential. Its relative variance is 1/shape.
    gain
        Electrons out per photoelectron in, the undetected counted, at low current.
    saturation_e_per_s_cm2
        Output current at which the gain has halved, electrons per s and cm2.
    field_s
        Time from one exposure to the next, s; the strip current recharges the MCP all along.
    ion_events_per_s_cm2, ion_event_size_pe, gate_s
        Rate and mean size (detected photoelectrons) of ion pulses while the gate is open.
    stages
        MCPs in the stack; all numbers are those of the stack, see `stack_gain_and_shape`.
    pattern_contrast, pattern_pitch_um, line_um
        Depth, pitch and width of the lines of lower gain where the MCP's multi-fibres meet; the mean gain is `gain`.
    depletion_blur_um
        Width of the neighbourhood whose own output lowers the gain of a place; None: the whole MCP's mean does.
    recovery_ms
        Time constant with which channels recharge, ms.
    gain_map
        Gain over `gain`, shape (row, col), of an MCP under a known load; None for none.

    Notes
    -----
    Thinned Poisson counts with independent pulses of gamma heights: of a cell that expects m photoelectrons, the
    output is G/p times gamma(shape n)/shape with n ~ Poisson(p m), exact at every level. Variance over mean is
    G F^2 with F^2 = (1 + 1/shape)/p. Gain saturates over the whole MCP alike, G / (1 + j/j_s), j the mean output, or
    with `depletion_blur_um` place by place, j the blurred output: flat light sees the same gain, a bright core less.
    """

    detection_probability: float
    pulse_height_shape: float
    gain: float
    saturation_e_per_s_cm2: float
    field_s: float
    ion_events_per_s_cm2: float = 0.0
    ion_event_size_pe: float = 0.0
    gate_s: float = 0.0
    stages: int = 1
    pattern_contrast: float = 0.0
    pattern_pitch_um: float = 700.0
    line_um: float = 6.0
    depletion_blur_um: float | None = None
    recovery_ms: float = 10.0
    gain_map: NDArray[np.floating] | None = field(default=None, compare=False)
    name: str = "microchannel plate"
    takes: str = "photoelectrons at the plate"
    emits: str = "electrons"

    def __post_init__(self) -> None:
        if not 0.0 < self.detection_probability <= 1.0:
            raise BadInput(f"detection_probability must lie in (0, 1], got {self.detection_probability:g}")
        if not self.pulse_height_shape > 0.0 or not self.gain >= 0.0:
            raise BadInput(
                f"pulse_height_shape must be positive and gain not negative, got {self.pulse_height_shape:g} "
                f"and {self.gain:g}"
            )
        if self.stages < 1:
            raise BadInput(f"a plate must have at least one stage, got {self.stages}")
        if not 0.0 <= self.pattern_contrast < 1.0:
            raise BadInput(f"pattern_contrast must lie in [0, 1), got {self.pattern_contrast:g}")

    @property
    def depletion(self) -> Depletion:
        """What light takes from the channels of a place."""
        return Depletion(
            saturation_e_per_s_cm2=self.saturation_e_per_s_cm2,
            blur_um=self.depletion_blur_um or 0.0,
            recovery_ms=self.recovery_ms,
            field_s=self.field_s,
        )

    @property
    def excess_noise_factor(self) -> float:
        """F^2 = (1 + relative variance of pulse heights)/p, dimensionless."""
        return (1.0 + 1.0 / self.pulse_height_shape) / self.detection_probability

    def gain_under_load(self, light: StageImage) -> NDArray[np.float64]:
        """Gain under the load of an image, electrons per photoelectron, (..., 1, 1), or a map (..., row, col)."""
        if light.grid is None:
            raise ValueError("the plate needs light on cells of known size")
        if self.gain_map is not None:
            return np.asarray(self.gain * self.gain_map, np.float64)
        if self.depletion_blur_um is not None and np.isfinite(self.saturation_e_per_s_cm2):
            depletion = self.depletion
            left = depletion.gain(depletion.load(self.gain * light.values, light.grid))
            return np.asarray(self.gain * left, np.float64)
        per_cell = light.values.mean(axis=(-2, -1), keepdims=True, dtype=np.float64)
        output = self.gain * per_cell / light.grid.cell_area_cm2 / self.field_s
        return self.gain / (1.0 + output / self.saturation_e_per_s_cm2)

    def under_load(self, light: StageImage, parts: int = 1) -> "MicrochannelPlate":
        """Return the MCP as it works on one of several equal parts of an exposure: its gain is that of the whole."""
        loaded = self.gain_under_load(light)
        part = replace(self, saturation_e_per_s_cm2=np.inf, gate_s=self.gate_s / parts)
        if loaded.shape[-1] == 1:
            return replace(part, gain=float(loaded.mean()))
        return replace(part, gain_map=(loaded / self.gain).astype(np.float32) if self.gain > 0.0 else None)

    def with_depletion(self, state: NDArray[np.floating]) -> "MicrochannelPlate":
        """Return the MCP whose channels are in a state of `Depletion`, shape (row, col)."""
        left = self.depletion.gain(state).astype(np.float32)
        return replace(self, gain_map=left, saturation_e_per_s_cm2=np.inf)

    def _multifibres(self, light: StageImage) -> NDArray[np.float32] | None:
        if self.pattern_contrast == 0.0 or light.grid is None:
            return None
        return pattern.multifibre_gain(
            light.grid, self.pattern_contrast, self.pattern_pitch_um * 1e-3, self.line_um * 1e-3
        )

    def ions_per_cell(self, light: StageImage) -> float:
        area = 0.0 if light.grid is None else light.grid.cell_area_cm2
        return self.ion_events_per_s_cm2 * self.gate_s * area

    def mean(self, light: StageImage) -> StageImage:
        """Return the expected electrons per cell."""
        gain = self.gain_under_load(light).astype(np.float32)
        ions = self.ions_per_cell(light) * self.ion_event_size_pe / self.detection_probability
        electrons = (light.values + np.float32(ions)) * gain
        if (multifibres := self._multifibres(light)) is not None:
            electrons *= multifibres
        return light.with_values(electrons)

    def draw(self, light: StageImage, rng: np.random.Generator) -> StageImage:
        """Return electrons per cell, each photoelectron detected or lost, each pulse of its own height.

        Where resampling has left a ripple below zero, the ripple passes with the mean gain and no noise, so that it
        still cancels further on.
        """
        from simulate.iiccd import pulse_sampling

        detected = light.values * np.float32(self.detection_probability)
        pulses = pulse_sampling.pulse_sums(rng, detected, self.pulse_height_shape)
        self._add_ions(pulses, self.ions_per_cell(light), rng)
        height = (self.gain_under_load(light) / self.detection_probability).astype(np.float32)
        if detected.min() < 0.0:
            pulses += np.minimum(detected, 0.0)
        pulses *= height
        if (multifibres := self._multifibres(light)) is not None:
            pulses *= multifibres
        return light.with_values(pulses)

    def _add_ions(self, pulses: NDArray[np.float32], per_cell: float, rng: np.random.Generator) -> None:
        """Add ion pulses at random cells, each a Poisson number of photoelectrons."""
        where = rng.integers(pulses.size, size=rng.poisson(per_cell * pulses.size))
        size = rng.poisson(self.ion_event_size_pe, size=len(where)) * self.pulse_height_shape
        np.add.at(pulses.reshape(-1), where, (rng.gamma(size) / self.pulse_height_shape).astype(np.float32))


def stack_gain_and_shape(gains: Sequence[float], shapes: Sequence[float]) -> tuple[float, float]:
    """Return the gain and the pulse-height shape of a stack of MCPs.

    Parameters
    ----------
    gains
        Electrons out of each MCP per electron that starts a pulse in it, in the order of the light.
    shapes
        Pulse-height shapes of each.

    Notes
    -----
    Gains multiply; the relative variance of a cascade is v1 + v2/G1 + v3/(G1 G2) + ... (Burgess, Disc. Faraday Soc. 28,
    151, 1959): the first MCP decides. The heights of the stack are taken as gamma of that variance.
    """
    before, variance = 1.0, 0.0
    for gain, shape in zip(gains, shapes, strict=True):
        if not (gain > 0.0 and shape > 0.0):
            raise BadInput(f"gains and shapes of a stack must be positive, got {gain:g} and {shape:g}")
        variance += 1.0 / shape / before
        before *= gain
    return before, 1.0 / variance
