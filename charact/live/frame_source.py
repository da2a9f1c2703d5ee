"""Frame sources of the live view: a camera, or a session during its acquisition."""

import re
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from charact.method import Context
from drivers.interface import Camera
from labdata import BadInput, CameraSettings, Frame, load_camera
from labdata.conditions import Conditions, conditions_of
from labdata.session import MANIFEST, SessionFile, StackRecord, read_manifest
from labdata.store import Acknowledged, ArrayFollower, is_ours

ENDLESS = 2**40  # frames; at a thousand a second, 35 years


@dataclass(frozen=True, kw_only=True)
class SourceFrame:
    """A frame, its camera or stack, full scale, frames lost since the start, and conditions as read
    back.
    """

    frame: Frame
    of: str
    full_scale_dn: float
    lost_frames: int = 0
    conditions: Conditions = field(default_factory=Conditions)


def full_scale_of(dtype: np.dtype, pixel_format: str | None = None) -> float:
    """Return the full scale of a pixel format ("Mono12"), else of the data type, DN."""
    named = re.search(r"\d+", pixel_format or "")
    own_bits = 8 * dtype.itemsize
    return float(2 ** min(int(named.group()) if named else own_bits, own_bits) - 1)


class FrameSource(Protocol):
    """Source of frames."""

    name: str
    """Display name."""
    context: Context
    """Context of the camera."""
    while_waiting: Callable[[], None]
    """Called while no frame comes; an exception ends the source."""

    def __iter__(self) -> Iterator[SourceFrame | None]:
        """Yield frames as they arrive, and None at intervals without frames."""
        ...


class CameraSource:
    """Endless capture of a camera with its present settings.

    The full scale of the context overrides that of the pixel format; `most_hz`: frame rate limit of
    a camera without clock, Hz; `frames_each`: frames of one capture.
    """

    def __init__(
        self,
        camera: AbstractContextManager[Camera],
        *,
        name: str,
        context: Context,
        most_hz: float | None = None,
        frames_each: int = ENDLESS,
    ) -> None:
        self._camera, self.name, self.context = camera, name, context
        self._frames_each = frames_each
        self._period_s = 0.0 if most_hz is None else 1.0 / most_hz
        self.while_waiting: Callable[[], None] = lambda: None

    def __iter__(self) -> Iterator[SourceFrame | None]:
        with self._camera as camera:
            settings = camera.configure(CameraSettings())
            while True:
                yield from self._capture(camera, settings)

    def _capture(self, camera: Camera, settings: CameraSettings) -> Iterator[SourceFrame]:
        conditions = Conditions(exposure_s=settings.exposure_s, camera_gain_db=settings.gain_db)
        with camera.capture(
            frames=self._frames_each, while_waiting=lambda: self.while_waiting()
        ) as capture:
            due_s = time.monotonic()
            for frame in capture:
                own_scale_dn = full_scale_of(frame.pixels.dtype, settings.pixel_format)
                full_scale_dn = self.context.full_scale_dn or own_scale_dn
                lost = capture.lost_frames
                yield SourceFrame(
                    frame=frame,
                    of=camera.identifier,
                    full_scale_dn=full_scale_dn,
                    lost_frames=lost,
                    conditions=conditions,
                )
                due_s = max(due_s + self._period_s, time.monotonic())
                time.sleep(max(due_s - time.monotonic(), 0.0) if self._period_s else 0.0)


class SessionSource:
    """Newest frames of a session during its acquisition, read from disk; intermediate frames are
    skipped.

    `look_s`: interval between two reads of the journal, s. Raises BadInput if there is no session.
    """

    def __init__(self, folder: str | Path, *, look_s: float = 0.04) -> None:
        self.folder, self._look_s = Path(folder), look_s
        if not (self.folder / MANIFEST).is_file():
            raise BadInput(f"a session must be a folder with a {MANIFEST}, got {folder}")
        self.name = f"session {self.folder.name}"
        self.while_waiting: Callable[[], None] = lambda: None
        self._form, self._written_ns = self._read()
        camera = (
            None
            if self._form.sensor is None
            else load_camera(self._form.sensor, relative_to=self.folder)
        )
        self._bit_depth = self._form.bit_depth
        self.context = Context(
            quick=True,
            camera=camera,
            interlaced=bool(self._form.interlaced),
            full_scale_dn=None if self._bit_depth is None else float(2**self._bit_depth - 1),
        )

    def __iter__(self) -> Iterator[SourceFrame | None]:
        stack: _Stack | None = None
        while True:
            newest = self._newest()
            if newest is not None and (stack is None or stack.form.label != newest.label):
                stack = _Stack(newest, self.folder / _array_of(newest), self.context)
            for source_frame in (stack.newest() if stack else ()) or (None,):
                yield source_frame
                time.sleep(self._look_s)

    def _newest(self) -> StackRecord | None:
        """Return the stack being acquired, else the last one."""
        if (self.folder / MANIFEST).stat().st_mtime_ns != self._written_ns:
            self._form, self._written_ns = self._read()
        unfinished = [stack for stack in self._form.stack if stack.finished is False]
        return (unfinished or [*self._form.stack] or [None])[-1]

    def _read(self) -> tuple[SessionFile, int]:
        written_ns = (self.folder / MANIFEST).stat().st_mtime_ns
        return read_manifest(self.folder), written_ns


class _Stack:
    """A stack during its acquisition."""

    def __init__(self, form: StackRecord, path: Path, context: Context) -> None:
        if not is_ours(path):
            raise BadInput(f"the session must be acquired by charact acquire, got {path}")
        self.form, self._full_scale_dn = form, context.full_scale_dn
        self._following = ArrayFollower(path)
        self._first_number: int | None = None

    def newest(self) -> tuple[SourceFrame, ...]:
        """Return the newest frame since the last read, at the first up to four, sufficient for
        noise and focus.
        """
        news = self._following.news()
        shown = news[-1:]
        if news and self._first_number is None:
            self._first_number, shown = news[0].frame_number, news[-4:]
        return tuple(self._source_frame(entry) for entry in shown)

    def _source_frame(self, entry: Acknowledged) -> SourceFrame:
        frame = self._following.frame(entry)
        return SourceFrame(
            frame=frame,
            of=f"stack {self.form.label}",
            full_scale_dn=self._full_scale_dn or full_scale_of(frame.pixels.dtype),
            lost_frames=frame.number - (self._first_number or 0) - entry.index,
            conditions=conditions_of(self.form),
        )


def _array_of(stack: StackRecord) -> str:
    if not isinstance(stack.frames, str):
        raise BadInput(
            f"the session must be acquired by charact acquire, got {len(stack.frames)} files"
        )
    return stack.frames
