"""Camera that replays a session with its frame numbers, time stamps and gaps."""

import time
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Self

import numpy as np

from drivers.cameras.frame_assembly import POLL_S, FrameCapture
from drivers.errors import CameraError
from labdata import (
    BadInput,
    CameraSettings,
    Frame,
    LostFrames,
    Session,
    StackEntry,
    open_lazy_stack,
    open_session,
)
from labdata.frames import LazyStack

RATE_WITHOUT_STAMPS_HZ = 30.0
LONGEST_PAUSE_S = 1.0  # Longest wait between two frames, s


class ReplayCamera:
    """A recorded session in place of a camera; use it in a `with` block.

    A requested setting must equal the recorded one. Frames come at the recorded rate.

    Parameters
    ----------
    label
        Stack that every capture replays from its beginning; None: each capture replays the next
        stack.
    speed
        Speed relative to the recording, dimensionless; None: without waiting.
    say
        Called with a sentence on missing frame numbers or time stamps.
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        label: str | None = None,
        speed: float | None = 1.0,
        say: Callable[[str], None] = lambda sentence: None,
    ) -> None:
        if speed is not None and not speed > 0:
            raise BadInput(f"the speed of a replay must be positive, got {speed:g}")
        self._folder, self._label, self._speed, self._say = Path(folder), label, speed, say
        self._session: Session | None = None
        self._played = 0

    @property
    def identifier(self) -> str:
        """The session and stack that are replayed."""
        return f"replay of {self._folder}" + (f"#{self._label}" if self._label else "")

    def __enter__(self) -> Self:
        session = open_session(self._folder)
        if self._label is not None:
            session.stack(self._label)
        self._session, self._played = session, 0
        return self

    def __exit__(self, *_: object) -> None:
        self._session = None

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Return the recorded settings of the next stack; a requested one that differs is
        BadInput.
        """
        recorded = self._settings(self._next(), open_lazy_stack(self._next()))
        for item in fields(settings):
            asked, is_value = getattr(settings, item.name), getattr(recorded, item.name)
            if asked not in (None, ()) and not _same(asked, is_value):
                raise BadInput(
                    f"{item.name} of the {self.identifier} must be as recorded, {is_value}, got "
                    f"{asked}"
                )
        return recorded

    def capture(
        self, *, frames: int, discard: int = 0, while_waiting: Callable[[], None] = lambda: None
    ) -> "ReplayCapture":
        """Return a capture of `frames` recorded frames after `discard` skipped ones."""
        entry = self._next()
        stack = open_lazy_stack(entry)
        capture = ReplayCapture(
            stack,
            self._stamps(entry, stack),
            entry.losses,
            speed=self._speed,
            frames=frames,
            discard=discard,
            while_waiting=while_waiting,
            identifier=self.identifier,
        )
        if len(stack) < frames + discard:
            raise CameraError(
                f"the {self.identifier} must hold the {frames + discard} requested frames, "
                f"stack {entry.label!r} has {len(stack)}"
            )
        self._played += 1
        return capture

    def _next(self) -> StackEntry:
        """Return the stack of the next capture."""
        if self._session is None:
            raise CameraError(
                f"the {self.identifier} must be opened with a with block before it is used"
            )
        if self._label is not None:
            return self._session.stack(self._label)
        if self._played >= len(self._session.stacks):
            raise CameraError(
                f"the {self.identifier} has ended: all {self._played} stacks were played"
            )
        return self._session.stacks[self._played]

    def _settings(self, entry: StackEntry, stack: LazyStack) -> CameraSettings:
        _, rows, columns = stack.shape
        if stack.dtype not in (np.uint8, np.uint16):
            raise BadInput(
                f"a replayed stack must hold pixels of 8 or 16 bits, got {stack.dtype} in "
                f"{entry.label!r}"
            )
        rate_hz = None
        if len(stack.time_s) > 1 and (period_s := float(np.median(np.diff(stack.time_s)))) > 0:
            rate_hz = 1.0 / period_s
        return CameraSettings(
            rows=rows,
            columns=columns,
            first_row=0,
            first_column=0,
            pixel_format="Mono8" if stack.dtype == np.uint8 else "Mono16",
            exposure_s=entry.conditions.exposure_s,
            gain_db=entry.conditions.camera_gain_db,
            frame_rate_hz=rate_hz,
            trigger="off",
            notes=(f"frames are a {self.identifier}",),
        )

    def _stamps(self, entry: StackEntry, stack: LazyStack) -> list[tuple[int, float]]:
        """Return number and time stamp of each frame; missing ones are generated, with a
        message.
        """
        numbers, times_s = stack.frame_number, stack.time_s
        if not len(numbers):
            numbers = np.arange(1, len(stack) + 1)
            self._say(
                f"stack {entry.label!r} has no frame numbers: its frames are numbered as they "
                f"follow"
            )
        if not len(times_s):
            times_s = np.arange(len(stack)) / RATE_WITHOUT_STAMPS_HZ
            self._say(
                f"stack {entry.label!r} has no time stamps: {RATE_WITHOUT_STAMPS_HZ:g} frames/s "
                "are assumed"
            )
        return list(zip(numbers.tolist(), times_s.tolist(), strict=True))


class ReplayCapture(FrameCapture):
    """A running replay; frames lost during the recording are counted as lost."""

    def __init__(
        self,
        stack: LazyStack,
        stamps: list[tuple[int, float]],
        recorded: tuple[LostFrames, ...],
        *,
        speed: float | None,
        frames: int,
        discard: int,
        while_waiting: Callable[[], None],
        identifier: str,
    ) -> None:
        super().__init__(
            frames=frames, discard=discard, while_waiting=while_waiting, identifier=identifier
        )
        self._stack, self._stamps, self._speed = stack, stamps, speed
        self._recorded, self._at, self._first = recorded, 0, discard

    @property
    def losses(self) -> tuple[LostFrames, ...]:
        """Frames missing between the replayed ones, with the recorded causes where known."""
        played = [number for number, _ in self._stamps[max(0, self._first - 1) : self._at]]
        known = tuple(
            loss
            for loss in self._recorded
            if played and played[0] < loss.first and loss.last < played[-1]
        )
        return known if sum(map(len, known)) == self.lost_frames else self._losses

    def _next_frame(self) -> Frame:
        """Return the next recorded frame at its time."""
        if self._at >= len(self._stamps):
            raise CameraError(f"the {self._identifier} has ended after {self._at} frames")
        number, time_s = self._stamps[self._at]
        if self._at and self._speed is not None:
            pause_s = (time_s - self._stamps[self._at - 1][1]) / self._speed
            due_s = time.monotonic() + min(pause_s, LONGEST_PAUSE_S)
            while (left_s := due_s - time.monotonic()) > 0:
                time.sleep(min(left_s, POLL_S))
                self._while_waiting()
        (pixels,) = self._stack.frames(self._at, self._at + 1)
        self._at += 1
        return Frame(pixels=pixels, number=number, time_s=time_s)


def _same(asked: float | str, recorded: float | str | None) -> bool:
    if isinstance(asked, str) or isinstance(recorded, str) or recorded is None:
        return asked == recorded
    return abs(asked - recorded) <= 0.01 * abs(recorded)
