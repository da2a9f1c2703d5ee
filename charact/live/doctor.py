"""Checks of this machine: versions, disk, cameras, ports, permissions and network, each with its
fix.
"""

import grp
import os
import re
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType

import numpy as np

from drivers.cameras.aravis.capture import SOCKET_BUFFER_BYTES
from labdata import BadInput, Conditions, Frame, SessionWriter


@dataclass(frozen=True)
class Finding:
    """Result of one check: subject, sentence, remedy (None if ok), and whether measuring needs
    it.
    """

    area: str
    says: str
    fix: str | None = None
    core: bool = False

    @property
    def ok(self) -> bool:
        """Whether there is nothing to fix."""
        return self.fix is None


# Name, least version and extra, as in: starlette>=0.46; extra == "live"
_REQUIREMENT = re.compile(
    r"^([\w.-]+)\s*(?:>=\s*([0-9.]+))?.*?(?:;.*extra\s*==\s*['\"]([\w-]+)['\"])?$"
)


def software_findings() -> Iterator[Finding]:
    """Yield findings on Python, the required packages, and each extra."""
    yield python_finding(sys.version_info[:3])
    try:
        requires = metadata.requires("charact") or []
    except metadata.PackageNotFoundError:
        yield Finding(
            "packages",
            "charact is not installed, its requirements are unknown",
            fix="pip install charact",
        )
        return
    yield from package_findings(requires, _version_of)


def python_finding(version: tuple[int, ...]) -> Finding:
    """Return whether the Python version is sufficient."""
    text = ".".join(str(part) for part in version)
    fix = None if version >= (3, 11) else "install Python 3.11 or later"
    return Finding("python", f"Python {text}", fix=fix, core=True)


def package_findings(
    requires: Iterable[str], installed: Callable[[str], str | None]
) -> Iterator[Finding]:
    """Yield one finding for the required packages and one for each extra; `installed` returns a
    version or None.
    """
    wanting: dict[str | None, list[str]] = {}
    for requirement in requires:
        if (parsed := _REQUIREMENT.match(requirement.strip())) is None:
            continue
        name, minimum_version, extra = parsed.groups()
        wanting.setdefault(extra, [])
        if lack := _lack(name, minimum_version, installed(name)):
            wanting[extra].append(lack)
    for extra, lacks in sorted(wanting.items(), key=lambda pair: pair[0] or ""):
        of, suffix = ("packages", "") if extra is None else (f"extra {extra}", f"[{extra}]")
        yield Finding(
            of,
            ", ".join(lacks) or "all installed",
            fix=f"pip install --upgrade 'charact{suffix}'" if lacks else None,
            core=extra is None,
        )


def _lack(name: str, minimum_version: str | None, version: str | None) -> str | None:
    """Return what is wrong with a package; release numbers are compared, so that 1.10 is later than
    1.9.
    """

    def numbers(text: str) -> tuple[int, ...]:
        parts = re.match(r"[0-9]+(?:\.[0-9]+)*", text)
        return tuple(int(part) for part in parts.group().split(".")) if parts else ()

    if version is None:
        return f"{name} is not installed"
    if minimum_version is not None and numbers(version) < numbers(minimum_version):
        return f"{name} must be {minimum_version} or later, got {version}"
    return None


