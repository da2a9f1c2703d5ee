"""Silicon that sees the scene itself: photons become photoelectrons, without a tube."""

from dataclasses import dataclass

import numpy as np

from labdata.errors import BadInput
from simulate.iiccd.grid import Grid
from simulate.iiccd.stage_image import StageImage


@dataclass(frozen=True, kw_only=True)
class Silicon:
    """Photosensitive chip behind an electronic shutter.

    Parameters
    ----------
    quantum_efficiency
        Photoelectrons per photon at the wavelength to which the photons have been referred, dimensionless.
    exposure_s
        Time the shutter is open, s.
    grid
        Cells on which the chip's pixels collect, half as many per pixel as those of the light.

    Notes
    -----
    Takes photons per second and cell, emits the expected photoelectrons per exposure and cell. Photoelectrons collected
    in a well are drawn there, `simulate.iiccd.ccd`: independent photons are Poisson in number, and so are those that a
    blur before detection has displaced.
    """

    quantum_efficiency: float
    exposure_s: float
    grid: Grid
    name: str = "silicon"
    takes: str = "photons"
    emits: str = "photoelectrons in the chip"

    def __post_init__(self) -> None:
        if not 0.0 < self.quantum_efficiency <= 1.0:
            raise BadInput(f"quantum_efficiency must lie in (0, 1], got {self.quantum_efficiency:g}")
        if not self.exposure_s > 0.0:
            raise BadInput(f"exposure_s must be positive, got {self.exposure_s:g}")

    def mean(self, light: StageImage) -> StageImage:
        """Return photoelectrons per exposure and cell, all blurs so far computed."""
        counted = light.values * np.asarray(self.quantum_efficiency * self.exposure_s, light.values.dtype)
        return light.with_values(counted).resample_to(self.grid)

    def draw(self, light: StageImage, rng: np.random.Generator) -> StageImage:
        """Return the mean; the wells draw."""
        return self.mean(light)
