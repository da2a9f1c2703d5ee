"""Timing of a run: time spent in each step, frame rate and time left."""

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Literal, TypeVar

T = TypeVar("T")


class StepClock:
    """Time of one step: instruments and camera, settling, and overhead."""

    def __init__(self) -> None:
        self._began_s = time.monotonic()
        self.wire_s = 0.0  # Time spent in instruments, operator and camera, s
        self.settling_s = 0.0  # Settle time of the plan, s

    @contextmanager
    def timing(self, part: Literal["wire_s", "settling_s"]) -> Iterator[None]:
        """Add the time of the block to that of instruments and camera, or to the settle time."""
        began_s = time.monotonic()
        try:
            yield
        finally:
            setattr(self, part, getattr(self, part) + time.monotonic() - began_s)

    def waiting_for(self, frames: Iterable[T]) -> Iterator[T]:
        """Yield frames; the time until each arrives counts as time of the camera."""
        coming = iter(frames)
        while True:
            with self.timing("wire_s"):
                frame = next(coming, None)
            if frame is None:
                return
            yield frame

    @property
    def overhead_s(self) -> float:
        """Time so far outside instruments, camera and settling, s."""
        return time.monotonic() - self._began_s - self.wire_s - self.settling_s


class RunProgress:
    """Progress of a run of `frames`, `done` in earlier runs, with frame rate and time left."""

    def __init__(self, *, frames: int, done: int) -> None:
        self._frames, self._before = frames, done
        self.done = done  # Frames of the finished steps; a step stopped early counts completely
        self._began_s = time.monotonic()
        self._step_began_s: float | None = None

    def step_begins(self) -> None:
        """Begin a step; its frame rate counts from its first frame."""
        self._step_began_s = None

    def share(self, step_frames: int) -> float:
        """Return the completed fraction of the plan with `step_frames` frames of the present step,
        0..1.
        """
        return min(1.0, (self.done + step_frames) / self._frames)

    def words(self, step_frames: int) -> str:
        """Return frame rate and time left; empty while unknown.

        `step_frames`: frames of the present step.
        """
        now_s = time.monotonic()
        if step_frames and self._step_began_s is None:
            self._step_began_s, self._first = now_s, step_frames
        if self._step_began_s is None or now_s <= self._step_began_s or step_frames <= self._first:
            return ""
        rate_hz = (step_frames - self._first) / (now_s - self._step_began_s)
        now_done = self.done + step_frames
        left_s = (now_s - self._began_s) / (now_done - self._before) * (self._frames - now_done)
        return f", {rate_hz:.1f} frames/s, {duration(max(0.0, left_s))} left"


def duration(seconds: float) -> str:
    """Return a time in two units: "2 h 5 min", "3 min 20 s", "12 s"."""
    whole_seconds = round(seconds)
    hours, minutes = whole_seconds // 3600, whole_seconds % 3600 // 60
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {whole_seconds % 60} s" if minutes else f"{whole_seconds} s"
