"""The microchannel plate: it detects photoelectrons one by one and gives each a pulse of random height."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.iiccd.light import Light


@dataclass(frozen=True, kw_only=True)
class MicrochannelPlate:
    """Microchannel plate.

    Parameters
    ----------
    detection_probability
        Share of the photoelectrons that start a pulse, dimensionless.
    pulse_height_shape
        Shape of the gamma (Polya) law of pulse heights; 1 is exponential. Its relative variance is 1/shape.
    gain
        Electrons out per photoelectron in, the undetected counted, at low current.
    saturation_e_per_s_cm2
        Output current at which the gain has halved, electrons per s and cm2.
    field_s
        Time from one exposure to the next, s; the strip current recharges the plate all along.
    ion_events_per_s_cm2, ion_event_size_pe, gate_s
        Rate and mean size (detected photoelectrons) of ion pulses while the gate is open.

    Notes
    -----
    Thinned Poisson counts with independent pulses of gamma heights: of a cell that expects m photoelectrons, the
    output is G/p times gamma(shape n)/shape with n ~ Poisson(p m), exact at every level. Variance over mean is
    G F^2 with F^2 = (1 + 1/shape)/p. Gain saturates over the whole plate alike, G / (1 + j/j_s), j the mean output.
    """

    detection_probability: float
    pulse_height_shape: float
    gain: float
    saturation_e_per_s_cm2: float
    field_s: float
    ion_events_per_s_cm2: float = 0.0
    ion_event_size_pe: float = 0.0
    gate_s: float = 0.0
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

    @property
    def excess_noise_factor(self) -> float:
        """F^2 = (1 + relative variance of pulse heights)/p, dimensionless."""
        return (1.0 + 1.0 / self.pulse_height_shape) / self.detection_probability

    def saturated_gain(self, light: Light) -> NDArray[np.float64]:
        """Gain under the load of an image, electrons per photoelectron, shape (..., 1, 1)."""
        if light.grid is None:
            raise ValueError("the plate needs light on cells of known size")
        per_cell = light.values.mean(axis=(-2, -1), keepdims=True, dtype=np.float64)
        output = self.gain * per_cell / light.grid.cell_area_cm2 / self.field_s
        return self.gain / (1.0 + output / self.saturation_e_per_s_cm2)

    def under_load(self, light: Light, parts: int = 1) -> "MicrochannelPlate":
        """Return the plate as it works on one of several equal parts of an exposure: its gain is that of the whole."""
        gain = float(self.saturated_gain(light).mean())
        return replace(self, gain=gain, saturation_e_per_s_cm2=np.inf, gate_s=self.gate_s / parts)

    def _ions_per_cell(self, light: Light) -> float:
        area = 0.0 if light.grid is None else light.grid.cell_area_cm2
        return self.ion_events_per_s_cm2 * self.gate_s * area

    def mean(self, light: Light) -> Light:
        """Return the expected electrons per cell."""
        gain = self.saturated_gain(light).astype(np.float32)
        ions = self._ions_per_cell(light) * self.ion_event_size_pe / self.detection_probability
        return light.with_values((light.values + np.float32(ions)) * gain)

    def draw(self, light: Light, rng: np.random.Generator) -> Light:
        """Return electrons per cell, each photoelectron detected or lost, each pulse of its own height.

        Where resampling has left a ripple below zero, the ripple passes with the mean gain and no noise, so that it
        still cancels further on.
        """
        from simulate.iiccd import draws

        detected = light.values * np.float32(self.detection_probability)
        pulses = draws.pulse_sums(rng, detected, self.pulse_height_shape)
        self._add_ions(pulses, self._ions_per_cell(light), rng)
        height = (self.saturated_gain(light) / self.detection_probability).astype(np.float32)
        if detected.min() < 0.0:
            pulses += np.minimum(detected, 0.0)
        pulses *= height
        return light.with_values(pulses)

    def _add_ions(self, pulses: NDArray[np.float32], per_cell: float, rng: np.random.Generator) -> None:
        """Add ion pulses at random cells, each a Poisson number of photoelectrons."""
        where = rng.integers(pulses.size, size=rng.poisson(per_cell * pulses.size))
        size = rng.poisson(self.ion_event_size_pe, size=len(where)) * self.pulse_height_shape
        np.add.at(pulses.reshape(-1), where, (rng.gamma(size) / self.pulse_height_shape).astype(np.float32))
