"""Following an array while another process writes it: only what is new is read, frame by frame."""

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from labdata.capture import Frame
from labdata.errors import BadInput
from labdata.store.journal import JOURNAL, Acknowledged, acknowledged
from labdata.store.reading import block, opened


class Following:
    """An array of the store that may still grow.

    Parameters
    ----------
    path
        Folder of the array.

    Notes
    -----
    It only reads, and never waits for the writer: what the journal acknowledges is whole.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._read_bytes = 0
        self._frames = 0
        self._array: Any = None

    def __len__(self) -> int:
        """Frames seen so far."""
        return self._frames

    def news(self) -> tuple[Acknowledged, ...]:
        """Return what was acknowledged since the last look."""
        try:
            with open(self.path / JOURNAL, "rb") as file:
                file.seek(self._read_bytes)
                lines = file.read().splitlines(keepends=True)
        except FileNotFoundError:
            raise BadInput(f"an array that is followed must stay where it is, got no {self.path}") from None
        found = acknowledged(lines, first=self._frames)
        self._read_bytes += sum(len(line) for line in lines[: len(found)])
        self._frames += len(found)
        return found

    def frame(self, entry: Acknowledged) -> Frame:
        """Read one acknowledged frame; one that is not what was acknowledged is a BadInput."""
        if self._array is None or self._array.shape[0] <= entry.index:
            self._array = opened(self.path)
        pixels: NDArray = block(self.path, self._array, (entry,))[0]
        return Frame(pixels=pixels, number=entry.frame_number, time_s=entry.time_s)
