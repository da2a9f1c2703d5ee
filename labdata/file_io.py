"""Atomic writes, and requirements of files named by a user: regular, and of a size that fits into
memory.
"""

import ctypes
import os
import stat
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from labdata.errors import BadInput

_SYNC = threading.local()


def call_at_syncs(progress: Callable[[], object]) -> None:
    """Have this thread call a function after each sync of a disk."""
    _SYNC.progress = progress


def progress_of_syncs() -> Callable[[], object]:
    """Return what this thread calls after each sync."""
    return getattr(_SYNC, "progress", lambda: None)


def sync(descriptor: int, progress: Callable[[], object] | None = None) -> None:
    """Wait until a file is on the disk."""
    os.fsync(descriptor)
    (progress or progress_of_syncs())()


def write_atomically(path: str | Path, data: bytes | bytearray | memoryview) -> None:
    """Write a file in an existing folder; after a crash or power cut it has its old or its new
    content.
    """
    path = Path(path)
    partial = path.with_name(f".{path.name}.{uuid.uuid4().hex}.partial")
    try:
        with open(partial, "wb") as file:
            file.write(data)
            file.flush()
            sync(file.fileno())
        os.replace(partial, path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        # The caller knows the file, not its temporary name.
        raise OSError(error.errno, error.strerror, str(path)) from None
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Sync a folder, so that a rename in it survives a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        sync(descriptor)
    finally:
        os.close(descriptor)


def write_whole(descriptor: int, data: bytes | memoryview) -> None:
    """Write all bytes; a disk that accepts only part of them raises at the next attempt."""
    unwritten = memoryview(data)
    while len(unwritten):
        unwritten = unwritten[os.write(descriptor, unwritten) :]


def ends_mid_line(descriptor: int) -> bool:
    """Return whether the last line of an open file is incomplete; reads the last byte only."""
    size = os.fstat(descriptor).st_size
    return size > 0 and os.pread(descriptor, 1, size - 1) != b"\n"


_KINDS = {
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFDIR: "a folder",
}


def require_folder_of(path: str | Path) -> Path:
    """Return the path of a file to be written; a folder that does not exist is BadInput."""
    path = Path(path)
    if not (folder := path.absolute().parent).is_dir():
        raise BadInput(f"an output must lie in a folder that exists, got {path}: create {folder}")
    return path


def require_regular(path: str | Path, what: str = "a file") -> None:
    """Require a path to be a regular file, or a link to one, before it is opened; `what` names it
    in the message.
    """
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):  # ValueError: a name that no file system accepts
        raise BadInput(f"{what} must exist to be read, got {path}") from None
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "something else")
        raise BadInput(
            f"{what} must be a regular file, got {kind}, {path}: copy its content into a file first"
        )


def require_regular_parts(folder: Path, what: str) -> None:
    """Require a folder to contain only folders and regular files."""
    for part in folder.rglob("*"):
        if not part.is_dir():
            require_regular(part, f"a part of {what}")


# Processor time that the reader of a file may take, s, and for each megabyte of it: readers take a
# hundredth of that
READ_CPU_S, READ_CPU_S_PER_MB = 5.0, 1.0


class _OutOfTime(BaseException):
    """Raised in a reader that has used up its processor time."""


