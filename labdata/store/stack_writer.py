"""Writing one stack while it is taken: readable at every moment, and marked as broken off until it is finished."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdata.capture import Frame, LostFrames
from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.file_records import StackRecord, stack_record
from labdata.store.array_writer import ArrayWriter
from labdata.store.journal import Acknowledged


class StackWriter:
    """One stack while it is taken; made by `SessionWriter.begin_stack`. Use it with `with`.

    Leaving the `with` without `finish` leaves the stack readable and marked as broken off.
    """

    def __init__(self, array: ArrayWriter, entry: StackRecord, enter: Callable[[StackRecord], None]) -> None:
        self._array = array
        self._entry = entry
        self._enter = enter
        if len(array):
            enter(entry)

    def __len__(self) -> int:
        """Frames acknowledged so far, those of an earlier run included."""
        return len(self._array)

    def __enter__(self) -> "StackWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def label(self) -> str:
        """Label of the stack."""
        return self._entry.label

    def append(self, frame: NDArray, time_s: float, frame_number: int) -> Acknowledged:
        """Store one frame; it is durable, whole and part of the session when this returns.

        Parameters
        ----------
        frame
            Pixels, shape (row, col), of the shape and type that the stack was begun with.
        time_s
            Time stamp, s.
        frame_number
            The camera's own number.
        """
        return self.extend([Frame(pixels=np.asarray(frame), number=frame_number, time_s=time_s)])[0]

    def extend(self, frames: Sequence[Frame]) -> tuple[Acknowledged, ...]:
        """Store some frames together, which costs the disk less; as safe as one after the other."""
        first = not len(self._array)
        acknowledged = self._array.extend(frames)
        if first:
            self._enter(self._entry)
        return acknowledged

    def finish(
        self,
        losses: tuple[LostFrames, ...] = (),
        notes: tuple[str, ...] = (),
        conditions: Conditions | None = None,
    ) -> None:
        """Mark the stack as complete.

        Parameters
        ----------
        losses
            Frames that the camera numbered and that are not here, beside those already told by `lose`.
        notes
            Remarks on the stack.
        conditions
            Conditions read back at its end, where they replace those of its beginning.
        """
        if not len(self._array):
            raise BadInput(f"a finished stack must hold at least one frame, got none in {self.label!r}")
        entry = self._entry if conditions is None else stack_record(conditions, **_other_keys(self._entry))
        self._entry = _with_losses(replace(entry, finished=None, notes=(*entry.notes, *notes)), losses)
        self._enter(self._entry)
        self.close()

    def lose(self, losses: tuple[LostFrames, ...]) -> None:
        """Record frames that are not here; a stack without any frame is no part of the session and records nothing."""
        if losses and len(self._array):
            self._entry = _with_losses(self._entry, losses)
            self._enter(self._entry)

    def doubt(self, why: str) -> None:
        """Say why the frames so far may not show what the stack says: it is not gone on with, but taken anew."""
        if len(self._array):
            self._entry = replace(self._entry, doubt=why)
            self._enter(self._entry)

    def close(self) -> None:
        """Close the stack as it is; the frames so far are safe."""
        self._array.close()


def _with_losses(entry: StackRecord, losses: tuple[LostFrames, ...]) -> StackRecord:
    """Return the entry of a stack with further losses told and counted."""
    count = (entry.lost_frames or 0) + sum(map(len, losses))
    return replace(entry, lost=(*entry.lost, *losses), lost_frames=count or None)


def _other_keys(entry: StackRecord) -> dict[str, Any]:
    return {name: getattr(entry, name) for name in StackRecord.__annotations__}
