"""Lens: blur and veiling glare of stated illuminance, and spectral radiance to photons on the
photocathode.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from labdata.conditions import Conditions
from labdata.errors import BadInput, check
from simulate.camera import image_placement, tube_photometry
from simulate.camera.chain import Slot, Stage, values_of
from simulate.camera.grid import ACCURACY, CameraFrame, Grid, irfft_image, rfft_image
from simulate.camera.stage_image import StageImage
from simulate.camera.transfer import Defocus, Lens, StageBlur
from simulate.radiance.cube import RadianceCube


@dataclass(frozen=True, kw_only=True)
class Optics(
    Stage,
    slot=Slot.OPTICS,
    section="optics",
    quantity="photons per s and cell, of the wavelength detected best",
    takes="photons",
    emits="photons",
):
    """Lens between the scene and the photocathode."""

    blur: StageBlur  # its blur
    # fraction of the light that is spread evenly over the image, dimensionless
    veiling_glare_fraction: float

    @classmethod
    def of(cls, camera: CameraFrame, conditions: Conditions) -> Self:
        """Return the lens of a camera for light stated at the photocathode."""
        optics = camera.description.optics
        wavelength = (
            {}
            if conditions.wavelength_nm is None
            else {"wavelength_um": conditions.wavelength_nm * 1e-3}
        )
        return values_of(cls, optics, blur=values_of(Lens, optics, **wavelength))

    def mean(self, light: StageImage) -> StageImage:
        """Return (1 - v) E + v mean(E), with the blur pending; the sum over cells is conserved."""
        return light.with_values(
            add_veiling_glare(light.values, self.veiling_glare_fraction)
        ).with_blurs(self.blur)


def add_veiling_glare(image: NDArray, fraction: float) -> NDArray:
    """Return (1 - v) E + v mean(E): a fraction of the light spread evenly."""
    level = image.mean(axis=(-2, -1), keepdims=True, dtype=np.float64)
    return (1.0 - fraction) * image + np.asarray(fraction * level, image.dtype)


# Wavelengths between which the focal shift is stated.
FOCUS_SPAN_NM = (500.0, 925.0)


@dataclass(frozen=True, kw_only=True)
class RadiometricLens(
    Stage,
    slot=Slot.OPTICS,
    section="optics",
    quantity="photons per s and cell, of the wavelength detected best",
    takes="radiance",
    emits="photons",
):
    """Lens that images a scene of known spectral radiance on the photocathode, or on a chip without
    a tube.

    Notes
    -----
    E = pi tau L / (4 N^2 (1 + m)^2) per wavelength on the axis, times cos^4(theta), tan(theta) = r
    / (f (1 + m)), and vignetting (Born and Wolf, Principles of Optics, 4.8.3). Light per area
    follows distortion: where the image is stretched, the same light covers more of it, so light is
    conserved and a flat scene darkens where it is stretched. It emits photons per s and cell
    *referred to the wavelength of peak efficiency*: a photon that is detected half as well counts
    half. All bands can then travel on as one image. Each band is blurred by its own diffraction and
    defocus; as these vary smoothly, few images suffice for any number of bands
    (`Accuracy.band_transfer_error`).
    """

    # N and tau, dimensionless.
    f_number: float
    transmission: float
    focal_length_mm: float  # focal length, mm
    # Quantum efficiency of what lies behind, over the wavelengths of its table, at any scale.
    detector_nm: tuple[float, ...]
    detector_efficiency: tuple[float, ...]
    grid: Grid  # cells on which the photons arrive
    # size of the image over that of the scene, dimensionless; 0 for a distant scene
    magnification: float = 0.0
    aberration_blur_um: float = 0.0  # s of exp(-2 (pi f s)^2), um
    # How far 925 nm focuses behind 500 nm, linear in wavelength, and the wavelength in focus.
    focal_shift_um: float = 0.0
    focus_nm: float = 700.0
    # fraction of the light that is spread evenly over the image
    veiling_glare_fraction: float = 0.0
    # Fraction of the light lost at the image's corner beyond cos^4; it grows with the square of the
    # distance from the axis.
    vignetting_fraction: float = 0.0
    distortion_fraction: float = 0.0  # radial displacement at the corner, positive for pincushion
    # Whether a frame's row sums two rows of the chip: where the image lies, see
    # `image_placement.place_on_cells`.
    row_pairs: bool = False

    def __post_init__(self) -> None:
        check(self, positive="f_number transmission focal_length_mm", not_negative="magnification")
        for name in ("vignetting_fraction", "veiling_glare_fraction"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise BadInput(f"{name} must lie in [0, 1), got {getattr(self, name):g}")

    @property
    def t_number(self) -> float:
        """T = N / sqrt(tau): the f-number of a lens without loss that is as bright,
        dimensionless.
        """
        return self.f_number / self.transmission**0.5

    @property
    def gathering_sr(self) -> float:
        """Irradiance on the axis over the scene's radiance, pi / (4 T^2 (1 + m)^2), sr."""
        return float(np.pi / (4.0 * self.t_number**2 * (1.0 + self.magnification) ** 2))

    def falloff(self, radius_mm: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return cos^4(theta) times vignetting at distances from the axis, dimensionless."""
        square = np.square(radius_mm)
        loss = square * (self.vignetting_fraction / image_placement.corner_mm(self.grid) ** 2)
        secant = 1.0 + square / (self.focal_length_mm * (1.0 + self.magnification)) ** 2
        return np.maximum(1.0 - loss, 0.0) / (secant * secant)

    def transfer(
        self, wavelength_nm: float, frequency_per_mm: NDArray[np.floating]
    ) -> NDArray[np.floating]:
        """Return the transfer at one wavelength, over frequencies in cycles/mm on the
        photocathode.
        """
        nowhere = np.zeros_like(frequency_per_mm)
        span = FOCUS_SPAN_NM[1] - FOCUS_SPAN_NM[0]
        off_um = self.focal_shift_um * (wavelength_nm - self.focus_nm) / span
        lens = Lens(
            aberration_blur_um=self.aberration_blur_um,
            f_number=self.f_number,
            wavelength_um=wavelength_nm * 1e-3,
        ).transfer(frequency_per_mm, nowhere)
        if off_um == 0.0:
            return lens
        return lens * Defocus(shift_um=off_um, f_number=self.f_number).transfer(
            frequency_per_mm, nowhere
        )

    def mean(self, light: RadianceCube) -> StageImage:
        """Return photons per s and cell, all blurs of the lens computed; an impossible radiance is
        refused.
        """
        lowest, highest = light.radiance.min(), light.radiance.max()
        if not (np.isfinite(lowest) and np.isfinite(highest)):
            raise BadInput(f"radiance must be finite everywhere, got {lowest:g} to {highest:g}")
        if lowest < 0.0:
            raise BadInput(f"radiance must not be negative, got {lowest:g}")
        relative = np.asarray(self.detector_efficiency) / max(self.detector_efficiency)
        per_m2 = tube_photometry.detection_weights(
            light.wavelength_nm, self.detector_nm, relative, averaged=light.averaged
        )
        weight = per_m2 * self.gathering_sr * self.grid.cell_area_cm2 * 1e-4
        radius = np.hypot(*self.grid.frequencies())
        frequency = np.linspace(0.0, float(radius.max()), ACCURACY.n_band_frequencies)
        transfers = np.stack([self.transfer(nm, frequency) for nm in light.wavelength_nm])
        weights, shapes = few_transfers(transfers, weight)
        radiance = light.radiance.astype(np.float32, copy=False)
        images = self._arriving(
            list(np.tensordot((weights * weight).astype(np.float32), radiance, axes=1))
        )
        images[0] = add_veiling_glare(images[0], self.veiling_glare_fraction)
        total = sum(
            rfft_image(image) * np.interp(radius, frequency, shape).astype(np.float32)
            for image, shape in zip(images, shapes, strict=True)
        )
        return StageImage(
            values=irfft_image(np.asarray(total), self.grid.shape).astype(np.float32),
            grid=self.grid,
        )

    def _arriving(self, images: list[NDArray[np.float32]]) -> list[NDArray[np.float32]]:
        """Sharp images on the cells with the lens's geometry and falloff; they are given per cell
        area.
        """
        on_cells = [
            image_placement.place_on_cells(image, self.grid, row_pairs=self.row_pairs)
            for image in images
        ]
        x, y = (axis.astype(np.float32) for axis in image_placement.cell_centres(self.grid))
        brightness = self.falloff(np.hypot(x, y))
        if self.distortion_fraction == 0.0:
            return [np.asarray(image * brightness, np.float32) for image in on_cells]
        radial = image_placement.Radial(
            fraction=self.distortion_fraction, corner_mm=image_placement.corner_mm(self.grid)
        )
        from_x, from_y, area = radial.source(x, y)
        brightness = (brightness * area).astype(np.float32)
        return [
            image_placement.resample_image(image, self.grid, from_x, from_y, order=1) * brightness
            for image in on_cells
        ]


def few_transfers(
    transfers: NDArray[np.floating], weight: NDArray[np.floating]
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Return the few shapes of which the transfer of each band, (band, frequency), is a weighted
    sum.

    Returns
    -------
    weights, shapes
        (shape, band) and (shape, frequency): transfers = shares.T @ shapes within
        `Accuracy.band_transfer_error`. The first shape is the mean by weight, with shares of 1; all
        others vanish at zero frequency, so that no light is won or lost.
    """
    mean = np.average(transfers, axis=0, weights=weight if weight.sum() > 0.0 else None)
    u, size, v = np.linalg.svd(transfers - mean, full_matrices=False)
    components = 0
    while (
        components < len(size)
        and np.abs((u[:, components:] * size[components:]) @ v[components:]).max()
        > ACCURACY.band_transfer_error
    ):
        components += 1
    weights = np.concatenate(
        [np.ones((1, len(transfers))), (u[:, :components] * size[:components]).T]
    )
    return weights, np.concatenate([mean[None], v[:components]])
