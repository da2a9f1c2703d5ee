"""Serial ports, on which gate generator, high-voltage supply and light hang."""

from collections.abc import Iterable, Iterator
from pathlib import Path

from charact.live.doctor.access import device_finding, is_member
from charact.live.doctor.finding import Finding


def port_findings() -> Iterator[Finding]:
    """Yield the serial ports of this machine and whether this user may open them."""
    from serial.tools.list_ports import comports

    yield from serial_ports((Path(port.device), port.description or "nameless") for port in comports())


def serial_ports(ports: Iterable[tuple[Path, str]]) -> Iterator[Finding]:
    """Yield what is to be said of ports given with what they are.

    Parameters
    ----------
    ports
        Device file and description of each.
    """
    found = sorted(ports)
    for path, title in found:
        yield device_finding("serial", path, "serial port" if title == "n/a" else title)
    if not found:
        yield Finding(area="serial", says="no serial port", fix="plug an adapter in, if instruments are to be driven")
    if is_member("dialout") is False:
        yield Finding(
            area="serial",
            says="this user is not in the group dialout",
            fix="sudo usermod -a -G dialout $USER, then log in again",
        )
