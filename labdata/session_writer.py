"""Write a session stack by stack; it is readable at any time and resumable after a crash."""

import fcntl
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdata.capture import Frame, LostFrames
from labdata.conditions import Conditions, own_keys
from labdata.errors import BadInput
from labdata.file_io import write_atomically
from labdata.serialiser import to_toml
from labdata.session import (
    MANIFEST,
    Session,
    SessionFile,
    StackRecord,
    open_session,
    read_manifest,
    sealed,
    stack_record,
)
from labdata.store.array_writer import ArrayWriter
from labdata.store.journal import Acknowledged, is_ours, read_journal
from labdata.target import Kind, Target


class StackWriter:
    """One stack while it is taken; made by `SessionWriter.begin_stack`. Use it with `with`.

    Leaving the `with` without `finish` leaves the stack readable and marked as broken off.
    """

    def __init__(
        self, array: ArrayWriter, entry: StackRecord, enter: Callable[[StackRecord], None]
    ) -> None:
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
        """Store one frame; it is on the disk and part of the session when this returns."""
        return self.extend([Frame(pixels=np.asarray(frame), number=frame_number, time_s=time_s)])[0]

    def extend(self, frames: Sequence[Frame]) -> tuple[Acknowledged, ...]:
        """Store several frames with one sync of the disk; as safe as one after the other."""
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
        """Mark the stack as complete, with further losses and notes, and conditions read back at
        the end, if any.
        """
        if not len(self._array):
            raise BadInput(
                f"a finished stack must hold at least one frame, got none in {self.label!r}"
            )
        self._array.require_journal()
        entry = (
            self._entry
            if conditions is None
            else stack_record(conditions, **own_keys(self._entry, StackRecord))
        )
        self._entry = _with_losses(
            replace(entry, finished=None, notes=(*entry.notes, *notes)), losses
        )
        self._enter(self._entry)
        self.close()

    def lose(self, losses: tuple[LostFrames, ...]) -> None:
        """Record lost frames; a stack without frames is not part of the session and records
        nothing.
        """
        if losses and len(self._array):
            self._entry = _with_losses(self._entry, losses)
            self._enter(self._entry)

    def doubt(self, why: str) -> None:
        """Record a reason to doubt the frames so far; a resumed run acquires the stack again."""
        if len(self._array):
            self._entry = replace(self._entry, doubt=why)
            self._enter(self._entry)

    def close(self) -> None:
        """Close the stack as it is; acknowledged frames are kept."""
        self._array.close()


def _with_losses(entry: StackRecord, losses: tuple[LostFrames, ...]) -> StackRecord:
    """Return the entry of a stack with further losses added."""
    count = (entry.lost_frames or 0) + sum(map(len, losses))
    return replace(entry, lost=(*entry.lost, *losses), lost_frames=count or None)


FRAMES = "frames"
LOCK = ".lock"


