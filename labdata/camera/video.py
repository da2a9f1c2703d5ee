"""Sections of a camera description: read-out, video and digitiser."""

from dataclasses import dataclass
from typing import ClassVar

from labdata.camera.parameters import Parameter
from labdata.camera.thermal import BODY_C
from labdata.errors import BadInput, check, check_range


@dataclass(frozen=True, kw_only=True)
class Video:
    """Read-out and digitiser; of an analog camera, the video between them. A digital one has no
    bandwidth.
    """

    interlaced: bool
    field_rate_hz: Parameter  #: exposures per second; a progressive camera has one field a frame
    gamma: Parameter
    automatic_gain: bool  #: what the camera can do; whether it was on belongs to the session
    bit_depth: int
    black_level_dn: Parameter
    #: K, DN per electron at the output, behind any multiplication
    conversion_gain_dn_per_e: Parameter
    lines: int | None = None  #: of a frame, the blanked ones counted
    pixel_clock_mhz: Parameter | None = None
    bandwidth_mhz: Parameter | None = None
    filter_order: int | None = None
    aperture_correction_db: Parameter | None = None  #: boost at 4.5 MHz
    resolution_horizontal_tvl: Parameter | None = None  #: television lines per picture height
    resolution_vertical_tvl: Parameter | None = None
    output_vpp: Parameter | None = None
    impedance_ohm: Parameter | None = None
    setup_ire: Parameter | None = None  #: black above blanking
    sensitivity_lux: Parameter | None = None  #: as the maker states it
    signal_to_noise_db: Parameter | None = None
    automatic_gain_range_db: Parameter | None = None
    automatic_gain_s: Parameter | None = None  #: time constant
    sync_jitter_ns: Parameter | None = None  #: standard deviation of a line's start
    line_noise_dn: Parameter | None = None  #: standard deviation of an offset common to a line

    def __post_init__(self) -> None:
        check(self, positive="field_rate_hz gamma conversion_gain_dn_per_e")
        check_range(self, 1, 16, "bit_depth")
        analog = [name for name in _ANALOG if getattr(self, name) is not None]
        if self.digital and analog:
            raise BadInput(
                f"a camera without bandwidth_mhz must have no analog video, got {', '.join(analog)}"
            )
        if not self.digital and len(analog) < len(_ANALOG):
            missing = [name for name in _ANALOG if getattr(self, name) is None]
            raise BadInput(
                f"a camera with bandwidth_mhz must have all its analog video, got no "
                f"{', '.join(missing)}"
            )
        if self.automatic_gain and None in (self.automatic_gain_range_db, self.automatic_gain_s):
            raise BadInput(
                "a camera with automatic_gain must have automatic_gain_range_db and "
                "automatic_gain_s"
            )
        check(
            self,
            positive="bandwidth_mhz pixel_clock_mhz automatic_gain_s",
            not_negative="sync_jitter_ns line_noise_dn automatic_gain_range_db",
            one_or_more="filter_order",
        )

    @property
    def digital(self) -> bool:
        """Whether the charge is digitised pixel by pixel, without a video signal between."""
        return self.bandwidth_mhz is None

    @property
    def low_pass(self) -> tuple[float, float, int] | None:
        """Bandwidth in MHz, pixel clock in MHz and order of the video's low pass; None of a digital
        camera.
        """
        if self.bandwidth_mhz is None or self.pixel_clock_mhz is None or self.filter_order is None:
            return None
        return float(self.bandwidth_mhz), float(self.pixel_clock_mhz), self.filter_order


# What the simulated video of an analog camera cannot do without, and a digital camera cannot have.
_ANALOG = (
    "lines",
    "pixel_clock_mhz",
    "filter_order",
    "aperture_correction_db",
    "sync_jitter_ns",
    "line_noise_dn",
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
        check_range(self, 0.01, BODY_C[1], "span_k")
        if (self.level_c is None) != (self.span_k is None):
            raise BadInput("level_c and span_k must be given together, got one of them")
        if self.level_c is not None and self.span_k is not None:
            black_c, full_c = (
                float(self.level_c) + side * float(self.span_k) for side in (-0.5, 0.5)
            )
            if not BODY_C[0] <= black_c < full_c <= BODY_C[1]:
                raise BadInput(
                    f"level_c less and plus half of span_k must lie within {BODY_C[0]:g} to "
                    f"{BODY_C[1]:g} C, got {black_c:g} to {full_c:g} C"
                )
