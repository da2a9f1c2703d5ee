"""Append frames to an array; each is on the disk and acknowledged before `append` returns."""

import os
import shutil
from collections.abc import Sequence
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdata.background import BackgroundWriter
from labdata.capture import Frame
from labdata.errors import BadInput
from labdata.file_io import (
    ends_mid_line,
    progress_of_syncs,
    sync,
    sync_folder,
    write_atomically,
    write_whole,
)
from labdata.store.journal import (
    JOURNAL,
    METADATA,
    NUMBERS,
    Acknowledged,
    chunk,
    frame_bytes,
    is_ours,
    metadata,
    read_journal,
    read_metadata,
    sha256,
)

FORCED_AT_ONCE = 8  # Chunks synced in parallel: the disk serves them in about the time of one


class ArrayWriter:
    """One array of the store, open for appending; an existing one is continued, with the same shape
    and type.

    Frames acknowledged by an earlier writer are never changed: after an incomplete last line the
    journal continues in the next, and chunks counted by the array but not by its journal are set
    aside before their places are used.
    """

    def __init__(self, path: Path, shape: tuple[int, int], dtype: Any) -> None:
        self.path = path
        self._shape = (int(shape[0]), int(shape[1]))
        self._dtype = np.dtype(dtype).newbyteorder("<")
        if not is_ours(path):
            self._create()
        for left_over in path.glob(f".{METADATA}.*.partial"):
            left_over.unlink()
        self._require_same()
        journal = read_journal(path)
        self._frames, self._end = len(journal.frames), journal.end
        # One sentence on chunks that were set aside at the start
        self.notes = self._set_aside(journal.array_frames)
        self._journal = open(path / JOURNAL, "ab+", buffering=0)  # noqa: SIM115 - open as long as the writer
        self._journal_bytes = self._journal.seek(0, os.SEEK_END)
        self._mid_line = ends_mid_line(self._journal.fileno())
        # All lines, to write them again if somebody removes or cuts the journal
        self._lines = bytearray((path / JOURNAL).read_bytes())
        # Daemon threads, so that a stuck disk does not keep the process from ending.
        force = partial(sync, progress=progress_of_syncs())
        self._disk = [BackgroundWriter(force, name="disk") for _ in range(FORCED_AT_ONCE)]

    def __len__(self) -> int:
        """Number of acknowledged frames that can be read."""
        return self._frames

    def append(self, frame: NDArray, time_s: float, frame_number: int) -> Acknowledged:
        """Write one frame; when this returns it survives a kill or a power cut."""
        return self.extend([Frame(pixels=np.asarray(frame), number=frame_number, time_s=time_s)])[0]

    def extend(self, frames: Sequence[Frame]) -> tuple[Acknowledged, ...]:
        """Write several frames with one sync of the disk; as safe as one after the other.

        Notes
        -----
        Safe by order: the chunks are synced to the disk, then the array grows over them, then the
        journal acknowledges them. A chunk torn by a crash lies after the end of the array and is
        overwritten.
        """
        for frame in frames:
            self._require_fit(frame)
        try:
            entries = self._write(frames)
            self._describe(self._end + len(frames))
            self._acknowledge(entries)
        except OSError as error:
            raise BadInput(
                f"the disk must take every frame, got {error.strerror!r} after {self._frames} "
                f"frames of {self.path}"
            ) from None
        self._frames += len(frames)
        self._end += len(frames)
        return entries

    def require_journal(self) -> None:
        """Require the journal to be where it was with every line; one that was removed or cut is
        written again from memory, and is BadInput.
        """
        path, status = self.path / JOURNAL, os.fstat(self._journal.fileno())
        try:
            is_there = os.stat(path).st_ino == status.st_ino
        except FileNotFoundError:
            is_there = False
        if is_there and status.st_size >= self._journal_bytes:
            return
        write_atomically(path, self._lines)
        raise BadInput(
            f"the journal of frames must stay as it is during a run, got {path} "
            f"{'cut' if is_there else 'removed'} after {self._frames} frames; its lines were "
            "written again: find who touches the folder, then resume"
        )

    def close(self) -> None:
        """Close the journal; acknowledged frames are safe without it."""
        for disk in self._disk:
            disk.close(None)
        self._journal.close()

    def _require_fit(self, frame: Frame) -> None:
        pixels = frame.pixels
        if pixels.shape != self._shape or pixels.dtype != self._dtype:
            raise BadInput(
                f"a frame of {self.path.name} must be {self._shape} {self._dtype}, got "
                f"{pixels.shape} {pixels.dtype}"
            )
        if int(frame.number) not in NUMBERS:
            raise BadInput(
                f"a frame's number must fit into 64 bits, got {frame.number} in {self.path.name}"
            )

    def _write(self, frames: Sequence[Frame]) -> tuple[Acknowledged, ...]:
        """Write and sync the chunks; digests are computed meanwhile."""
        files: list[int] = []
        try:
            for offset, frame in enumerate(frames):
                files.append(
                    os.open(
                        chunk(self.path, self._end + offset), os.O_WRONLY | os.O_CREAT | os.O_TRUNC
                    )
                )
                write_whole(files[-1], frame_bytes(frame.pixels))
                _start_writing_out(files[-1])
            for offset, file in enumerate(files):
                self._disk[offset % FORCED_AT_ONCE].enqueue(file)
            entries = tuple(
                _entry(self._end + offset, frame) for offset, frame in enumerate(frames)
            )
        finally:
            for disk in self._disk:  # no file is closed while a thread syncs it
                disk.flush(None)
            for file in files:
                os.close(file)
        self._raise_failure()
        return entries

    def _raise_failure(self) -> None:
        """Raise the error of a thread that synced chunks."""
        failures = [disk.failure for disk in self._disk if disk.failure is not None]
        for disk in self._disk:
            disk.failure = None
        if failures:
            raise failures[0]

    def _describe(self, frames: int) -> None:
        # Also syncs the folder, the names of the chunks included.
        write_atomically(self.path / METADATA, metadata(frames, self._shape, self._dtype))

    def _acknowledge(self, entries: Sequence[Acknowledged]) -> None:
        self.require_journal()
        journal = self._journal.fileno()
        if os.fstat(journal).st_size > self._journal_bytes:
            # Incomplete lines of this writer: their frames were never acknowledged.
            os.ftruncate(journal, self._journal_bytes)
        lines = (b"\n" if self._mid_line else b"") + b"".join(entry.line() for entry in entries)
        write_whole(journal, lines)
        sync(journal)
        self._journal_bytes += len(lines)
        self._lines += lines
        self._mid_line = False

    def _set_aside(self, array_frames: int) -> tuple[str, ...]:
        """Rename the chunks that the array counts beyond the end of its journal, and shorten the
        array.
        """
        behind = range(self._end, array_frames)
        if not behind:
            return ()
        try:
            for file in self.path.glob("c.*.0.0"):
                if (index := file.name.split(".")[1]).isdecimal() and int(index) in behind:
                    file.rename(
                        next(
                            other
                            for n in count(1)
                            if not (other := Path(f"{file}.aside-{n}")).exists()
                        )
                    )
            self._describe(self._end)
        except OSError as error:
            raise BadInput(
                f"a stack can go on only on a disk that takes it, got {error.strerror!r} in "
                f"{self.path}"
            ) from None
        return (
            f"{self.path.name} counted {array_frames} frames and its journal {self._end}: chunks "
            "that the journal does not acknowledge were put aside under names with .aside",
        )

    def _create(self) -> None:
        """Create the array with an empty journal under another name, then rename it into place."""
        partial = self.path.with_name(f".{self.path.name}.partial")
        shutil.rmtree(partial, ignore_errors=True)
        if self.path.exists():
            raise BadInput(f"the store cannot write over what it did not make, got {self.path}")
        partial.mkdir(parents=True)
        write_atomically(partial / METADATA, metadata(0, self._shape, self._dtype))
        write_atomically(partial / JOURNAL, b"")
        os.rename(partial, self.path)
        sync_folder(self.path.parent)

    def _require_same(self) -> None:
        _, shape, pixel = read_metadata(self.path)
        if shape != self._shape or pixel != self._dtype.name:
            raise BadInput(
                f"{self.path.name} was begun with frames of {shape} {pixel}, got {self._shape} "
                f"{self._dtype}"
            )


def _entry(index: int, frame: Frame) -> Acknowledged:
    return Acknowledged(
        index=index,
        frame_number=int(frame.number),
        time_s=float(frame.time_s),
        sha256=sha256(frame.pixels),
    )


def _start_writing_out(file: int) -> None:
    """Start writing a file to the disk without waiting, where the kernel supports it."""
    if hasattr(os, "posix_fadvise"):
        os.posix_fadvise(file, 0, 0, os.POSIX_FADV_DONTNEED)
