"""Files that a user names must be regular: a named pipe is waited for without end, and a device has no end."""

import os
import stat
from pathlib import Path

from labdata.errors import BadInput

_KINDS = {
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFDIR: "a folder",
}


def require_regular(path: str | Path, what: str = "a file") -> None:
    """Refuse a path that is no regular file, or no link to one, before it is opened.

    Parameters
    ----------
    path
        The file.
    what
        What it should be, for the sentence, such as "a file of frames".

    Raises
    ------
    BadInput
        If nothing is there, or something else than a regular file.
    """
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):  # ValueError of a name that no disk takes
        raise BadInput(f"{what} must exist to be read, got {path}") from None
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "something else")
        raise BadInput(f"{what} must be a regular file, got {kind}, {path}: copy its content into a file first")


def require_regular_parts(folder: Path, what: str) -> None:
    """Refuse a folder, such as that of an array, which holds something else than folders and regular files."""
    for part in folder.rglob("*"):
        if not part.is_dir():
            require_regular(part, f"a part of {what}")
