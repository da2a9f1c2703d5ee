"""Sections of a camera description: thermal scanner, bolometer array and cooled array."""

from dataclasses import dataclass

from labdata.camera.parameters import Parameter
from labdata.errors import BadInput, check, check_range

# Temperatures of the black bodies of a description, C.
BODY_C = (-200.0, 2000.0)
# Directions in which the lines of a two-way scanner run in turn, the first line first.
SCAN_DIRECTIONS = ("to the right", "to the left")


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
        check_range(self, *BODY_C, "reference_c")
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
        check_range(self, *BODY_C, "correction_low_c", "correction_high_c")
        if not float(self.correction_low_c) < float(self.correction_high_c):
            raise BadInput(
                "correction_low_c must lie below correction_high_c, got "
                f"{float(self.correction_low_c):g} and {float(self.correction_high_c):g}"
            )
