"""Controls of a video device: what it offers, and a value set and read back."""

from dataclasses import dataclass, field
from typing import Literal

from drivers.cameras.v4l2 import structures
from drivers.cameras.v4l2.device import MOST_LISTED, Device, is_gone
from drivers.errors import CameraError
from labdata.errors import BadInput

GAIN, AUTOMATIC_GAIN = 0x00980913, 0x00980912
EXPOSURE, EXPOSURE_MODE = 0x009A0902, 0x009A0901
EXPOSURE_UNIT_S = 1e-4
MANUAL_EXPOSURE = 1

Kind = Literal["integer", "boolean", "menu", "button", "integer menu", "bitmask"]
_KINDS: dict[int, Kind] = {1: "integer", 2: "boolean", 3: "menu", 4: "button", 8: "bitmask", 9: "integer menu"}
_MOST_CHOICES = 64


@dataclass(frozen=True, kw_only=True)
class Control:
    """One control.

    Parameters
    ----------
    identifier
        The kernel's number of it.
    name
        What the driver calls it.
    kind
        What its values mean.
    minimum, maximum, step, default
        Its values, in its own unit.
    is_read_only
        Whether it can only be read; one that is inactive cannot be set either, as long as another control rules it.
    choices
        Names of a menu's values.
    """

    identifier: int
    name: str
    kind: Kind
    minimum: int
    maximum: int
    step: int
    default: int
    is_read_only: bool
    choices: dict[int, str] = field(default_factory=dict)


def list_controls(device: Device) -> tuple[Control, ...]:
    """Return the controls that a device offers; those of kinds that hold more than a number are left out."""
    found: list[Control] = []
    last = 0
    for _ in range(MOST_LISTED):
        query = structures.ControlQuery(id=last | structures.NEXT_CONTROL)
        try:
            device.ask(structures.QUERY_CONTROL, query)
        except OSError as error:
            _raise_if_gone(error)
            return tuple(found)
        if query.id <= last:
            raise CameraError(f"controls must come in the order of their numbers, got {query.id:#x} after {last:#x}")
        last = query.id
        if query.type in _KINDS and not query.flags & structures.CONTROL_DISABLED:
            found.append(_control(device, query))
    raise CameraError(f"the list of controls must end, got {MOST_LISTED} entries")


def find_control(device: Device, identifier: int) -> Control | None:
    """Return one control by the kernel's number of it; None where the device has none."""
    query = structures.ControlQuery(id=identifier)
    try:
        device.ask(structures.QUERY_CONTROL, query)
    except OSError as error:
        _raise_if_gone(error)
        return None
    if query.id != identifier or query.type not in _KINDS or query.flags & structures.CONTROL_DISABLED:
        return None
    return _control(device, query)


def read_control(device: Device, control: Control) -> int:
    """Return a control's value."""
    value = structures.ControlValue(id=control.identifier)
    try:
        device.ask(structures.GET_CONTROL, value)
    except OSError as error:
        _raise_if_gone(error)
        raise CameraError(f"the control {control.name!r} must tell its value, got: {error.strerror}") from None
    return value.value


def write_control(device: Device, control: Control, value: int) -> int | None:
    """Set a control and return what it reads back; None for a button, which has no value.

    Raises
    ------
    BadInput
        If the value lies outside what the control offers, or it can only be read.
    CameraError
        If the device refuses, or reads back something else by more than the control's step.
    """
    if control.is_read_only:
        raise BadInput(f"the control {control.name!r} must be one that can be set, this one can only be read")
    if control.kind not in ("button", "bitmask") and not control.minimum <= value <= control.maximum:
        raise BadInput(f"{control.name!r} must lie in {control.minimum}..{control.maximum}, got {value}")
    try:
        device.ask(structures.SET_CONTROL, structures.ControlValue(id=control.identifier, value=value))
    except OSError as error:
        _raise_if_gone(error)
        raise CameraError(f"the control {control.name!r} must take {value}, got: {error.strerror}") from None
    if control.kind == "button":
        return None
    is_now = read_control(device, control)
    if abs(is_now - value) > max(0, control.step - 1):
        raise CameraError(f"the control {control.name!r} must take the value asked, {value}, but reads back {is_now}")
    return is_now


def _control(device: Device, query: structures.ControlQuery) -> Control:
    kind = _KINDS[query.type]
    is_menu = kind in ("menu", "integer menu")
    return Control(
        identifier=query.id,
        name=structures.words(query.name),
        kind=kind,
        minimum=query.minimum,
        maximum=query.maximum,
        step=query.step,
        default=query.default_value,
        is_read_only=bool(query.flags & (structures.CONTROL_READ_ONLY | structures.CONTROL_INACTIVE)),
        choices=_choices(device, query, numbers=kind == "integer menu") if is_menu else {},
    )


def _choices(device: Device, query: structures.ControlQuery, *, numbers: bool) -> dict[int, str]:
    """Return the names of a menu's values; values that the driver leaves out are not there."""
    choices = {}
    first = max(0, query.minimum)
    for index in range(first, min(query.maximum, first + _MOST_CHOICES) + 1):
        entry = structures.MenuQuery(id=query.id, index=index)
        try:
            device.ask(structures.QUERY_MENU, entry)
        except OSError as error:
            _raise_if_gone(error)
            continue
        raw = bytes(entry)[8:40]
        choices[index] = str(int.from_bytes(raw[:8], "little", signed=True)) if numbers else structures.words(raw)
    return choices


def _raise_if_gone(error: OSError) -> None:
    if is_gone(error):
        raise CameraError(f"the video device has gone ({error.strerror})") from None
