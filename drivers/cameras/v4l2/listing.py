"""Video devices of the machine, with their inputs, pixel formats, sizes and controls."""

import glob
from dataclasses import dataclass
from typing import Any, Literal

from drivers.cameras.v4l2 import structures
from drivers.cameras.v4l2.device import MOST_LISTED, Device, list_structures, offers, query_device
from drivers.cameras.v4l2.pixels import LAYOUTS
from drivers.cameras.v4l2.structures import CAPTURE, four_letters, words
from drivers.errors import CameraError
from labdata.errors import BadInput

GAIN, AUTOMATIC_GAIN = 0x00980913, 0x00980912
EXPOSURE, EXPOSURE_MODE = 0x009A0902, 0x009A0901
EXPOSURE_UNIT_S = 1e-4
MANUAL_EXPOSURE = 1

Kind = Literal["integer", "boolean", "menu", "button", "integer menu", "bitmask"]
_KINDS: dict[int, Kind] = {
    1: "integer",
    2: "boolean",
    3: "menu",
    4: "button",
    8: "bitmask",
    9: "integer menu",
}


@dataclass(frozen=True, kw_only=True)
class Control:
    """One control."""

    identifier: int  #: The kernel's number
    name: str  #: Name given by the driver
    kind: Kind  #: Kind of its values
    minimum: int  #: Range of its values, in its own unit
    maximum: int  #: Range of its values, in its own unit
    step: int  #: Range of its values, in its own unit
    default: int  #: Range of its values, in its own unit
    is_read_only: bool  #: Whether it cannot be set, also while inactive because of another control


def list_controls(device: Device) -> tuple[Control, ...]:
    """Return the controls of a device; kinds with more than a number are omitted."""
    controls: list[Control] = []
    last = 0
    for _ in range(MOST_LISTED):
        query = structures.ControlQuery(id=last | structures.NEXT_CONTROL)
        if not offers(device, structures.QUERY_CONTROL, query):
            return tuple(controls)
        if query.id <= last:
            raise CameraError(
                f"controls must come in the order of their numbers, got {query.id:#x} after "
                f"{last:#x}"
            )
        last = query.id
        if query.type in _KINDS and not query.flags & structures.CONTROL_DISABLED:
            controls.append(_control(device, query))
    raise CameraError(f"the list of controls must end, got {MOST_LISTED} entries")


def find_control(device: Device, identifier: int) -> Control | None:
    """Return one control by the kernel's number; None where the device does not have it."""
    query = structures.ControlQuery(id=identifier)
    if (
        not offers(device, structures.QUERY_CONTROL, query)
        or query.id != identifier
        or query.type not in _KINDS
    ):
        return None
    return None if query.flags & structures.CONTROL_DISABLED else _control(device, query)


def read_control(device: Device, control: Control) -> int:
    """Return a control's value."""
    value = structures.ControlValue(id=control.identifier)
    query_device(
        device, structures.GET_CONTROL, value, f"the control {control.name!r} must report its value"
    )
    return value.value


def write_control(device: Device, control: Control, value: int) -> int | None:
    """Set a control and return its read-back; None for a button, which has no value.

    A value outside its range, or a read-only control, is BadInput; a read-back off by more than a
    step CameraError.
    """
    if control.is_read_only:
        raise BadInput(
            f"the control {control.name!r} must be one that can be set, this one can only be read"
        )
    if (
        control.kind not in ("button", "bitmask")
        and not control.minimum <= value <= control.maximum
    ):
        raise BadInput(
            f"{control.name!r} must lie in {control.minimum}..{control.maximum}, got {value}"
        )
    setting = structures.ControlValue(id=control.identifier, value=value)
    query_device(
        device, structures.SET_CONTROL, setting, f"the control {control.name!r} must take {value}"
    )
    if control.kind == "button":
        return None
    is_now = read_control(device, control)
    if abs(is_now - value) > max(0, control.step - 1):
        raise CameraError(
            f"the control {control.name!r} must accept the requested value, {value}, but reads "
            f"back {is_now}"
        )
    return is_now


