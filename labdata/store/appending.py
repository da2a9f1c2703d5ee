"""Writing to the store: each frame is on the disk, whole and acknowledged, before `append` returns."""

import json
import os
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdata.durable import sync_folder, write_durably
from labdata.errors import BadInput
from labdata.store.journal import JOURNAL, Acknowledged, journal, sha256


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
        self._array = self._opened()
        self._frames = len(journal(path))
        self._journal = open(path / JOURNAL, "r+b", buffering=0)  # noqa: SIM115 - open as long as the writer
        self._end = sum(len(line) for line in self._journal.readlines()[: self._frames])

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
        frame = np.asarray(frame)
        if frame.shape != self._shape or frame.dtype != self._dtype:
            raise BadInput(
                f"a frame of {self.path.name} must be {self._shape} {self._dtype}, got {frame.shape} {frame.dtype}"
            )
        entry = Acknowledged(
            index=self._frames, frame_number=int(frame_number), time_s=float(time_s), sha256=sha256(frame)
        )
        try:
            self._write(frame)
            self._acknowledge(entry)
        except OSError as error:
            raise BadInput(
                f"the disk must take every frame, got {error.strerror!r} after {self._frames} frames of {self.path}"
            ) from None
        self._frames += 1
        return entry

    def close(self) -> None:
        """Close the journal; frames so far are safe with or without it."""
        self._journal.close()

    def _write(self, frame: NDArray) -> None:
        if self._array.shape[0] <= self._frames:
            self._array.resize((self._frames + 1, *self._shape))
        self._array[self._frames] = frame

    def _acknowledge(self, entry: Acknowledged) -> None:
        # What a failed or interrupted line left behind is cut off first.
        self._journal.seek(self._end)
        self._journal.truncate()
        self._journal.write(json.dumps(asdict(entry)).encode() + b"\n")
        os.fsync(self._journal.fileno())
        self._end = self._journal.tell()

    def _create(self) -> None:
        """Make the array with its empty journal under another name, then put it in place whole."""
        import zarr

        partial = self.path.with_name(f".{self.path.name}.partial")
        shutil.rmtree(partial, ignore_errors=True)
        if self.path.exists():
            raise BadInput(f"the store cannot write over what it did not make, got {self.path}")
        partial.parent.mkdir(parents=True, exist_ok=True)
        zarr.create_array(
            partial,
            shape=(0, *self._shape),
            chunks=(1, *self._shape),
            dtype=self._dtype,
            compressors=None,
            fill_value=0,
            # One flat folder: folders of their own would each have to be forced to the disk as well.
            chunk_key_encoding={"name": "default", "separator": "."},
        )
        write_durably(partial / "zarr.json", (partial / "zarr.json").read_bytes())
        write_durably(partial / JOURNAL, b"")
        os.rename(partial, self.path)
        sync_folder(self.path.parent)

    def _opened(self) -> Any:
        import zarr

        # A frame that is black all over must have its chunk too: absence would look like loss.
        array = zarr.open_array(_durable_store(self.path), mode="r+").with_config({"write_empty_chunks": True})
        if array.shape[1:] != self._shape or array.dtype != self._dtype:
            raise BadInput(
                f"{self.path.name} was begun with frames of {array.shape[1:]} {array.dtype}, "
                f"got {self._shape} {self._dtype}"
            )
        return array


def _durable_store(root: Path) -> Any:
    """Return a local Zarr store that forces each object to the disk before it gets its name.

    Zarr's own `LocalStore` writes under another name and renames, which survives a kill; it does not force the
    bytes to the disk, which a power cut needs.
    """
    import asyncio

    from zarr.storage import LocalStore

    class DurableStore(LocalStore):
        async def set(self, key: str, value: Any) -> None:
            self._check_writable()
            await asyncio.to_thread(write_durably, self.root / key, value.as_buffer_like())

    return DurableStore(root)
