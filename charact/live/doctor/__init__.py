"""The doctor: what a bench needs of this machine, each thing ok or with the fix."""

from collections.abc import Iterator
from pathlib import Path

from charact.live.doctor import cameras, disk, network, ports, software
from charact.live.doctor.finding import Finding

__all__ = ["Finding", "can_work", "examine"]


def examine(folder: Path) -> Iterator[Finding]:
    """Yield what was found, one thing after the other; nothing is set, no instrument is spoken to.

    Parameters
    ----------
    folder
        Where sessions are to be written; a few frames are written there and removed.
    """
    yield from software.software_findings()
    yield from disk.disk_findings(folder)
    yield from cameras.camera_findings()
    yield from ports.port_findings()
    yield from network.network_findings()


def can_work(found: tuple[Finding, ...]) -> bool:
    """Whether nothing is amiss without which not even measuring works."""
    return all(one.ok for one in found if one.core)
