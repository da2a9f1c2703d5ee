"""Photocathode and proximity gap: photons become photoelectrons, with gap spread, halo and
bright-source protection.
"""

from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from labdata.conditions import Conditions
from labdata.errors import BadInput, check
from simulate.camera import tube_photometry
from simulate.camera.chain import Slot, Stage, values_of
from simulate.camera.grid import CameraFrame, Grid
from simulate.camera.stage_image import StageImage
from simulate.camera.transfer import GapSpread, HaloBlur, StageBlur, TubeShare


@dataclass(frozen=True, kw_only=True)
class Photocathode(
    Stage,
    slot=Slot.PHOTOCATHODE,
    section="photocathode",
    quantity="photoelectrons per exposure and cell, expected",
    takes="photons",
    emits="photoelectrons",
):
    """Photocathode behind an electronic gate.

    Raises
    ------
    BadInput
        If the gate does not open, or passes more while shut.

    Notes
    -----
    Takes photons per second and cell; emits the expected photoelectrons per exposure and cell.
    Nothing is drawn here: Poisson photoelectrons displaced at random are again Poisson
    photoelectrons of the blurred mean, so both the lens and the gap act on the mean and the MCP
    draws (displacement theorem, Kingman, Poisson Processes, 5.1).
    """

    # Photoelectrons per photon at the wavelength to which the photons have been referred,
    # dimensionless.
    quantum_efficiency: float
    gate_s: float  # time the gate is open in one exposure, s
    # photoelectrons emitted in the dark (equivalent background illumination), per s and cm2
    ebi_per_s_cm2: float
    # What passes the open gate over what passes the shut one, in light and in the dark alike,
    # dimensionless.
    on_off_ratio: float = np.inf
    # Time from one exposure to the next, s: while the gate is shut, light leaks for the rest of it.
    field_s: float = 0.0
    effects: ClassVar = {"EBI": {"ebi_per_s_cm2": 0.0}}

    @classmethod
    def of(cls, camera: CameraFrame, conditions: Conditions) -> Self:
        """Return the photocathode; photons are referred to the wavelength where its efficiency
        peaks.
        """
        sensor = camera.description
        table_nm = sensor.photocathode.wavelength_nm
        return cls(
            quantum_efficiency=float(tube_photometry.quantum_efficiency(sensor, table_nm).max()),
            gate_s=camera.open_s(conditions),
            ebi_per_s_cm2=tube_photometry.ebi_per_s_cm2(sensor, conditions.temperature_c),
            on_off_ratio=float(sensor.photocathode.gate_on_off_ratio),
            field_s=camera.field_s,
        )

    def __post_init__(self) -> None:
        check(self, positive="gate_s", one_or_more="on_off_ratio")

    @property
    def open_s(self) -> float:
        """Time open that would pass as much as the gate does, open and shut, s."""
        return self.gate_s + max(self.field_s - self.gate_s, 0.0) / self.on_off_ratio

    def mean(self, light: StageImage) -> StageImage:
        dark = 0.0 if light.grid is None else self.ebi_per_s_cm2 * light.grid.cell_area_cm2
        rate = self.quantum_efficiency * light.values + np.asarray(dark, light.values.dtype)
        return light.with_values(rate * np.asarray(self.open_s, light.values.dtype))

    def bounds(self, budget: Any) -> dict[str, float]:
        """Return the influence of dark emission, by its mean, its noise and its pulses'
        skewness.
        """
        return {"EBI": budget.of_light(budget.dark_pe) + budget.of_skewness(budget.dark_pe)}


