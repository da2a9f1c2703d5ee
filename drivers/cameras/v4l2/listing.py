"""Which video devices there are, and what each offers: inputs, pixel formats and picture sizes."""

import glob
from dataclasses import dataclass

from drivers.cameras.v4l2 import structures
from drivers.cameras.v4l2.controls import Control, list_controls
from drivers.cameras.v4l2.device import Device, KernelDevice, listed
from drivers.cameras.v4l2.pixels import LAYOUTS
from drivers.cameras.v4l2.structures import CAPTURE, four_letters, words
from drivers.errors import CameraError

_DISCRETE = 1


@dataclass(frozen=True, kw_only=True)
class OfferedFormat:
    """A pixel format of a device.

    Parameters
    ----------
    code
        The kernel's number of it.
    letters
        Its four letters.
    name
        Its name as a camera's setting; None for one that cannot be read, such as a compressed one.
    sizes
        Rows and columns of the pictures that it comes in; empty where every size within bounds is offered.
    """

    code: int
    letters: str
    name: str | None
    sizes: tuple[tuple[int, int], ...]


@dataclass(frozen=True, kw_only=True)
class OfferedInput:
    """An input of a capture card: its number, its name, and the video standards that it takes, as the kernel's bits."""

    number: int
    name: str
    standards: int


@dataclass(frozen=True, kw_only=True)
class VideoDevice:
    """A device that can capture.

    Parameters
    ----------
    path
        Its file, such as "/dev/video0".
    card, driver, bus
        What it is, which driver of the kernel serves it, and where it is plugged in.
    inputs, formats, controls
        What it offers.
    """

    path: str
    card: str
    driver: str
    bus: str
    inputs: tuple[OfferedInput, ...]
    formats: tuple[OfferedFormat, ...]
    controls: tuple[Control, ...]


def list_devices() -> tuple[VideoDevice, ...]:
    """Return the devices of this machine that can capture; others, and those that may not be opened, are left out."""
    found = []
    for path in sorted(glob.glob("/dev/video*")):
        try:
            device = KernelDevice(path)
        except CameraError:
            continue
        try:
            found.append(describe(device, path))
        except CameraError:
            continue
        finally:
            device.close()
    return tuple(found)


def describe(device: Device, path: str) -> VideoDevice:
    """Return what an open device is and offers; one that cannot capture is a `CameraError`."""
    capability = capture_capability(device, path)
    return VideoDevice(
        path=path,
        card=words(capability.card),
        driver=words(capability.driver),
        bus=words(capability.bus_info),
        inputs=tuple(
            OfferedInput(number=one.index, name=words(one.name), standards=one.std)
            for one in listed(device, structures.LIST_INPUTS)
        ),
        formats=list_formats(device),
        controls=list_controls(device),
    )


def capture_capability(device: Device, path: str) -> structures.Capability:
    """Return what a device says of itself, if it captures video into mapped memory."""
    capability = structures.Capability()
    try:
        device.ask(structures.CAPABILITIES, capability)
    except OSError as error:
        raise CameraError(f"{path} must be a video device, got: {error.strerror}") from None
    own = capability.capabilities & structures.HAS_OWN_CAPABILITIES
    able = capability.device_caps if own else capability.capabilities
    if not (able & structures.CAN_CAPTURE and able & structures.CAN_STREAM):
        raise CameraError(f"{path} must capture video into mapped memory, {words(capability.card)!r} does not")
    return capability


def list_formats(device: Device) -> tuple[OfferedFormat, ...]:
    """Return the pixel formats that a device offers on its present input."""
    return tuple(
        OfferedFormat(
            code=one.pixelformat,
            letters=four_letters(one.pixelformat),
            name=LAYOUTS[one.pixelformat].name if one.pixelformat in LAYOUTS else None,
            sizes=list_sizes(device, one.pixelformat),
        )
        for one in listed(device, structures.LIST_FORMATS, type=CAPTURE)
    )


def format_codes(device: Device) -> tuple[int, ...]:
    """Return the kernel's numbers of the pixel formats that a device offers on its present input."""
    return tuple(one.pixelformat for one in listed(device, structures.LIST_FORMATS, type=CAPTURE))


def list_sizes(device: Device, code: int) -> tuple[tuple[int, int], ...]:
    """Return rows and columns of the pictures that a format comes in; none where every size within bounds does."""
    sizes = []
    for one in listed(device, structures.LIST_SIZES, pixel_format=code):
        if one.type != _DISCRETE:
            return ()
        sizes.append((one.sizes[1], one.sizes[0]))
    return tuple(sizes)
