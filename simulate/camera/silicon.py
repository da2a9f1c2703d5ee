"""Silicon: photons become photoelectrons in the chip."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from labdata.conditions import Conditions
from labdata.errors import BadInput, check
from simulate.camera.chain import Slot, Stage
from simulate.camera.grid import CameraFrame, Grid
from simulate.camera.stage_image import StageImage


@dataclass(frozen=True, kw_only=True)
class Silicon(
    Stage,
    slot=Slot.SILICON,
    section="silicon",
    quantity="photoelectrons per exposure and cell, expected",
    takes="photons",
    emits="photoelectrons in the chip",
):
    """Photosensitive chip behind an electronic shutter.

    Notes
    -----
    Takes photons per second and cell, emits the expected photoelectrons per exposure and cell.
    Photoelectrons collected in a well are drawn there: independent photons are Poisson in number,
    and so are those that a blur before detection has displaced.
    """

    # Photoelectrons per photon at the wavelength to which the photons have been referred,
    # dimensionless.
    quantum_efficiency: float
    exposure_s: float  # time the shutter is open, s
    # cells on which the chip's pixels collect, half as many per pixel as those of the light
    grid: Grid

    @classmethod
    def of(cls, camera: CameraFrame, conditions: Conditions) -> Self:
        efficiency = max(camera.description.silicon.quantum_efficiency)
        # Stated exposure and offset of the shutter.
        exposure_s = camera.open_s(conditions) + 1e-6 * float(
            camera.description.readout.exposure_offset_us
        )
        return cls(quantum_efficiency=efficiency, exposure_s=exposure_s, grid=camera.cells)

    def __post_init__(self) -> None:
        if not 0.0 < self.quantum_efficiency <= 1.0:
            raise BadInput(
                f"quantum_efficiency must lie in (0, 1], got {self.quantum_efficiency:g}"
            )
        check(self, positive="exposure_s")

    def detect(self, light: StageImage) -> StageImage:
        """Return photoelectrons per exposure on the cells of the light."""
        return light.with_values(
            light.values * np.asarray(self.quantum_efficiency * self.exposure_s, np.float32)
        )

    def mean(self, light: StageImage) -> StageImage:
        """Return photoelectrons per exposure and cell, pending blurs applied."""
        return self.detect(light).resample_to(self.grid)
