"""Photocathode and proximity gap: photons become photoelectrons, with gap spread, halo and bright-source protection."""

from dataclasses import dataclass

import numpy as np

from labdata.errors import BadInput
from simulate.iiccd.grid import Grid
from simulate.iiccd.stage_image import NoiselessStage, StageImage
from simulate.iiccd.transfer import GapSpread, StageBlur


@dataclass(frozen=True, kw_only=True)
class Photocathode(NoiselessStage):
    """Photocathode behind an electronic gate.

    Parameters
    ----------
    quantum_efficiency
        Photoelectrons per photon at the wavelength to which the photons have been referred, dimensionless.
    gate_s
        Time the gate is open in one exposure, s.
    ebi_per_s_cm2
        Photoelectrons emitted in the dark (equivalent background illumination), per s and cm2.
    on_off_ratio
        What passes the open gate over what passes the shut one, in light and in the dark alike, dimensionless.
    field_s
        Time from one exposure to the next, s: while the gate is shut, light leaks for the rest of it.

    Raises
    ------
    BadInput
        If the gate does not open, or passes more while shut.

    Notes
    -----
    Takes photons per second and cell; emits the expected photoelectrons per exposure and cell. Nothing is drawn here:
    Poisson photoelectrons displaced at random are again Poisson photoelectrons of the blurred mean, so both the lens
    and the gap act on the mean and the MCP draws (displacement theorem, Kingman, Poisson Processes, 5.1).
    """

    quantum_efficiency: float
    gate_s: float
    ebi_per_s_cm2: float
    on_off_ratio: float = np.inf
    field_s: float = 0.0
    name: str = "photocathode"
    takes: str = "photons"
    emits: str = "photoelectrons"

    def __post_init__(self) -> None:
        if not self.gate_s > 0.0:
            raise BadInput(f"gate_s must be positive, got {self.gate_s:g}")
        if not self.on_off_ratio >= 1.0:
            raise BadInput(f"on_off_ratio must be at least 1, got {self.on_off_ratio:g}")

    @property
    def open_s(self) -> float:
        """Time open that would pass as much as the gate does, open and shut, s."""
        return self.gate_s + max(self.field_s - self.gate_s, 0.0) / self.on_off_ratio

    def mean(self, light: StageImage) -> StageImage:
        """Return photoelectrons per exposure and cell."""
        dark = 0.0 if light.grid is None else self.ebi_per_s_cm2 * light.grid.cell_area_cm2
        rate = self.quantum_efficiency * light.values + np.asarray(dark, light.values.dtype)
        return light.with_values(rate * np.asarray(self.open_s, light.values.dtype))


@dataclass(frozen=True, kw_only=True)
class ProximityGap(NoiselessStage):
    """Proximity gap between cathode and MCP, with the halo of backscattered electrons.

    Parameters
    ----------
    spread, halo
        Blur of the direct electrons and of those backscattered from the MCP.
    grid
        Cells on which the MCP receives them.
    protection
        Blur that protection from a bright source adds; None without.
    """

    spread: StageBlur
    halo: StageBlur
    grid: Grid
    protection: StageBlur | None = None
    name: str = "gap"
    takes: str = "photoelectrons"
    emits: str = "photoelectrons at the plate"

    def mean(self, light: StageImage) -> StageImage:
        """Return the expected photoelectrons per cell of the MCP, pending blurs applied."""
        further = () if self.protection is None else (self.protection,)
        landing = light.with_blurs(self.spread, self.halo, *further)
        return landing.with_blurs_applied() if light.grid == self.grid else landing.resample_to(self.grid)


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
