"""The photocathode and the gap behind it: photons become photoelectrons, which land where the gap throws them."""

from dataclasses import dataclass

import numpy as np

from simulate.iiccd.grid import Grid
from simulate.iiccd.light import Light
from simulate.iiccd.transfer import Blur


@dataclass(frozen=True, kw_only=True)
class Photocathode:
    """Photocathode behind an electronic gate.

    Parameters
    ----------
    quantum_efficiency
        Photoelectrons per photon at the wavelength to which the photons have been referred, dimensionless.
    gate_s
        Time the gate is open in one exposure, s.
    ebi_per_s_cm2
        Photoelectrons emitted in the dark (equivalent background illumination), per s and cm2.

    Notes
    -----
    Takes photons per second and cell; emits the expected photoelectrons per exposure and cell. Nothing is drawn here:
    Poisson photoelectrons displaced at random are again Poisson photoelectrons of the blurred mean, so both the lens
    and the gap act on the mean and the plate draws (displacement theorem, Kingman, Poisson Processes, 5.1).
    """

    quantum_efficiency: float
    gate_s: float
    ebi_per_s_cm2: float
    name: str = "photocathode"
    takes: str = "photons"
    emits: str = "photoelectrons"

    def mean(self, light: Light) -> Light:
        """Return photoelectrons per exposure and cell."""
        dark = 0.0 if light.grid is None else self.ebi_per_s_cm2 * light.grid.cell_area_cm2
        rate = self.quantum_efficiency * light.values + np.asarray(dark, light.values.dtype)
        return light.with_values(rate * np.asarray(self.gate_s, light.values.dtype))

    def draw(self, light: Light, rng: np.random.Generator) -> Light:
        """Return the mean; the plate draws."""
        return self.mean(light)


@dataclass(frozen=True, kw_only=True)
class ProximityGap:
    """Flight from cathode to plate, with the electrons that bounce.

    Parameters
    ----------
    spread, halo
        Blur of the straight flight and of the electrons thrown back by the plate.
    grid
        Cells on which the plate receives them.
    """

    spread: Blur
    halo: Blur
    grid: Grid
    name: str = "gap"
    takes: str = "photoelectrons"
    emits: str = "photoelectrons at the plate"

    def mean(self, light: Light) -> Light:
        """Return the expected photoelectrons per cell of the plate, all blurs so far computed."""
        landing = light.blurred(self.spread, self.halo)
        return landing.paid() if light.grid == self.grid else landing.resampled(self.grid)

    def draw(self, light: Light, rng: np.random.Generator) -> Light:
        """Return the mean; the plate draws."""
        return self.mean(light)
