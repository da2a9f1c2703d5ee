"""Cameras: those that Aravis finds on the network and on USB3, and the kernel's video devices."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

from charact.live.doctor.access import device_finding, is_member
from charact.live.doctor.finding import Finding

DEVICES, KERNEL = Path("/dev"), Path("/sys/class/video4linux")


def camera_findings() -> Iterator[Finding]:
    """Yield Aravis and its cameras, then the video devices."""
    yield from aravis_cameras()
    yield from video_devices(offered=_capture_formats())


def aravis_cameras() -> Iterator[Finding]:
    """Yield the cameras that answer Aravis, or why there can be none."""
    from drivers.cameras.aravis.connection import list_cameras
    from drivers.errors import BenchError

    try:
        found = list_cameras()
    except BenchError as error:
        yield Finding(area="aravis", says=str(error), fix="apt-get install libaravis-0.8-0 (Debian)")
        return
    for camera in found:
        yield Finding(area="aravis", says=f"{camera.identifier}: {camera.model}, {camera.serial}, at {camera.address}")
    if not found:
        yield Finding(
            area="aravis",
            says="the library is there; no GigE Vision or USB3 Vision camera answers",
            fix="plug one in and switch it on; its address must lie in the subnet of the port that it hangs on",
        )


def video_devices(
    devices: Path = DEVICES, kernel: Path = KERNEL, offered: Mapping[str, str] = MappingProxyType({})
) -> Iterator[Finding]:
    """Yield the kernel's video devices with their names.

    Parameters
    ----------
    devices, kernel
        Folders of the device files and of what the kernel says of them.
    offered
        What those that can capture offer, by device file.
    """
    paths = sorted(devices.glob("video[0-9]*"), key=lambda path: int(path.name.removeprefix("video")))
    for path in paths:
        told = offered.get(str(path), "captures nothing that can be read")
        yield device_finding("video", path, f"{_name(kernel / path.name / 'name')}, {told}")
    if not paths:
        yield Finding(area="video", says="no video device", fix="plug a capture card in, for analog video")
    if is_member("video") is False:
        yield Finding(
            area="video",
            says="this user is not in the group video",
            fix="sudo usermod -a -G video $USER, then log in again",
        )


def _capture_formats() -> dict[str, str]:
    """Return inputs and readable pixel formats of each device that can capture."""
    from drivers.cameras.v4l2.listing import list_devices

    told = {}
    for one in list_devices():
        formats = (
            ", ".join(dict.fromkeys(offer.name for offer in one.formats if offer.name)) or "no format that is read"
        )
        inputs = ", ".join(f"#{entry.number} {entry.name}" for entry in one.inputs)
        told[one.path] = f"inputs {inputs or 'none'}; {formats or 'no format that can be read'}"
    return told


def _name(path: Path) -> str:
    try:
        return path.read_text(errors="replace").strip() or "nameless"
    except OSError:
        return "nameless"