@contextmanager
def cpu_limit(path: Path) -> Iterator[None]:
    """End the block with BadInput once its thread has used the processor time that a file may take.

    Libraries of foreign formats loop for ever on some damaged files.
    """
    files = path.rglob("*") if path.is_dir() else [path]
    megabytes = 1e-6 * sum(file.stat().st_size for file in files)
    limit_s = READ_CPU_S + READ_CPU_S_PER_MB * megabytes
    thread, turn, ended = threading.get_ident(), threading.Lock(), threading.Event()
    clock = time.pthread_getcpuclockid(thread)
    until_s = time.clock_gettime(clock) + limit_s

    def watch() -> None:
        while not ended.wait(0.1):
            with turn:
                if time.clock_gettime(clock) > until_s and not ended.is_set():
                    ctypes.pythonapi.PyThreadState_SetAsyncExc(
                        ctypes.c_ulong(thread), ctypes.py_object(_OutOfTime)
                    )

    threading.Thread(target=watch, name="reader's limit", daemon=True).start()
    try:
        try:
            yield
        finally:
            with turn:
                ended.set()
            # What was raised just before arrives here: to take it back would leave the interpreter
            # looking for it at every step.
            for _ in range(1000):
                pass
    except _OutOfTime:
        ended.set()
        raise BadInput(
            f"a file must be read within {limit_s:.3g} s of processor time, got no end in {path}: "
            "it is damaged"
        ) from None


# A file of a megabyte may unpack to gigabytes, and a header of a few bytes may state any size.
MOST_EXPANSION = 5000  # Largest compression ratio: deflate reaches 1032, LZW about 2700
# Largest image, px: the largest camera sensors have 247 million pixels (Sony IMX811)
MOST_PICTURE_PX = 2**28
# Largest fraction of the memory for the frames of a file; a measurement makes a copy as real
# numbers
MOST_OF_MEMORY = 0.5


def require_picture(rows: int, cols: int, name: str) -> None:
    """Require an image to have no more pixels than a camera can have."""
    if rows * cols > MOST_PICTURE_PX:
        raise BadInput(
            f"a picture must have at most {MOST_PICTURE_PX} pixels, got {rows} rows x {cols} "
            f"columns = {rows * cols} in {name}: cut out the part that is to be measured"
        )


def require_memory(pixels: int, pixel_bytes: int, name: str) -> None:
    """Require pixels of all frames and colours, of `pixel_bytes` each, to fit into memory."""
    most_bytes = memory_bytes() * MOST_OF_MEMORY
    if pixels * pixel_bytes > most_bytes:
        raise BadInput(
            f"the frames of a file must take at most {most_bytes / 1e9:.3g} GB, "
            f"{MOST_OF_MEMORY:.0%} of this machine's memory, got {pixels} pixels of {pixel_bytes} "
            f"bytes in {name}: write fewer frames to a file, or save them as .npy, which is read "
            "part by part"
        )


def require_room(path: Path, *, pixels: int, pixel_bytes: int) -> None:
    """Require the pixels that a header states to fit into memory and to be possible for the size of
    the file.
    """
    require_memory(pixels, pixel_bytes, path.name)
    files = [path] if path.is_file() else path.rglob("*")
    if pixels * pixel_bytes > MOST_EXPANSION * sum(file.stat().st_size for file in files):
        raise BadInput(
            f"a picture must fit into its file, got {pixels * pixel_bytes} bytes of pixels stated "
            f"by {path.name}"
        )


def memory_bytes() -> int:
    """Return the memory of this machine, bytes."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def names_of_shipped(kind: str) -> tuple[str, ...]:
    """Names of the TOML files of a kind, "sensors" or "phosphors", that come with the package."""
    return tuple(sorted(file.stem for file in (Path(__file__).parent / kind).glob("*.toml")))


def path_of_shipped(
    kind: str, name_or_path: str | Path, relative_to: str | Path | None = None
) -> Path:
    """Return a shipped TOML file by its name, or any other by its path; one that is not there is
    BadInput.
    """
    if str(name_or_path) in names_of_shipped(kind):
        return Path(__file__).parent / kind / f"{name_or_path}.toml"
    path = Path(relative_to or ".") / Path(name_or_path).expanduser()
    if not os.path.isfile(path):  # Path.is_file raises on invalid names
        raise BadInput(
            f"a {kind[:-1]} must be one of {', '.join(names_of_shipped(kind))} or the path of a "
            f"TOML file, got {str(name_or_path)!r}"
        )
    return path
