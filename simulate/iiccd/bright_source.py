"""Protection of the photocathode: a bright source draws current, a resistor lowers the gap's voltage, blur grows."""

from dataclasses import dataclass

import numpy as np

from labdata.errors import BadInput
from simulate.iiccd.transfer import GapSpread


@dataclass(frozen=True, kw_only=True)
class BrightSourceProtection:
    """Supply of the photocathode behind its series resistor.

    Parameters
    ----------
    gap_v
        Voltage across the gap in the dark, V.
    protected_v
        Voltage that the supply does not go below, V.
    protected_lux
        Illuminance, averaged over the cathode and over time, at which it has come down to that, lux.
    gap_mm
        Width of the gap, mm.
    lateral_energy_ev
        Energy with which photoelectrons leave across the axis, eV.

    Notes
    -----
    The drop follows Ohm's law, so it is linear in the cathode's current and the current in the light. Photoelectrons
    land rho = 2 d sqrt(eps/V) off the axis; the transfer exp(-(pi f rho)^2) at the full voltage is part of the tube's
    own MTF, so only the growth of rho^2 is a blur of its own. The halo's diameter, four gaps, knows no voltage.
    """

    gap_v: float
    protected_v: float
    protected_lux: float
    gap_mm: float
    lateral_energy_ev: float

    def __post_init__(self) -> None:
        if not 0.0 < self.protected_v <= self.gap_v:
            raise BadInput(
                f"protected_v must be positive and at most gap_v, got {self.protected_v:g} and {self.gap_v:g}"
            )
        if not self.protected_lux > 0.0:
            raise BadInput(f"protected_lux must be positive, got {self.protected_lux:g}")

    def voltage_v(self, cathode_lux: float) -> float:
        """Return the voltage across the gap under a mean illuminance, V."""
        return self.gap_v - (self.gap_v - self.protected_v) * min(cathode_lux / self.protected_lux, 1.0)

    def flight_um(self, voltage_v: float) -> float:
        """Return rho, how far off the axis photoelectrons land, um."""
        return 2e3 * self.gap_mm * float(np.sqrt(self.lateral_energy_ev / voltage_v))

    def blur(self, cathode_lux: float) -> GapSpread | None:
        """Return the blur beyond that of the full voltage; None without light."""
        growth = self.flight_um(self.voltage_v(cathode_lux)) ** 2 - self.flight_um(self.gap_v) ** 2
        return GapSpread(radius_um=float(np.sqrt(growth))) if growth > 0.0 else None
