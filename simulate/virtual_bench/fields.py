"""How long the gate is open in each field of the virtual camera: the two may run against one another."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labdata.gating import IN_STEP, fields_open_ns
from simulate.virtual_bench.outputs import Outputs

CLOCKS_DIFFER = 2e-5
"""Relative difference between the clock of a gate generator and that of a camera, two ordinary crystals."""

STEPS = 32
"""Open times are told apart to this share of one opening: each is a light of its own to be drawn."""


@dataclass(frozen=True, kw_only=True)
class Fields:
    """Gate and fields of a camera, and how they run against one another.

    Parameters
    ----------
    width_ns
        Width of one opening, ns.
    rate_hz
        Openings a second, Hz.
    field_hz
        Fields a second, Hz.
    exposure_s
        Exposure of a field, which ends with it, s.
    first_s
        When the first field begins, s after an opening begins.
    """

    width_ns: float
    rate_hz: float
    field_hz: float
    exposure_s: float
    first_s: float

    @classmethod
    def of(cls, outputs: Outputs, *, field_hz: float, exposure_s: float, phase: float) -> "Fields":
        """Return how a gate meets the fields; `phase`: that of a gate which the camera does not trigger, 0 to 1."""
        rates = {"clock": outputs.gate_hz * (1.0 + CLOCKS_DIFFER), "mains": outputs.gate_hz, "camera": field_hz}
        rate_hz = rates[outputs.gate_trigger]
        first_s = -outputs.gate_delay_ns * 1e-9 if outputs.gate_trigger == "camera" else phase / rate_hz
        return cls(width_ns=outputs.gate_ns, rate_hz=rate_hz, field_hz=field_hz, exposure_s=exposure_s, first_s=first_s)

    def open_ns(self, first_field: int, fields: int) -> NDArray[np.floating]:
        """Return how long the gate is open in each of some fields, ns."""
        ends_s = self.first_s + (np.arange(first_field, first_field + fields) + 1.0) / self.field_hz
        return fields_open_ns(ends_s - self.exposure_s, self.exposure_s, width_ns=self.width_ns, rate_hz=self.rate_hz)

    def lights_ns(self, first_field: int, fields: int) -> tuple[float, ...]:
        """Return the same to a `STEPS`-th of an opening, ns."""
        step_ns = self.width_ns / STEPS
        return tuple(float(one) for one in np.round(self.open_ns(first_field, fields) / step_ns) * step_ns)

    @property
    def in_step(self) -> bool:
        """Whether all fields within a minute are open for the same time."""
        return float(np.ptp(self.open_ns(0, round(60.0 * self.field_hz)))) < IN_STEP * self.width_ns
