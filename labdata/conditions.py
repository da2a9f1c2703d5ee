"""Conditions of a stack: gain, gate, exposure, light and temperatures."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Generic, TypedDict, TypeVar

from labdata.errors import check, check_range

# Booleans; every other condition is a number.
SWITCHES = ("automatic_gain", "brightness_control")
# Conditions that set a gain: flats of one value of each make one photon transfer curve.
GAINS = ("mcp_v", "gain_control", "em_gain", "camera_gain_db")
T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Settings of one stack, each None when unknown. Units are in the names."""

    exposure_s: float | None = None  #: Exposure of the camera (one field of interlaced video), s
    mcp_v: float | None = None  #: Voltage across the microchannel plate, V
    gate_ns: float | None = None  #: Time that the gate is open in one exposure, ns
    #: Illuminance on the photocathode from the brightest large area of the target, 2856 K, lux
    illuminance_lux: float | None = None
    #: Relative standard uncertainty of the illuminance, or of the photons on a pixel,
    #: dimensionless; one meter for the whole session, so the error is common to all its stacks
    illuminance_relative_sd: float | None = None
    photons_per_px: float | None = None  #: Photons that fall on one pixel in one exposure
    camera_gain_db: float | None = None  #: Gain of the camera after the intensifier, dB
    temperature_c: float | None = None  #: Temperature of the camera or tube, degrees Celsius
    wavelength_nm: float | None = None  #: Wavelength of the light where it is narrow, nm
    automatic_gain: bool | None = None  #: Whether the camera's automatic gain was on
    #: Whether automatic brightness control was lowering the MCP voltage
    brightness_control: bool | None = None
    #: Multiplication of an electron-multiplying register, dimensionless, at least 1
    em_gain: float | None = None
    gain_control: float | None = None  #: Control word of the tube's gain, counts
    lamp_a: float | None = None  #: Current through the lamp of the bench, A
    #: Power on the head of the auxiliary light meter, W, zero offset not subtracted
    metered_w: float | None = None
    #: Illuminance on the photocathode by that meter, lux, zero offset not subtracted
    metered_lux: float | None = None
    metered_time_s: float | None = None  #: When meter and thermometer were read, s since 1970
    temperature_time_s: float | None = None  #: When meter and thermometer were read, s since 1970
    luminous_gain: float | None = None  #: Luminous gain of the tube by its calibration, lm/lm
    #: Relative standard uncertainty of that calibration, dimensionless; its error is common to all
    #: stacks
    luminous_gain_relative_sd: float | None = None
    #: Optical density (base 10) of the neutral filter in the beam; the illuminance is that behind
    #: the filter
    filter_density: float | None = None
    #: Temperature of the black body that fills the field of view, degrees Celsius
    blackbody_c: float | None = None
    #: Temperature of the background of a black body or target: the room, or the plate around it,
    #: degrees Celsius
    background_c: float | None = None
    #: Position of the lens or of the target along the axis in a series through focus, mm
    focus_mm: float | None = None

    def __post_init__(self) -> None:
        names = [item.name for item in fields(Conditions)]
        free = {
            "camera_gain_db",
            "temperature_c",
            "metered_w",
            "metered_lux",
            "blackbody_c",
            "background_c",
            "focus_mm",
        }
        check(
            self,
            finite=names,
            not_negative=[name for name in names if name not in free],
            one_or_more="em_gain",
        )
        check_range(self, -200.0, 200.0, "camera_gain_db")
        check_range(self, -200.0, 150.0, "temperature_c")  # plausible for a camera
        check_range(self, -200.0, 3000.0, "blackbody_c", "background_c")


class ConditionSettings(TypedDict, Generic[T], total=False):
    """Conditions as parameters of a function: numbers, or what stands for one; see `Conditions`."""

    exposure_s: T
    mcp_v: T
    gate_ns: T
    illuminance_lux: T
    illuminance_relative_sd: T
    photons_per_px: T
    camera_gain_db: T
    temperature_c: T
    wavelength_nm: T
    automatic_gain: bool
    brightness_control: bool
    em_gain: T
    gain_control: T
    lamp_a: T
    metered_w: T
    metered_lux: T
    metered_time_s: T
    temperature_time_s: T
    luminous_gain: T
    luminous_gain_relative_sd: T
    filter_density: T
    blackbody_c: T
    background_c: T
    focus_mm: T


class StackConditions(ConditionSettings[float], total=False):
    """Fields of `labdata.conditions.Conditions`, such as `exposure_s` and `photons_per_px`
    (default: by the header of a file).
    """


class FlatConditions(ConditionSettings[float | Sequence[float]], total=False):
    """Fields of `labdata.conditions.Conditions` of frames in memory: a number for all stacks (of
    light: for the flats), or a sequence with one number for each flat.
    """


class CameraSettings(TypedDict, total=False):
    """Settings of the camera as for `simulate.conditions_of`, such as `gain` and `gate_ns`."""

    gain: float
    mcp_v: float
    gain_control: float
    gate_ns: float
    illuminance_lux: float
    wavelength_nm: float
    camera_gain_db: float
    temperature_c: float
    automatic_gain: bool
    brightness_control: bool


def flat_conditions(record: Conditions) -> dict[str, Any]:
    """Return the conditions of a record, or conditions, by name."""
    return {item.name: getattr(record, item.name) for item in fields(Conditions)}


def conditions_of(record: Conditions) -> Conditions:
    """Return the conditions of a stack or step record."""
    return Conditions(**flat_conditions(record))


def own_keys(of: Any, record: type) -> dict[str, Any]:
    """Return the values of a record's keys other than its conditions."""
    return {name: getattr(of, name) for name in record.__annotations__}
