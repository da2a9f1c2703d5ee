"""The network of GigE Vision cameras: room for packets that wait, and the size of one."""

from collections.abc import Iterator
from pathlib import Path

from charact.live.doctor.finding import Finding
from drivers.cameras.aravis.capture import SOCKET_BUFFER_BYTES

LIMITS, INTERFACES = Path("/proc/sys/net/core"), Path("/sys/class/net")
LEAST_PACKET_BYTES = 1500  # of plain Ethernet


def network_findings() -> Iterator[Finding]:
    """Yield the limit of the socket buffer, and the packet size of each interface that is up."""
    yield socket_buffer(LIMITS)
    yield from packet_sizes(INTERFACES)


def socket_buffer(limits: Path) -> Finding:
    """Return whether the kernel grants a receiver the buffer that a frame needs while nobody reads.

    Parameters
    ----------
    limits
        Folder of the kernel's limits.
    """
    try:
        granted = int((limits / "rmem_max").read_text())
    except (OSError, ValueError):
        return Finding(area="network", says="the kernel does not tell the limit of a socket's buffer")
    told = f"a socket may buffer {granted / 2**20:.3g} MiB of packets"
    if granted >= SOCKET_BUFFER_BYTES:
        return Finding(area="network", says=told)
    return Finding(
        area="network",
        says=f"{told}; a camera at full rate needs {SOCKET_BUFFER_BYTES / 2**20:.3g} MiB, or frames lose their tails",
        fix=f"sudo sysctl -w net.core.rmem_max={SOCKET_BUFFER_BYTES} (and keep it in /etc/sysctl.d/)",
    )


def packet_sizes(interfaces: Path) -> Iterator[Finding]:
    """Yield the packet size of each interface that is up, the loopback left out.

    Parameters
    ----------
    interfaces
        Folder of what the kernel says of its interfaces.
    """
    for interface in sorted(interfaces.glob("*")):
        if interface.name == "lo" or _read(interface / "operstate") != "up":
            continue
        bytes_ = int(_read(interface / "mtu") or 0)
        told = f"{interface.name}: packets of {bytes_} bytes"
        if bytes_ < LEAST_PACKET_BYTES:
            yield Finding(area="network", says=told, fix=f"sudo ip link set dev {interface.name} mtu 1500")
        else:
            more = "" if bytes_ >= 9000 else "; cameras of many megapixels want 9000 (jumbo frames)"
            yield Finding(area="network", says=told + more)


def _read(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""
