"""Complete frames from camera buffers; incomplete ones are counted with their reason."""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Self

from drivers.errors import CameraError
from labdata import BadInput, Frame, LostFrames, losses_before

POLL_S = 0.05  # Longest wait between two calls of `while_waiting`, s; half of the guaranteed 0.1 s


@dataclass(frozen=True, kw_only=True)
class IncompleteFrame:
    """An incomplete frame: its number, if known, and its fault."""

    number: int | None
    fault: str


class RunningNumbers:
    """Frame numbers that continue when a camera's counter of length `cycle` wraps; a longer one
    does not.
    """

    def __init__(self, cycle: int) -> None:
        self._cycle = cycle
        self._counted: int | None = None
        self._number = 0

    def running(self, counted: int) -> int:
        """Return the running number of a frame; the first is unchanged."""
        step = counted if self._counted is None else counted - self._counted
        if (
            self._counted is not None
            and max(counted, self._counted) <= self._cycle
            and abs(step) > self._cycle // 2
        ):
            # Negative step: the counter wrapped. Positive: a late frame of the cycle before.
            step += self._cycle if step < 0 else -self._cycle
        self._counted, self._number = counted, self._number + step
        return self._number


class FrameCapture:
    """A capture that runs in its `with` block; iterate it for `frames` complete frames after
    `discard` discarded ones.

    Subclasses implement start, stop and `_next_frame`, which waits for a frame and calls
    `while_waiting` at least every 0.1 s; an exception of it ends the capture. `patience_s` is the
    longest wait for a frame, s, and the longest time in which incomplete frames alone may come: the
    tube is at gain meanwhile, and nobody sees its light.
    """

    def __init__(
        self,
        *,
        frames: int,
        discard: int,
        while_waiting: Callable[[], None],
        identifier: str,
        patience_s: float = math.inf,
    ) -> None:
        if frames < 1 or discard < 0:
            raise BadInput(
                f"a capture must take at least 1 frame and discard 0 or more, got {frames} and "
                f"{discard}"
            )
        self._wanted, self._discard, self._identifier = frames, discard, identifier
        self._while_waiting, self._patience_s = while_waiting, patience_s
        self._expected: int | None = None
        self._faults: dict[int, str] = {}
        self._losses: tuple[LostFrames, ...] = ()

    @property
    def lost_frames(self) -> int:
        """Number of frames numbered by the camera since the first complete one and not complete."""
        return sum(map(len, self._losses))

    @property
    def losses(self) -> tuple[LostFrames, ...]:
        """The same frames with numbers and causes."""
        return self._losses

    def __enter__(self) -> Self:
        try:
            self._start()
        except BaseException:
            self._stop()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._stop()

    def __iter__(self) -> Iterator[Frame]:
        """Yield complete frames; CameraError if the camera is silent, gone or sends only incomplete
        frames.
        """
        complete = broken = 0
        broken_since_s: float | None = None
        while complete < self._discard + self._wanted:
            self._while_waiting()
            frame = self._next_frame()
            if (
                isinstance(frame, Frame)
                and self._expected is not None
                and frame.number < self._expected
            ):
                frame = IncompleteFrame(number=frame.number, fault="too late")
            if isinstance(frame, IncompleteFrame):
                broken += 1
                if frame.number is not None:
                    self._faults[frame.number] = frame.fault
                now_s = time.monotonic()
                broken_since_s = now_s if broken_since_s is None else broken_since_s
                if now_s - broken_since_s > self._patience_s:
                    raise CameraError(
                        f"camera {self._identifier} must send a whole frame within "
                        f"{self._patience_s:.2g} s, got {broken} broken ones (the last: "
                        f"{frame.fault}) after {complete} whole"
                    )
                continue
            broken, broken_since_s = 0, None
            self._count_lost(frame.number, is_returned=complete >= self._discard)
            complete += 1
            if complete > self._discard:
                yield frame

    def _count_lost(self, number: int, *, is_returned: bool) -> None:
        """Count the numbers missing since the last complete frame.

        Incomplete frames before the first complete one do not count: a receiver may get its full
        buffer only when a frame is already arriving, so that a busy machine receives the first one
        without it.
        """
        if is_returned and self._expected is not None:
            self._losses += losses_before(number, expected=self._expected, faults=self._faults)
        self._faults.clear()
        self._expected = number + 1

    def _start(self) -> None:
        """Start the camera."""

    def _stop(self) -> None:
        """Stop the camera, also after a failed start."""

    def _next_frame(self) -> Frame | IncompleteFrame:
        """Wait for the next frame, complete or not."""
        raise NotImplementedError
