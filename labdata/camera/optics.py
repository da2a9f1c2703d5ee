"""Sections of a camera description: lens, and spectral band of a thermal imager."""

from dataclasses import dataclass

from labdata.camera.parameters import Parameter
from labdata.errors import BadInput, check, check_range


@dataclass(frozen=True, kw_only=True)
class Optics:
    """Lens. Lengths at the photocathode, or at the chip of a camera without a tube."""

    f_number: Parameter
    transmission: Parameter
    aberration_blur_um: Parameter  #: s of the MTF exp(-2 (pi f s)^2)
    veiling_glare_fraction: Parameter
    focal_length_mm: Parameter
    vignetting_fraction: Parameter  #: of the light, lost at the picture's corner beyond cos^4
    distortion_fraction: Parameter  #: radial, at the picture's corner; positive is pincushion
    focal_shift_um: Parameter  #: how far 925 nm focuses behind 500 nm; linear in wavelength
    focus_nm: Parameter  #: wavelength of best focus

    def __post_init__(self) -> None:
        check(
            self,
            positive="f_number focal_length_mm focus_nm",
            fraction="transmission veiling_glare_fraction vignetting_fraction",
            not_negative="aberration_blur_um",
        )
        check_range(self, -0.5, 0.5, "distortion_fraction")


@dataclass(frozen=True, kw_only=True)
class Band:
    """Spectral band within which the imager responds."""

    short_um: Parameter
    long_um: Parameter

    def __post_init__(self) -> None:
        check(self, positive="short_um long_um")
        if not float(self.short_um) < float(self.long_um):
            raise BadInput(
                f"short_um must lie below long_um, got {float(self.short_um):g} and "
                f"{float(self.long_um):g}"
            )


@dataclass(frozen=True, kw_only=True)
class InfraredOptics:
    """Lens and window."""

    f_number: Parameter
    transmission: Parameter  #: of lens, window and filter within the band
    #: standard deviation of a Gaussian blur; beyond diffraction where diffraction_um is given
    blur_mrad: Parameter
    #: wavelength of the diffraction; absent: blur_mrad holds it
    diffraction_um: Parameter | None = None
    focal_length_mm: Parameter | None = None  #: of an array; a scanner has fields of view

    def __post_init__(self) -> None:
        check(
            self,
            positive="f_number transmission diffraction_um focal_length_mm",
            fraction="transmission",
            not_negative="blur_mrad",
        )
