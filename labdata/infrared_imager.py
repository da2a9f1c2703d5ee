"""Description of an infrared imager: a thermal scanner, a bolometer array or a cooled array."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from labdata.camera_description import Description, Parameter
from labdata.errors import BadInput, check, check_range

# Temperatures of the black bodies of a description, C.
_BODY_C = (-200.0, 2000.0)


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


@dataclass(frozen=True, kw_only=True)
class Scanner:
    """One cooled detector behind a resonant mirror that scans lines both ways and a mirror that
    scans fields.
    """

    lines_per_field: int  #: active lines
    samples: int  #: of an active line
    horizontal_field_deg: Parameter
    vertical_field_deg: Parameter
    #: side of the detector's square footprint, the width of its slit response at 50 %
    ifov_mrad: Parameter
    detector_um: Parameter  #: side of the detector
    detectivity_cm_hz_per_w: Parameter  #: specific detectivity D*, cm Hz^(1/2) W^-1
    mirror_hz: Parameter  #: frequency of the resonant mirror; each half period is a line
    active_fraction: Parameter  #: of a half period, in which the line is sampled
    linearised: bool  #: whether samples are equal steps of angle, not of time
    clock_error_ns: Parameter  #: by which samples come late, beyond the delay of the electronics
    bandwidth_mhz: Parameter  #: 3 dB frequency of the electronics, one pole
    coupling_hz: Parameter  #: high-pass frequency of the coupling
    knee_hz: Parameter  #: frequency below which 1/f noise exceeds white noise
    #: samples of the turn whose mean sets the zero of the next line; 0 is a perfect zero
    clamp_samples: int
    reference_c: Parameter  #: temperature of the black body seen in the turn
    #: by how much the detector, seeing itself, cools the axis over the corners
    narcissus_k: Parameter | None = None
    averaged_frames: int = 1  #: frames of which the imager gives the mean, one after the other

    def __post_init__(self) -> None:
        check(
            self,
            one_or_more="lines_per_field samples averaged_frames",
            positive="horizontal_field_deg vertical_field_deg ifov_mrad detector_um "
            "detectivity_cm_hz_per_w mirror_hz active_fraction bandwidth_mhz",
            not_negative="coupling_hz knee_hz clamp_samples",
        )
        check_range(self, 0.05, 0.98, "active_fraction")
        check_range(self, 0.0, 90.0, "horizontal_field_deg", "vertical_field_deg")
        check_range(self, 1.0, 2e4, "mirror_hz")
        check_range(self, 0.05, 1e3, "bandwidth_mhz")
        check_range(self, -1e3, 1e3, "clock_error_ns")
        check_range(self, *_BODY_C, "reference_c")
        check_range(self, -100.0, 100.0, "narcissus_k")


@dataclass(frozen=True, kw_only=True)
class PixelArray:
    """Format of an array of pixels."""

    columns: int
    rows: int
    pitch_um: Parameter

    def __post_init__(self) -> None:
        check(self, one_or_more="columns rows", positive="pitch_um")
        check_range(self, 0.1, 1e3, "pitch_um")


@dataclass(frozen=True, kw_only=True)
class Bolometer(PixelArray):
    """Uncooled array of microbolometers with a shutter; noise terms are standard deviations over
    the netd.
    """

    netd_mk: Parameter  #: temporal noise of one pixel against a black body of 300 K
    time_constant_ms: Parameter  #: thermal time constant of a pixel
    pixel_pattern_after_shutter: Parameter  #: fixed pattern of single pixels just after a shutter
    pixel_pattern_before_shutter: Parameter  #: and just before the next one
    column_pattern: Parameter
    row_pattern: Parameter
    row_noise: Parameter  #: temporal noise common to a row
    column_noise: Parameter  #: temporal noise common to a column
    frame_noise: Parameter  #: temporal noise common to a frame
    shutter_interval_s: Parameter
    drift_mk_per_min: Parameter  #: of the whole frame by the housing, since the last shutter

    def __post_init__(self) -> None:
        super().__post_init__()
        check(
            self,
            positive="netd_mk time_constant_ms shutter_interval_s",
            not_negative="pixel_pattern_after_shutter pixel_pattern_before_shutter column_pattern "
            "row_pattern row_noise column_noise frame_noise",
        )


@dataclass(frozen=True, kw_only=True)
class CooledArray(PixelArray):
    """Cooled array of photodiodes, exposed all at once and corrected at two temperatures."""

    quantum_efficiency: Parameter
    integration_ms: Parameter
    full_well_e: Parameter
    read_noise_e: Parameter
    correction_low_c: Parameter  #: lower black body of the two-point correction
    correction_high_c: Parameter
    #: fixed pattern midway between the two, over the temporal noise there
    correction_residual: Parameter
    pixel_pattern: Parameter  #: fixed pattern that no correction removes, over the temporal noise

    def __post_init__(self) -> None:
        super().__post_init__()
        check(
            self,
            positive="quantum_efficiency integration_ms full_well_e",
            fraction="quantum_efficiency",
            not_negative="read_noise_e correction_residual pixel_pattern",
        )
        check_range(self, *_BODY_C, "correction_low_c", "correction_high_c")
        if not float(self.correction_low_c) < float(self.correction_high_c):
            raise BadInput(
                "correction_low_c must lie below correction_high_c, got "
                f"{float(self.correction_low_c):g} and {float(self.correction_high_c):g}"
            )


@dataclass(frozen=True, kw_only=True)
class InfraredVideo:
    """Gain and level, and the digitiser."""

    interlaced: bool
    field_rate_hz: Parameter  #: a progressive imager has one field a frame
    bit_depth: int
    level_c: Parameter | None = None  #: temperature in the middle of the span
    #: from black to full scale; both absent: full scale is 98 % of the full well
    span_k: Parameter | None = None

    automatic_gain: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check(self, positive="field_rate_hz span_k")
        check_range(self, 1, 16, "bit_depth")
        check_range(self, 1.0, 1e3, "field_rate_hz")
        check_range(self, 0.01, _BODY_C[1], "span_k")
        if (self.level_c is None) != (self.span_k is None):
            raise BadInput("level_c and span_k must be given together, got one of them")
        if self.level_c is not None and self.span_k is not None:
            black_c, full_c = (
                float(self.level_c) + side * float(self.span_k) for side in (-0.5, 0.5)
            )
            if not _BODY_C[0] <= black_c < full_c <= _BODY_C[1]:
                raise BadInput(
                    f"level_c less and plus half of span_k must lie within {_BODY_C[0]:g} to "
                    f"{_BODY_C[1]:g} C, got {black_c:g} to {full_c:g} C"
                )


KINDS = ("scanner", "bolometer", "cooled_array")


@dataclass(frozen=True, kw_only=True)
class InfraredImager(Description):
    """A thermal imager; the one of [scanner], [bolometer] and [cooled_array] that it has says of
    which kind it is.
    """

    name: str
    band: Band
    optics: InfraredOptics
    video: InfraredVideo
    scanner: Scanner | None = None
    bolometer: Bolometer | None = None
    cooled_array: CooledArray | None = None
    notes: tuple[str, ...] = ()

    is_thermal: ClassVar[bool] = True

    def __post_init__(self) -> None:
        given = [name for name in KINDS if getattr(self, name) is not None]
        if len(given) != 1:
            raise BadInput(
                f"a thermal imager must have one of {', '.join(KINDS)}, got "
                f"{', '.join(given) or 'none'}"
            )
        if self.video.interlaced != (self.scanner is not None):
            raise BadInput("a scanner must be interlaced and an array progressive, got the reverse")
        if self.scanner is not None:
            lines = 2.0 * float(self.scanner.mirror_hz) / float(self.video.field_rate_hz)
            if not self.scanner.lines_per_field <= lines:
                raise BadInput(
                    "a mirror must scan all lines_per_field within a field, got "
                    f"{self.scanner.lines_per_field} of {lines:.4g} lines"
                )
        if (self.video.span_k is None) != (self.cooled_array is not None):
            raise BadInput(
                "a cooled array must have no level_c and span_k, and other imagers must have both"
            )
        if (self.optics.focal_length_mm is None) != (self.scanner is not None):
            raise BadInput("an array must have a focal_length_mm, and a scanner none")

    @property
    def array(self) -> PixelArray | None:
        """The array of pixels; None of a scanner."""
        return self.bolometer or self.cooled_array

    @property
    def pitch_mrad(self) -> tuple[float, float]:
        """Angle between rows and between columns, mrad."""
        rows, columns = self.shape
        if self.scanner is not None:
            fields = (
                float(self.scanner.vertical_field_deg),
                float(self.scanner.horizontal_field_deg),
            )
            return float(np.radians(fields[0])) * 1e3 / rows, float(
                np.radians(fields[1])
            ) * 1e3 / columns
        assert self.array is not None and self.optics.focal_length_mm is not None
        pitch = float(self.array.pitch_um) / float(self.optics.focal_length_mm)
        return pitch, pitch

    @property
    def footprint_mrad(self) -> float:
        """Side of the detector's footprint in the scene (IFOV), mrad."""
        return self.pitch_mrad[0] if self.scanner is None else float(self.scanner.ifov_mrad)

    @property
    def frame_rate_hz(self) -> float:
        """Frames per second, of averaged ones where the imager averages."""
        return float(self.video.field_rate_hz) / (
            1.0 if self.scanner is None else 2.0 * self.scanner.averaged_frames
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of a frame."""
        if self.scanner is not None:
            return 2 * self.scanner.lines_per_field, self.scanner.samples
        assert self.array is not None
        return self.array.rows, self.array.columns
