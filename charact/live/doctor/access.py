"""Whether this user may use a device file, and the group that would let them."""

import grp
import os
from pathlib import Path

from charact.live.doctor.finding import Finding


def device_finding(area: str, path: Path, title: str) -> Finding:
    """Return what is to be said of a device file.

    Parameters
    ----------
    area
        What it belongs to.
    path
        The file.
    title
        What it is.
    """
    if os.access(path, os.R_OK | os.W_OK):
        return Finding(area=area, says=f"{path}: {title}")
    group = group_of(path)
    return Finding(
        area=area,
        says=f"{path}: {title}, and this user may not open it",
        fix=f"sudo usermod -a -G {group} $USER, then log in again" if group else f"ask who owns {path}",
    )


def group_of(path: Path) -> str | None:
    """Return the group that may open a file; None where there is none but root's."""
    try:
        group = path.stat().st_gid
        return None if group == 0 else grp.getgrgid(group).gr_name
    except (OSError, KeyError):
        return None


def is_member(group: str) -> bool | None:
    """Whether this user is in a group, or is root; None where there is no such group."""
    try:
        known = grp.getgrnam(group)
    except KeyError:
        return None
    return os.geteuid() == 0 or known.gr_gid in {os.getegid(), *os.getgroups()}
