"""Lens and detector of an infrared imager: from cells of the scene to the pixels or lines of a
frame.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar, Self

import numpy as np

from labdata import BadInput, Conditions
from simulate.arrays import Array
from simulate.camera.chain import Stage, values_of
from simulate.camera.grid import irfft_image, rfft_image
from simulate.camera.stage_image import StageImage
from simulate.camera.thresholds import LIMITS

KELVIN = 273.15


class Slot(StrEnum):
    """Place of a stage in the chain, in the order of the light; its random numbers follow from the
    value.
    """

    OPTICS = "optics and footprint"
    NARCISSUS = "narcissus"
    AVERAGE = "frame averaging"
    SCAN = "line scan"
    LAG = "thermal lag"
    NOISE = "noise"
    PATTERN = "fixed pattern"
    DIGITISER = "digitiser"


def diffraction_transfer(
    frequency_cy_per_mrad: Array, wavelength_um: float, aperture_mm: float
) -> Array:
    r"""Return the transfer of a perfect lens of a round aperture.

    Notes
    -----
    .. math:: T = \frac{2}{\pi} (\arccos x - x \sqrt{1 - x^2}), \quad x = f \lambda / D
    """
    x = np.minimum(np.abs(frequency_cy_per_mrad) * wavelength_um / aperture_mm, 1.0)
    return 2.0 / np.pi * (np.arccos(x) - x * np.sqrt(1.0 - x * x))


@dataclass(frozen=True, kw_only=True)
class Optics(
    Stage, slot=Slot.OPTICS, section="optics", takes="signal of cells", emits="signal of pixels"
):
    """Blur of the lens and average over the detector's footprint, at the pixels of a frame.

    Cells are the picture's own, whole numbers of them in a pixel; their averages are undone, so
    that the blur does not depend on their number.
    """

    effects: ClassVar = {
        "optics blur": {"blur_mrad": 0.0, "diffraction_um": None},
        "detector footprint": {"footprint_mrad": None},
    }
    shape: tuple[int, int]
    pitch_mrad: tuple[float, float]  # of rows and columns
    footprint_mrad: float | None  # side of the detector's image in the scene; None: that of a cell
    blur_mrad: float
    diffraction_um: float | None
    aperture_mm: float
    whole_lines: bool  # whether columns stay cells, for a line scan

    @classmethod
    def of(cls, camera: Any, conditions: Conditions) -> Self:
        """Return the lens of an imager; an aperture of 1 stands for one without focal length."""
        description, optics = camera.description, camera.description.optics
        focal_mm = 1.0 if optics.focal_length_mm is None else float(optics.focal_length_mm)
        wave = optics.diffraction_um
        return values_of(
            cls,
            optics,
            shape=camera.shape,
            pitch_mrad=camera.pitch_mrad,
            whole_lines=description.scanner is not None,
            footprint_mrad=description.footprint_mrad,
            diffraction_um=None if wave is None else float(wave),
            aperture_mm=focal_mm / float(optics.f_number),
        )

    def transfer(self, fy: Array, fx: Array, cell_mrad: tuple[float, float]) -> Array:
        """Return the transfer from cell averages to the detector, at frequencies in cy/mrad."""
        square = fy**2 + fx**2
        transfer = np.exp(-2.0 * (np.pi * self.blur_mrad) ** 2 * square)
        if self.diffraction_um is not None:
            transfer = transfer * diffraction_transfer(
                np.sqrt(square), self.diffraction_um, self.aperture_mm
            )
        for frequency, cell in ((fy, cell_mrad[0]), (fx, cell_mrad[1])):
            side = cell if self.footprint_mrad is None else self.footprint_mrad
            transfer = transfer * (np.sinc(frequency * side) / np.sinc(frequency * cell))
        return transfer

    def mean(self, light: StageImage) -> StageImage:
        values = np.asarray(light.values, np.float32)
        oversample = values.shape[-2] // self.shape[0]
        if oversample < 1 or values.shape[-2:] != (
            oversample * self.shape[0],
            oversample * self.shape[1],
        ):
            raise BadInput(
                f"a picture must have a whole number of cells in each of {self.shape[0]} x "
                f"{self.shape[1]} pixels, got {values.shape[-2]} x {values.shape[-1]}"
            )
        margin, level = LIMITS.margin_px * oversample, np.float32(values.mean(dtype=float))
        padded = np.pad(
            values - level, [(0, 0)] * (values.ndim - 2) + [(margin, margin)] * 2, mode="edge"
        )
        cell = self.pitch_mrad[0] / oversample, self.pitch_mrad[1] / oversample
        fy, fx = (
            np.fft.fftfreq(padded.shape[-2])[:, None],
            np.fft.rfftfreq(padded.shape[-1])[None, :],
        )
        transfer = self.transfer(fy / cell[0], fx / cell[1], cell).astype(np.complex64)
        # The middle of a pixel lies on an edge of cells where these are even in number.
        shift = 0.5 if oversample % 2 == 0 else 0.0
        transfer *= np.exp(2j * np.pi * shift * (fy + (0.0 if self.whole_lines else fx))).astype(
            np.complex64
        )
        blurred = irfft_image(rfft_image(padded) * transfer, padded.shape[-2:])[
            ..., margin:-margin, margin:-margin
        ]
        centre = (oversample - 1) // 2
        sampled = (
            blurred[..., centre::oversample, :]
            if self.whole_lines
            else blurred[..., centre::oversample, centre::oversample]
        )
        return light.with_values(sampled + level)