def _version_of(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


SHAPE, DTYPE = (493, 768), np.uint16
VIDEO_HZ = 30.0
TRIED_FRAMES, TOGETHER = 32, 8


def disk_findings(folder: Path) -> Iterator[Finding]:
    """Yield the write rate of the disk, measured as in an acquisition, and its free space."""
    try:
        rate_hz = write_rate_hz(folder)
    except (OSError, BadInput) as error:
        why = error.strerror if isinstance(error, OSError) else error
        yield Finding(
            "disk", f"{folder} is not writable: {why}", fix="choose another folder", core=True
        )
        return
    yield speed_finding(folder, rate_hz)
    yield room_finding(folder, shutil.disk_usage(folder).free)


def write_rate_hz(folder: Path) -> float:
    """Return the rate of frames written and synchronised to disk in groups, Hz."""
    frame = np.random.default_rng(0).integers(0, 4096, SHAPE).astype(DTYPE)
    with TemporaryDirectory(dir=folder, prefix=".charact-doctor-") as made:
        session = Path(made) / "session"
        with (
            SessionWriter.create(session, name="doctor") as writer,
            writer.begin_stack("flat", "flat", SHAPE, DTYPE, Conditions()) as stack,
        ):
            stack.append(frame, 0.0, 0)
            began = time.perf_counter()
            for first in range(1, TRIED_FRAMES, TOGETHER):
                numbers = range(first, first + TOGETHER)
                stack.extend(
                    [Frame(pixels=frame, number=number, time_s=float(number)) for number in numbers]
                )
            return TRIED_FRAMES / (time.perf_counter() - began)


def speed_finding(folder: Path, rate_hz: float) -> Finding:
    """Return whether a write rate is sufficient for video, Hz."""
    rate = (
        f"{folder}: {rate_hz:.1f} frames/s of {SHAPE[1]} x {SHAPE[0]} px, 16 bit, synchronised "
        f"to disk"
    )
    if rate_hz >= 2.0 * VIDEO_HZ:
        return Finding("disk", rate)
    return Finding(
        "disk",
        f"{rate}; video needs {VIDEO_HZ:g}, and a margin of as many",
        fix="choose a faster disk",
    )


def room_finding(folder: Path, free_bytes: int) -> Finding:
    """Return whether the free space is sufficient."""
    minutes = free_bytes / (np.prod(SHAPE) * np.dtype(DTYPE).itemsize * VIDEO_HZ) / 60.0
    space = f"{folder}: {free_bytes / 1e9:.3g} GB free, {minutes:.0f} minutes of video"
    fix = None if minutes >= 10.0 else "free disk space, or choose another disk"
    return Finding("disk", space, fix=fix)


def device_finding(area: str, path: Path, title: str) -> Finding:
    """Return whether this user may open a device file."""
    if os.access(path, os.R_OK | os.W_OK):
        return Finding(area, f"{path}: {title}")
    group = group_of(path)
    return Finding(
        area,
        f"{path}: {title}; this user may not open it",
        fix=f"sudo usermod -a -G {group} $USER, then log in again"
        if group
        else f"change the permissions of {path}",
    )


def group_of(path: Path) -> str | None:
    """Return the group of a file; None for root's."""
    try:
        group = path.stat().st_gid
        return None if group == 0 else grp.getgrgid(group).gr_name
    except (OSError, KeyError):
        return None


def group_findings(area: str, group: str) -> Iterator[Finding]:
    """Yield a finding if this user is neither root nor in an existing group."""
    try:
        number = grp.getgrnam(group).gr_gid
    except KeyError:
        return
    if os.geteuid() != 0 and number not in {os.getegid(), *os.getgroups()}:
        fix = f"sudo usermod -a -G {group} $USER, then log in again"
        yield Finding(area, f"this user is not in the group {group}", fix=fix)


def camera_findings() -> Iterator[Finding]:
    """Yield the cameras of Aravis, then the V4L2 devices."""
    yield from aravis_cameras()
    yield from video_devices(offered=_capture_formats())


def aravis_cameras() -> Iterator[Finding]:
    """Yield the cameras that Aravis lists, or a finding on the library."""
    from drivers.cameras.aravis.connection import list_cameras
    from drivers.errors import BenchError

    try:
        cameras = list_cameras()
    except BenchError as error:
        yield Finding("aravis", str(error), fix="apt-get install libaravis-0.8-0 (Debian)")
        return
    for camera in cameras:
        yield Finding(
            "aravis", f"{camera.identifier}: {camera.model}, {camera.serial}, at {camera.address}"
        )
    if not cameras:
        yield Finding(
            "aravis",
            "the library is installed; no GigE Vision or USB3 Vision camera answers",
            fix=(
                "connect a camera and switch it on; its address must be in the subnet of its "
                "network port"
            ),
        )


def video_devices(
    devices: Path = Path("/dev"),
    kernel: Path = Path("/sys/class/video4linux"),
    offered: Mapping[str, str] = MappingProxyType({}),
) -> Iterator[Finding]:
    """Yield the V4L2 devices with their names and, by device file, what they offer; folders for
    tests.
    """
    paths = sorted(
        devices.glob("video[0-9]*"), key=lambda path: int(path.name.removeprefix("video"))
    )
    for path in paths:
        formats = offered.get(str(path), "no readable capture format")
        yield device_finding(
            "video", path, f"{_read(kernel / path.name / 'name') or 'nameless'}, {formats}"
        )
    if not paths:
        yield Finding("video", "no video device", fix="connect a capture card, for analog video")
    yield from group_findings("video", "video")


def _capture_formats() -> dict[str, str]:
    """Return inputs and readable pixel formats of each device that can capture."""
    from drivers.cameras.v4l2.listing import list_devices

    offers = {}
    for device in list_devices():
        formats = (
            ", ".join(dict.fromkeys(offer.name for offer in device.formats if offer.name))
            or "no readable format"
        )
        inputs = ", ".join(f"#{entry.number} {entry.name}" for entry in device.inputs)
        offers[device.path] = f"inputs {inputs or 'none'}; {formats}"
    return offers


def port_findings() -> Iterator[Finding]:
    """Yield the serial ports and whether this user may open them."""
    from serial.tools.list_ports import comports

    yield from serial_ports(
        (Path(port.device), port.description or "nameless") for port in comports()
    )


def serial_ports(ports: Iterable[tuple[Path, str]]) -> Iterator[Finding]:
    """Yield whether this user may open ports, given as (device file, description)."""
    sorted_ports = sorted(ports)
    for path, title in sorted_ports:
        yield device_finding("serial", path, "serial port" if title == "n/a" else title)
    if not sorted_ports:
        yield Finding("serial", "no serial port", fix="connect an adapter, for instruments")
    yield from group_findings("serial", "dialout")


def network_findings() -> Iterator[Finding]:
    """Yield the limit of the socket buffer, and the packet size of each active interface."""
    yield socket_buffer(Path("/proc/sys/net/core"))
    yield from packet_sizes(Path("/sys/class/net"))


def socket_buffer(limits: Path) -> Finding:
    """Return whether the socket buffer of the kernel is sufficient for a frame; `limits`: folder of
    its limits.
    """
    try:
        granted = int((limits / "rmem_max").read_text())
    except (OSError, ValueError):
        return Finding("network", "the kernel does not state the limit of the socket buffer")
    size = f"socket buffer of at most {granted / 2**20:.3g} MiB"
    if granted >= SOCKET_BUFFER_BYTES:
        return Finding("network", size)
    return Finding(
        "network",
        (
            f"{size}; a camera at full rate needs {SOCKET_BUFFER_BYTES / 2**20:.3g} MiB, or "
            "packets are lost"
        ),
        fix=(
            f"sudo sysctl -w net.core.rmem_max={SOCKET_BUFFER_BYTES} (and keep it in "
            f"/etc/sysctl.d/)"
        ),
    )


def packet_sizes(interfaces: Path) -> Iterator[Finding]:
    """Yield the packet size of each active interface but the loopback; `interfaces`: folder of
    their attributes.
    """
    for interface in sorted(interfaces.glob("*")):
        if interface.name == "lo" or _read(interface / "operstate") != "up":
            continue
        bytes_ = int(_read(interface / "mtu") or 0)
        size = f"{interface.name}: packets of {bytes_} bytes"
        if bytes_ < 1500:  # plain Ethernet
            yield Finding("network", size, fix=f"sudo ip link set dev {interface.name} mtu 1500")
        else:
            more = (
                "" if bytes_ >= 9000 else "; use 9000 (jumbo frames) for cameras of many megapixels"
            )
            yield Finding("network", size + more)


def _read(path: Path) -> str:
    try:
        return path.read_text(errors="replace").strip()
    except OSError:
        return ""


def examine(folder: Path) -> Iterator[Finding]:
    """Yield the findings one by one; test frames are written to `folder` and removed, no instrument
    is contacted.
    """
    yield from software_findings()
    yield from disk_findings(folder)
    yield from camera_findings()
    yield from port_findings()
    yield from network_findings()
