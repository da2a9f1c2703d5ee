"""Files that are whole or absent: written under another name, forced to the disk, then renamed into place."""

import os
import stat
import uuid
from pathlib import Path

from labdata.errors import BadInput


def write_atomically(path: str | Path, data: bytes | bytearray | memoryview) -> None:
    """Write a file so that a reader, a crash or a power cut finds the old bytes or the new ones, never a part.

    Parameters
    ----------
    path
        The file; its folder must exist.
    data
        All of its bytes.
    """
    path = Path(path)
    partial = path.with_name(f".{path.name}.{uuid.uuid4().hex}.partial")
    try:
        with open(partial, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        # Who asked for the file knows its name, not the other one.
        raise OSError(error.errno, error.strerror, str(path)) from None
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Force a folder's list of names to the disk, so that a rename in it survives a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_whole(descriptor: int, data: bytes | memoryview) -> None:
    """Write bytes whole; a disk that takes only a part of them says why at the next try."""
    left = memoryview(data)
    while len(left):
        left = left[os.write(descriptor, left) :]


def ends_mid_line(descriptor: int) -> bool:
    """Return whether an open file of lines ends inside one, cut short by a crash; reads its last byte only."""
    size = os.fstat(descriptor).st_size
    return size > 0 and os.pread(descriptor, 1, size - 1) != b"\n"


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
