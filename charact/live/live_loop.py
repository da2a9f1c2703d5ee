"""Live loop: measures frames as they arrive and publishes the newest view."""

import threading
import time
from collections import deque
from dataclasses import replace
from typing import Self

from charact.estimators.mtf.mean_frame import Region
from charact.live.focus import BestFocus, FocusReader
from charact.live.frame_source import FrameSource, SourceFrame
from charact.live.live_view import LiveView, measure_frame, render_preview
from drivers.errors import BenchError
from labdata import BadInput, Frame

CLOSED = "the live view was closed"


class LatestView:
    """The newest view, written by one thread and read by any number without delaying it."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._view: LiveView | None = None
        self._ended: str | None = None

    @property
    def view(self) -> LiveView | None:
        """The newest view; None before the first."""
        return self._view

    @property
    def end_reason(self) -> str | None:
        """Why the views ended; None while more may come."""
        return self._ended

    def publish(self, view: LiveView) -> None:
        """Replace the view by a newer one."""
        with self._changed:
            self._view = view
            self._changed.notify_all()

    def end(self, why: str) -> None:
        """End the views with a reason."""
        with self._changed:
            self._ended = why
            self._changed.notify_all()

    def after(self, number: int, *, timeout_s: float) -> LiveView | None:
        """Wait for a view with a number above `number`; None after the time-out or when the views
        ended.
        """
        with self._changed:
            self._changed.wait_for(
                lambda: self._is_after(number) or self._ended is not None, timeout=timeout_s
            )
            return self._view if self._is_after(number) else None

    def _is_after(self, number: int) -> bool:
        return self._view is not None and self._view.number > number


class FrameRate:
    """Frame rate over the last two seconds, from the camera's frame numbers and time stamps."""

    def __init__(self) -> None:
        self._seen: deque[tuple[int, float]] = deque()

    def after(self, frame: Frame) -> float | None:
        """Return the rate after a further frame, Hz; None before two frames of one capture."""
        if self._seen and (frame.number <= self._seen[-1][0] or frame.time_s <= self._seen[-1][1]):
            self._seen.clear()
        self._seen.append((frame.number, frame.time_s))
        while len(self._seen) > 2 and frame.time_s - self._seen[0][1] > 2.0:
            self._seen.popleft()
        (first, began_s), (last, ended_s) = self._seen[0], self._seen[-1]
        return (last - first) / (ended_s - began_s) if last > first else None


class LiveLoop:
    """Measures the frames of a source in a thread, within a `with` block.

    `region`: ROW, COL, HEIGHT, WIDTH of mean and noise; None: the whole frame.
    """

    def __init__(
        self, source: FrameSource, *, focus: FocusReader | None = None, region: Region | None = None
    ) -> None:
        self._source, self._focus, self._region = source, focus, region
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="bench", daemon=True)
        self._rate = FrameRate()
        self._before: SourceFrame | None = None
        self._number, self._due_s = 0, 0.0
        self.newest = LatestView()
        """The newest view."""

    def __enter__(self) -> Self:
        self._source.while_waiting = self._require_open
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(20.0)

    def _require_open(self) -> None:
        if self._stop.is_set():
            raise BadInput(CLOSED)

    @property
    def source(self) -> FrameSource:
        """The frame source."""
        return self._source

    def forget_best(self) -> None:
        """Forget the best focus."""
        if self._focus is not None:
            self._focus.forget_best()

    def _run(self) -> None:
        try:
            for source_frame in self._source:
                if self._stop.is_set():
                    self.newest.end(CLOSED)
                    return
                if source_frame is not None:
                    self._take_in(source_frame)
                else:
                    self._renew_focus()
            self.newest.end(f"{self._source.name} has no more frames")
        except (BadInput, BenchError, OSError) as error:
            self.newest.end(str(error))
        except BaseException as error:
            self.newest.end(f"the program failed: {error!r}")
            raise

    def _take_in(self, source_frame: SourceFrame) -> None:
        rate_hz = self._rate.after(source_frame.frame)
        before, self._before = self._before, source_frame
        now_s = time.monotonic()
        if now_s < self._due_s:
            return
        # Shortest interval between two views, s; frames in between are read but not measured.
        self._due_s = max(self._due_s + 1.0 / 30.0, now_s)
        pixels, previous = source_frame.frame.pixels, None
        if (
            before is not None
            and before.of == source_frame.of
            and before.frame.pixels.shape == pixels.shape
        ):
            previous = before.frame.pixels
        if self._focus is not None:
            self._focus.look_at(pixels)
        meters = measure_frame(
            pixels, previous, full_scale_dn=source_frame.full_scale_dn, region=self._region
        )
        self._number += 1
        self.newest.publish(
            LiveView(
                number=self._number,
                source_frame=source_frame,
                statistics=meters,
                frame_rate_hz=rate_hz,
                region=self._region,
                preview=render_preview(pixels, meters, full_scale_dn=source_frame.full_scale_dn),
                focus=self._focus.newest if self._focus else None,
                best=self._focus.best if self._focus else BestFocus(),
            )
        )

    def _renew_focus(self) -> None:
        """Publish a focus reading that was completed after its frame."""
        view = self.newest.view
        if view is not None and self._focus is not None and self._focus.take_up():
            self._number += 1
            self.newest.publish(
                replace(view, number=self._number, focus=self._focus.newest, best=self._focus.best)
            )
