"""Read acknowledged frames of an array, complete or still growing."""

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdata.capture import Frame
from labdata.errors import BadInput
from labdata.file_io import require_regular
from labdata.frames import FrameStack
from labdata.store.journal import JOURNAL, Acknowledged, chunk, read_journal, records_of, sha256


def read(path: str | Path, *, verify: bool = True) -> FrameStack:
    """Read the acknowledged frames of an array, compared with their SHA-256; lost frames are
    counted and noted.
    """
    path = Path(path)
    journal = read_journal(path)
    journal.require_frames()
    return FrameStack(
        data=read_frames(path, open_array(path), journal.frames, verify=verify),
        time_s=np.array([frame.time_s for frame in journal.frames]),
        frame_number=np.array([frame.frame_number for frame in journal.frames], np.int64),
        lost_frames=journal.lost_frames,
        notes=journal.notes,
    )


def open_array(path: Path) -> Any:
    """Open the Zarr array in its present size, without reading it."""
    import zarr

    try:
        return zarr.open_array(path, mode="r")
    except Exception:
        raise BadInput(f"a stack of the store must be a readable Zarr array, got {path}") from None


def read_frames(
    path: Path, array: Any, frames: Sequence[Acknowledged], *, verify: bool = True
) -> NDArray:
    """Read frames of an array opened by `open_array`, shape (frame, row, col); altered or missing
    ones are BadInput.
    """
    for frame in frames:
        if (file := chunk(path, frame.index)).exists():
            require_regular(file, "a stored frame")
    runs = [
        [frame for _, frame in run]
        for _, run in groupby(enumerate(frames), lambda entry: entry[1].index - entry[0])
    ]
    parts = [_pixels(path, array, run[0].index, run[-1].index + 1) for run in runs]
    data = parts[0] if len(parts) == 1 else np.concatenate(parts)
    for frame, pixels in zip(frames, data, strict=True):
        if verify and sha256(pixels) != frame.sha256:
            raise BadInput(
                f"every frame must be what was acknowledged, got other pixels in frame "
                f"{frame.index} of {path}"
            )
    return data


def _pixels(path: Path, array: Any, first: int, last: int) -> NDArray:
    """Read frames first..last-1; files of a size other than stated by the metadata are a
    BadInput.
    """
    if array.shape[0] < last:
        raise BadInput(f"{path} must hold the {last} frames of its journal, got {array.shape[0]}")
    try:
        return array[first:last]
    except Exception:  # each codec raises its own errors
        raise BadInput(
            f"the frames {first} to {last - 1} of {path} must be as it describes them, got others"
        ) from None


class ArrayFollower:
    """An array of the store that may still grow; only new frames are read, one by one, without
    waiting.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._read_bytes, self._read_lines = 0, 0
        self._frames, self._end = 0, 0
        self._array: Any = None

    def __len__(self) -> int:
        """Number of acknowledged frames so far."""
        return self._frames

    def news(self) -> tuple[Acknowledged, ...]:
        """Return the frames acknowledged since the last call."""
        try:
            with open(self.path / JOURNAL, "rb") as file:
                file.seek(self._read_bytes)
                *lines, _ = file.read().split(b"\n")
        except FileNotFoundError:
            raise BadInput(
                f"an array that is followed must stay where it is, got no {self.path}"
            ) from None
        frames: dict[int, Acknowledged] = {}
        for line in lines:
            frames |= {
                frame.index: frame for frame in records_of(line, self._read_lines, self.path)
            }
            self._read_bytes += len(line) + 1
            self._read_lines += 1
        news = tuple(frame for index, frame in sorted(frames.items()) if index >= self._end)
        self._frames += len(news)
        self._end = news[-1].index + 1 if news else self._end
        return news

    def frame(self, entry: Acknowledged) -> Frame:
        """Read one acknowledged frame; one that differs from its digest is a BadInput."""
        if self._array is None or self._array.shape[0] <= entry.index:
            self._array = open_array(self.path)
        pixels: NDArray = read_frames(self.path, self._array, (entry,))[0]
        return Frame(pixels=pixels, number=entry.frame_number, time_s=entry.time_s)
