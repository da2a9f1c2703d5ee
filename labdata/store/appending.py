"""Writing to the store: each frame is on the disk, whole and acknowledged, before `append` returns."""

import json
import os
import shutil
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdata.capture import Frame
from labdata.durable import sync_folder, write_durably, write_whole
from labdata.errors import BadInput
from labdata.store.journal import JOURNAL, Acknowledged, journal, sha256
from labdata.store.layout import METADATA, chunk, described, frame_bytes, metadata

FORCED_AT_ONCE = 8
"""Chunks that are forced to the disk at once: it serves those that wait together about as fast as one of them."""


class ArrayWriter:
    """One array of the store, open for appending.

    Parameters
    ----------
    path
        Folder of the array; one that exists is continued behind its last acknowledged frame.
    shape
        Rows and columns of a frame.
    dtype
        Type of a pixel.

    Raises
    ------
    BadInput
        If the array exists with another shape or type.
    """

    def __init__(self, path: Path, shape: tuple[int, int], dtype: Any) -> None:
        self.path = path
        self._shape = (int(shape[0]), int(shape[1]))
        self._dtype = np.dtype(dtype).newbyteorder("<")
        if not (path / JOURNAL).is_file():
            self._create()
        for left_over in path.glob(".*.partial"):
            left_over.unlink()
        self._require_same()
        self._frames = len(journal(path))
        self._journal = open(path / JOURNAL, "r+b", buffering=0)  # noqa: SIM115 - open as long as the writer
        self._end = sum(len(line) for line in self._journal.readlines()[: self._frames])
        self._disk = ThreadPoolExecutor(FORCED_AT_ONCE, thread_name_prefix="disk")

    def __len__(self) -> int:
        return self._frames

    def append(self, frame: NDArray, time_s: float, frame_number: int) -> Acknowledged:
        """Write one frame; when this returns it survives a kill and a power cut.

        Parameters
        ----------
        frame
            Pixels, shape (row, col).
        time_s
            Time stamp, s.
        frame_number
            The camera's own number.
        """
        return self.extend([Frame(pixels=np.asarray(frame), number=frame_number, time_s=time_s)])[0]

    def extend(self, frames: Sequence[Frame]) -> tuple[Acknowledged, ...]:
        """Write some frames together, which forces the disk once for all of them; as safe as one after the other.

        Notes
        -----
        The order is what makes it safe: the chunks are forced to the disk, then the array grows over them, then the
        journal acknowledges them. A chunk torn by a crash lies behind the end of the array and is written over.
        """
        for frame in frames:
            self._require_fit(frame.pixels)
        try:
            entries = self._write(frames)
            self._describe(self._frames + len(frames))
            self._acknowledge(entries)
        except OSError as error:
            raise BadInput(
                f"the disk must take every frame, got {error.strerror!r} after {self._frames} frames of {self.path}"
            ) from None
        self._frames += len(frames)
        return entries

    def close(self) -> None:
        """Close the journal; frames so far are safe with or without it."""
        self._disk.shutdown()
        self._journal.close()

    def _require_fit(self, pixels: NDArray) -> None:
        if pixels.shape != self._shape or pixels.dtype != self._dtype:
            raise BadInput(
                f"a frame of {self.path.name} must be {self._shape} {self._dtype}, got {pixels.shape} {pixels.dtype}"
            )

    def _write(self, frames: Sequence[Frame]) -> tuple[Acknowledged, ...]:
        """Put the chunks on the disk; digests are made while the disk is at work."""
        files: list[int] = []
        forced: list[Future[None]] = []
        try:
            for place, frame in enumerate(frames):
                files.append(os.open(chunk(self.path, self._frames + place), os.O_WRONLY | os.O_CREAT | os.O_TRUNC))
                write_whole(files[-1], frame_bytes(frame.pixels))
                _start_writing_out(files[-1])
            forced += [self._disk.submit(os.fsync, file) for file in files]
            entries = tuple(_entry(self._frames + place, frame) for place, frame in enumerate(frames))
            for each in forced:
                each.result()
        finally:
            wait(forced)  # no file is closed under a thread that forces it
            for file in files:
                os.close(file)
        return entries

    def _describe(self, frames: int) -> None:
        # Forces the list of names to the disk too, those of the chunks included.
        write_durably(self.path / METADATA, metadata(frames, self._shape, self._dtype))

    def _acknowledge(self, entries: Sequence[Acknowledged]) -> None:
        # What a failed or interrupted line left behind is cut off first.
        self._journal.seek(self._end)
        self._journal.truncate()
        lines = b"".join(json.dumps(asdict(entry)).encode() + b"\n" for entry in entries)
        write_whole(self._journal.fileno(), lines)
        os.fsync(self._journal.fileno())
        self._end += len(lines)

    def _create(self) -> None:
        """Make the array with its empty journal under another name, then put it in place whole."""
        partial = self.path.with_name(f".{self.path.name}.partial")
        shutil.rmtree(partial, ignore_errors=True)
        if self.path.exists():
            raise BadInput(f"the store cannot write over what it did not make, got {self.path}")
        partial.mkdir(parents=True)
        write_durably(partial / METADATA, metadata(0, self._shape, self._dtype))
        write_durably(partial / JOURNAL, b"")
        os.rename(partial, self.path)
        sync_folder(self.path.parent)

    def _require_same(self) -> None:
        _, shape, pixel = described(self.path)
        if shape != self._shape or pixel != self._dtype.name:
            raise BadInput(
                f"{self.path.name} was begun with frames of {shape} {pixel}, got {self._shape} {self._dtype}"
            )


def _entry(index: int, frame: Frame) -> Acknowledged:
    return Acknowledged(
        index=index, frame_number=int(frame.number), time_s=float(frame.time_s), sha256=sha256(frame.pixels)
    )


def _start_writing_out(file: int) -> None:
    """Have the kernel send a file to the disk without waiting for it, where the kernel can be told."""
    if hasattr(os, "posix_fadvise"):
        os.posix_fadvise(file, 0, 0, os.POSIX_FADV_DONTNEED)
