"""How fast a run goes: where the time of each step went, frames a second, and the time left."""

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

T = TypeVar("T")


class StepClock:
    """Where the time of one step goes: on the wires and at the camera, into settling, and what is left, our own."""

    def __init__(self) -> None:
        self._began_s = time.monotonic()
        self.wire_s = 0.0
        """Time that instruments, operator and camera took, s."""
        self.settling_s = 0.0
        """Time that the plan asked to wait, s."""

    @contextmanager
    def wire(self) -> Iterator[None]:
        """Time on the wire."""
        began_s = time.monotonic()
        try:
            yield
        finally:
            self.wire_s += time.monotonic() - began_s

    @contextmanager
    def settling(self) -> Iterator[None]:
        """Time of settling."""
        began_s = time.monotonic()
        try:
            yield
        finally:
            self.settling_s += time.monotonic() - began_s

    def waiting_for(self, frames: Iterable[T]) -> Iterator[T]:
        """Hand frames on; the time that each took to come is time on the wire."""
        coming = iter(frames)
        while True:
            with self.wire():
                frame = next(coming, None)
            if frame is None:
                return
            yield frame

    @property
    def overhead_s(self) -> float:
        """Time so far that was neither on the wire nor settling, s."""
        return time.monotonic() - self._began_s - self.wire_s - self.settling_s


class RunProgress:
    """Frames done of all frames of a run, and how long the others will take at the pace so far.

    Parameters
    ----------
    frames
        Frames of the whole plan.
    done
        Frames of the steps that were finished before.
    """

    def __init__(self, *, frames: int, done: int) -> None:
        self._frames, self._before = frames, done
        self.done = done
        """Frames of the finished steps; one that was stopped early counts as whole."""
        self._began_s = time.monotonic()
        self._step_began_s: float | None = None

    def step_begins(self) -> None:
        """A new step: its rate counts from its first frame."""
        self._step_began_s = None

    def share(self, taken: int) -> float:
        """Share of the plan done with `taken` frames of the present step, 0..1."""
        return min(1.0, (self.done + taken) / self._frames)

    def words(self, taken: int) -> str:
        """Rate and time left with `taken` frames of the present step; empty while nothing is known."""
        now_s = time.monotonic()
        if taken and self._step_began_s is None:
            self._step_began_s, self._first = now_s, taken
        if self._step_began_s is None or now_s <= self._step_began_s or taken <= self._first:
            return ""
        rate_hz = (taken - self._first) / (now_s - self._step_began_s)
        now_done = self.done + taken
        left_s = (now_s - self._began_s) / (now_done - self._before) * (self._frames - now_done)
        return f", {rate_hz:.1f} frames/s, {duration(max(0.0, left_s))} left"


def duration(seconds: float) -> str:
    """Return a time in the two units that a person would name: "2 h 5 min", "3 min 20 s", "12 s"."""
    whole = round(seconds)
    hours, minutes = whole // 3600, whole % 3600 // 60
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {whole % 60} s" if minutes else f"{whole} s"
