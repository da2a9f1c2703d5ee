"""Files that are whole or absent: written under another name, forced to the disk, then renamed into place."""

import os
import uuid
from pathlib import Path


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
