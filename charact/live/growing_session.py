"""A session that grows while a plan runs, read as it lies on the disk: neither camera nor tube is touched."""

import time
from collections.abc import Iterator
from pathlib import Path

from charact.live.frame_source import SourceFrame, highest_code
from charact.method import Context
from labdata.errors import BadInput
from labdata.file_records import SessionFile, StackRecord, conditions_of
from labdata.sensor import Sensor
from labdata.sensors import load_camera
from labdata.serialiser import from_toml
from labdata.session import MANIFEST
from labdata.store import Acknowledged, ArrayFollower, is_ours

LOOK_S = 0.04  # 25 looks a second
FIRST_SHOWN = 4  # enough for noise and focus of a stack that is there already


class SessionSource:
    """The newest frame of a growing session, whenever there is one; frames in between are left out.

    Parameters
    ----------
    folder
        Folder of the session.
    look_s
        Time between two looks at the journal, s.

    Raises
    ------
    BadInput
        If there is no session.
    """

    def __init__(self, folder: str | Path, *, look_s: float = LOOK_S) -> None:
        self.folder, self._look_s = Path(folder), look_s
        if not (self.folder / MANIFEST).is_file():
            raise BadInput(f"a session must be a folder with a {MANIFEST}, got {folder}")
        self.name = f"session {self.folder.name}"
        self._form, self._written_ns = self._read()
        camera = None if self._form.sensor is None else load_camera(self._form.sensor, relative_to=self.folder)
        self._bit_depth = self._form.bit_depth
        self.context = Context(
            quick=True,
            sensor=camera if isinstance(camera, Sensor) else None,
            interlaced=bool(self._form.interlaced),
            full_scale_dn=None if self._bit_depth is None else float(2**self._bit_depth - 1),
        )

    def __iter__(self) -> Iterator[SourceFrame | None]:
        stack: _Stack | None = None
        while True:
            newest = self._newest()
            if newest is not None and (stack is None or stack.form.label != newest.label):
                stack = _Stack(newest, self.folder / _array_of(newest), self.context)
            for seen in (stack.newest() if stack else ()) or (None,):
                yield seen
                time.sleep(self._look_s)

    def _newest(self) -> StackRecord | None:
        """Return the stack that is being taken, else the last one."""
        if (self.folder / MANIFEST).stat().st_mtime_ns != self._written_ns:
            self._form, self._written_ns = self._read()
        unfinished = [stack for stack in self._form.stack if stack.finished is False]
        return (unfinished or [*self._form.stack] or [None])[-1]

    def _read(self) -> tuple[SessionFile, int]:
        written_ns = (self.folder / MANIFEST).stat().st_mtime_ns
        return from_toml(self.folder / MANIFEST, SessionFile), written_ns


class _Stack:
    """One stack while it grows."""

    def __init__(self, form: StackRecord, path: Path, context: Context) -> None:
        if not is_ours(path):
            raise BadInput(f"only frames taken by charact acquire can be followed, got {path}")
        self.form, self._full_scale_dn = form, context.full_scale_dn
        self._following = ArrayFollower(path)
        self._first_number: int | None = None

    def newest(self) -> tuple[SourceFrame, ...]:
        """Return the newest frame, at the first look the newest few; none where none came since the last look."""
        news = self._following.news()
        shown = news[-1:]
        if news and self._first_number is None:
            self._first_number, shown = news[0].frame_number, news[-FIRST_SHOWN:]
        return tuple(self._seen(entry) for entry in shown)

    def _seen(self, entry: Acknowledged) -> SourceFrame:
        frame = self._following.frame(entry)
        return SourceFrame(
            frame=frame,
            of=f"stack {self.form.label}",
            full_scale_dn=self._full_scale_dn or highest_code(frame.pixels.dtype),
            lost_frames=frame.number - (self._first_number or 0) - entry.index,
            conditions=conditions_of(self.form),
        )


def _array_of(stack: StackRecord) -> str:
    if not isinstance(stack.frames, str):
        raise BadInput(f"only frames taken by charact acquire can be followed, got {len(stack.frames)} files")
    return stack.frames