class SessionWriter:
    """A session during acquisition; make it with `create` or `resume` and use it in a `with`
    block.
    """

    def __init__(self, folder: Path, form: SessionFile) -> None:
        self.folder = folder
        self._lock = _lock_session(folder)
        self._form = form
        self._manifest = ManifestWriter(folder)

    @classmethod
    def create(cls, folder: str | Path, **keys: Any) -> "SessionWriter":
        """Begin a session in a folder without one; the keys are those of `SessionFile`."""
        folder = Path(folder)
        if (folder / MANIFEST).exists():
            raise BadInput(f"a new session needs a folder without one, got {folder}")
        if folder.exists() and not folder.is_dir():
            raise BadInput(f"a session must be a folder, got the file {folder}")
        (folder / FRAMES).mkdir(parents=True, exist_ok=True)
        form = SessionFile(**keys)
        writer = cls(folder, form)
        writer._save(form)
        return writer

    @classmethod
    def resume(cls, folder: str | Path) -> "SessionWriter":
        """Continue an interrupted session."""
        folder = Path(folder)
        return cls(folder, read_manifest(folder))

    def __enter__(self) -> "SessionWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def finished_labels(self) -> tuple[str, ...]:
        """Labels of the stacks that are complete."""
        return tuple(entry.label for entry in self._form.stack if entry.finished is not False)

    @property
    def partial(self) -> dict[str, int]:
        """Labels of the interrupted stacks, with their numbers of acknowledged frames."""
        return {
            entry.label: len(read_journal(self._path(entry.label)).frames)
            for entry in self._form.stack
            if entry.finished is False
        }

    def begin_stack(
        self,
        label: str,
        kind: Kind,
        shape: tuple[int, int],
        dtype: Any,
        conditions: Conditions,
        asked: Conditions | None = None,
        target: Target | None = None,
        sensor: str | None = None,
        bit_depth: int | None = None,
    ) -> StackWriter:
        """Begin a stack, or continue an interrupted one; its length is then its number of frames.

        `conditions` are those in force, `asked` the requested ones; `sensor` and `bit_depth` belong
        to the stack where a session has several sensors. A stack that is complete, or was begun
        with other settings, is BadInput.
        """
        path = self._path(label)
        entry = stack_record(
            conditions,
            label=label,
            kind=kind,
            frames=f"{FRAMES}/{path.name}",
            asked=None if asked == Conditions() else asked,
            target=target or Target(),
            sensor=sensor,
            bit_depth=bit_depth,
            finished=False,
        )
        known = {record.label: record for record in self._form.stack}.get(label)
        if known is not None:
            entry = _resume_entry(known, entry)
        if is_ours(path):
            entry = self._clear_folder(path, entry, begun=known is not None)
        array = ArrayWriter(path, shape, dtype)
        return StackWriter(array, replace(entry, notes=(*entry.notes, *array.notes)), self._enter)

    @property
    def doubtful(self) -> dict[str, str]:
        """Labels of the stacks with doubtful frames, with the reasons."""
        return {entry.label: entry.doubt for entry in self._form.stack if entry.doubt is not None}

    def set_aside(self, label: str) -> Path:
        """Remove an interrupted stack from the session, to acquire it again; return the folder of
        its frames.
        """
        path = self._path(label)
        aside = _aside(path)
        self._forget(label)
        path.rename(aside)
        return aside

    def add_note(self, note: str) -> None:
        """Add a remark to the session."""
        self._save(replace(self._form, notes=(*self._form.notes, note)))

    def session(self) -> Session:
        """Open the session in its present state."""
        return open_session(self.folder)

    def close(self) -> None:
        """Release the lock of the session."""
        self._lock.close()

    def _clear_folder(self, path: Path, entry: StackRecord, *, begun: bool) -> StackRecord:
        """Clear the folder of an array that cannot be continued, and note in the entry what was set
        aside.

        A kill between the first frames and the manifest leaves frames without a stack; a damaged
        journal may leave a stack without readable frames.
        """
        journal = read_journal(path)
        if journal.frames and begun:
            return entry
        if not journal.lost_frames and not journal.frames and not journal.damaged_lines:
            shutil.rmtree(path)
            return entry
        if begun:
            self._forget(entry.label)
        aside = path.rename(_aside(path))
        why = journal.notes[0] if journal.notes else "the session did not count them yet"
        return replace(
            entry,
            notes=(*entry.notes, f"acquired again, the earlier frames are in {aside.name}: {why}"),
        )

    def _forget(self, label: str) -> None:
        if label in self.finished_labels:
            raise BadInput(
                f"only a stack that was broken off can leave its session, got the complete "
                f"{label!r}"
            )
        self._save(
            replace(
                self._form,
                stack=tuple(record for record in self._form.stack if record.label != label),
            )
        )

    def _enter(self, entry: StackRecord) -> None:
        stacks = {record.label: record for record in self._form.stack}
        self._save(replace(self._form, stack=tuple({**stacks, entry.label: entry}.values())))

    def _save(self, form: SessionFile) -> None:
        self._manifest.save(form)
        self._form = form

    def _path(self, label: str) -> Path:
        if not label or label.startswith(".") or set(label) & set("/\\\0"):
            raise BadInput(
                f"a label must be a file name without slashes or a leading dot, got {label!r}"
            )
        return self.folder / FRAMES / f"{label}.zarr"


def _aside(path: Path) -> Path:
    """Return a free folder name for frames removed from their session."""
    return next(
        other
        for number in count(1)
        if not (other := path.with_name(f"{path.stem}.aside-{number}.zarr")).exists()
    )


def _resume_entry(known: StackRecord, entry: StackRecord) -> StackRecord:
    """Return the original entry of a continued stack; other settings are a BadInput."""
    if known.finished is not False:
        raise BadInput(f"a complete stack cannot be begun again, got {known.label!r}")
    if (known.kind, known.asked, known.target) != (entry.kind, entry.asked, entry.target):
        raise BadInput(
            f"a stack must go on as it was begun, got another kind, target or setting for "
            f"{known.label!r}"
        )
    return known


def _lock_session(folder: Path) -> Any:
    """Return the open lock file of a session; BadInput if another process has the lock."""
    file = open(folder / LOCK, "w")  # noqa: SIM115 - open as long as the writer
    try:
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        raise BadInput(
            f"one process may write to a session at a time, got a second for {folder}"
        ) from None
    return file


class ManifestWriter:
    """Writes the complete manifest of a folder at every change; only changed stacks are serialised
    again.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / MANIFEST
        self._written: dict[StackRecord, str] = {}

    def save(self, form: SessionFile) -> None:
        """Save the manifest; when this returns it survives a kill or a power cut."""
        # A sweep saves the manifest after each of hundreds of stacks: unchanged ones are not
        # serialised again.
        texts = {entry: self._written.get(entry) or _stack_text(entry) for entry in form.stack}
        header = to_toml(replace(form, stack=()))
        write_atomically(self._path, sealed("\n".join((header, *texts.values()))))
        self._written = texts


@dataclass(frozen=True)
class _OneStack:
    """The part of a session file for one stack."""

    stack: tuple[StackRecord, ...]


def _stack_text(entry: StackRecord) -> str:
    text = to_toml(_OneStack((entry, _LONG)))
    return text[: text.rindex("[[stack]]")]


# The TOML writer puts short tables on one line, which cannot be concatenated; next to a long one it
# does not.
_LONG = StackRecord(label="x" * 200, kind="dark", frames="")