def _control(device: Device, query: Any) -> Control:
    kind = _KINDS[query.type]
    return Control(
        identifier=query.id,
        name=words(query.name),
        kind=kind,
        minimum=query.minimum,
        maximum=query.maximum,
        step=query.step,
        default=query.default_value,
        is_read_only=bool(
            query.flags & (structures.CONTROL_READ_ONLY | structures.CONTROL_INACTIVE)
        ),
    )


@dataclass(frozen=True, kw_only=True)
class OfferedFormat:
    """A pixel format of a device."""

    letters: str  #: FourCC of the format
    #: Name as a camera setting; None for an unsupported format, such as a compressed one
    name: str | None
    sizes: tuple[
        tuple[int, int], ...
    ]  #: Rows and columns of the images; empty where any size within bounds is offered


@dataclass(frozen=True, kw_only=True)
class OfferedInput:
    """An input of a capture card: its number and its name."""

    number: int
    name: str


@dataclass(frozen=True, kw_only=True)
class VideoDevice:
    """A device that can capture."""

    path: str  #: Device file, such as "/dev/video0"
    card: str  #: Name of the card, kernel driver and bus position
    driver: str  #: Name of the card, kernel driver and bus position
    bus: str  #: Name of the card, kernel driver and bus position
    inputs: tuple[OfferedInput, ...]  #: Inputs and pixel formats
    formats: tuple[OfferedFormat, ...]  #: Inputs and pixel formats


def list_devices() -> tuple[VideoDevice, ...]:
    """Return the devices of this machine that can be opened and can capture."""
    devices = []
    for path in sorted(glob.glob("/dev/video*")):
        try:
            device = Device(path)
        except CameraError:
            continue
        try:
            devices.append(describe(device, path))
        except CameraError:
            continue
        finally:
            device.close()
    return tuple(devices)


def describe(device: Device, path: str) -> VideoDevice:
    """Return the description of an open device; one that cannot capture is a `CameraError`."""
    capability = capture_capability(device, path)
    return VideoDevice(
        path=path,
        card=words(capability.card),
        driver=words(capability.driver),
        bus=words(capability.bus_info),
        inputs=tuple(
            OfferedInput(number=offered.index, name=words(offered.name))
            for offered in list_structures(device, structures.LIST_INPUTS)
        ),
        formats=list_formats(device),
    )


def capture_capability(device: Device, path: str) -> Any:
    """Return the capabilities of a device that captures video into mapped memory."""
    capability = structures.Capability()
    try:
        device.ask(structures.CAPABILITIES, capability)
    except OSError as error:
        raise CameraError(f"{path} must be a video device, got: {error.strerror}") from None
    has_device_caps = capability.capabilities & structures.HAS_OWN_CAPABILITIES
    able = capability.device_caps if has_device_caps else capability.capabilities
    if not (able & structures.CAN_CAPTURE and able & structures.CAN_STREAM):
        raise CameraError(
            f"{path} must capture video into mapped memory, {words(capability.card)!r} does not"
        )
    return capability


def list_formats(device: Device) -> tuple[OfferedFormat, ...]:
    """Return the pixel formats of a device's present input."""
    return tuple(
        OfferedFormat(
            letters=four_letters(offered.pixelformat),
            name=LAYOUTS[offered.pixelformat].name if offered.pixelformat in LAYOUTS else None,
            sizes=list_sizes(device, offered.pixelformat),
        )
        for offered in list_structures(device, structures.LIST_FORMATS, type=CAPTURE)
    )


def format_codes(device: Device) -> tuple[int, ...]:
    """Return the kernel's numbers of the pixel formats of a device's present input."""
    return tuple(
        offered.pixelformat
        for offered in list_structures(device, structures.LIST_FORMATS, type=CAPTURE)
    )


def list_sizes(device: Device, code: int) -> tuple[tuple[int, int], ...]:
    """Return rows and columns of the image sizes of a format; empty where any size within bounds is
    offered.
    """
    sizes = []
    for offered in list_structures(device, structures.LIST_SIZES, pixel_format=code):
        if offered.type != 1:  # discrete
            return ()
        sizes.append((offered.sizes[1], offered.sizes[0]))
    return tuple(sizes)