@dataclass(frozen=True, kw_only=True)
class BrightSourceProtection:
    """Supply of the photocathode behind its series resistor.

    Notes
    -----
    The drop follows Ohm's law, so it is linear in the cathode's current and the current in the
    light. Photoelectrons land rho = 2 d sqrt(eps/V) off the axis; the transfer exp(-(pi f rho)^2)
    at the full voltage is part of the tube's own MTF, so only the growth of rho^2 is a blur of its
    own. The halo's diameter, four gaps, knows no voltage.
    """

    gap_v: float  # voltage across the gap in the dark, V
    bright_source_v: float  # voltage that the supply does not go below, V
    # Illuminance, averaged over the cathode and over time, at which it has come down to that, lux.
    bright_source_lux: float
    gap_mm: float  # width of the gap, mm
    lateral_energy_ev: float  # energy with which photoelectrons leave across the axis, eV

    def __post_init__(self) -> None:
        if not 0.0 < self.bright_source_v <= self.gap_v:
            raise BadInput(
                "bright_source_v must be positive and at most gap_v, got "
                f"{self.bright_source_v:g} and {self.gap_v:g}"
            )
        check(self, positive="bright_source_lux")

    def voltage_v(self, cathode_lux: float) -> float:
        """Return the voltage across the gap under a mean illuminance, V."""
        return self.gap_v - (self.gap_v - self.bright_source_v) * min(
            cathode_lux / self.bright_source_lux, 1.0
        )

    def flight_um(self, voltage_v: float) -> float:
        """Return rho, how far off the axis photoelectrons land, um."""
        return 2e3 * self.gap_mm * float(np.sqrt(self.lateral_energy_ev / voltage_v))

    def blur(self, cathode_lux: float) -> GapSpread | None:
        """Return the blur beyond that of the full voltage; None without light."""
        growth = self.flight_um(self.voltage_v(cathode_lux)) ** 2 - self.flight_um(self.gap_v) ** 2
        return GapSpread(radius_um=float(np.sqrt(growth))) if growth > 0.0 else None


@dataclass(frozen=True, kw_only=True)
class ProximityGap(
    Stage,
    slot=Slot.GAP,
    section="photocathode",
    quantity="photoelectrons at the plate per exposure and cell, expected",
    takes="photoelectrons",
    emits="photoelectrons at the plate",
):
    """Proximity gap between cathode and MCP, with the halo of backscattered electrons."""

    # Blur of the direct electrons and of those backscattered from the MCP; None without halo.
    spread: StageBlur
    halo: HaloBlur | None
    grid: Grid  # cells on which the MCP receives them
    supply: BrightSourceProtection | None = None  # protection from bright sources; None without
    # Illuminance averaged over the cathode and over time, lux of 2856 K light that would draw the
    # same current.
    cathode_lux: float = 0.0
    effects: ClassVar = {"halo": {"halo": None}, "bright-source protection": {"supply": None}}

    @classmethod
    def of(cls, camera: CameraFrame, conditions: Conditions) -> Self:
        """Return the gap of a tube in the dark, with the share of the tube's blur before the
        gain.
        """
        sensor, cathode = camera.description, camera.description.photocathode
        return cls(
            spread=TubeShare.of(sensor.tube, 1.0 - float(sensor.tube.post_gain_share)),
            halo=HaloBlur(
                fraction=float(cathode.halo_fraction),
                gap_mm=float(cathode.gap_mm),
                elastic_share=float(cathode.halo_elastic_share),
            ),
            grid=camera.cells,
            supply=values_of(BrightSourceProtection, cathode),
        )

    @property
    def blurs(self) -> tuple[StageBlur, ...]:
        """All blurs of the gap."""
        protection = None if self.supply is None else self.supply.blur(self.cathode_lux)
        return tuple(blur for blur in (self.spread, self.halo, protection) if blur is not None)

    def mean(self, light: StageImage) -> StageImage:
        """Return the expected photoelectrons per cell of the MCP, pending blurs applied."""
        landing = light.with_blurs(*self.blurs)
        return (
            landing.with_blurs_applied()
            if light.grid == self.grid
            else landing.resample_to(self.grid)
        )

    def bounds(self, budget: Any) -> dict[str, float]:
        """Return the influence of halo and protection: the change of the light by their blurs."""
        assert self.halo is not None and self.supply is not None
        scattered = HaloBlur(
            fraction=1.0, gap_mm=self.halo.gap_mm, elastic_share=self.halo.elastic_share
        )
        protection = self.supply.blur(budget.cathode_lux)
        halo_change, n = budget.with_blur(scattered) - budget.mean_pe, budget.mean_pe
        return {
            "halo": self.halo.fraction * budget.of_light(halo_change),
            "bright-source protection": 0.0
            if protection is None
            else budget.of_light(budget.with_blur(protection) - n),
        }
