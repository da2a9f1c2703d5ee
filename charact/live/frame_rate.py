"""Frames per second by the camera's own count: the numbers of its frames over its own time stamps."""

from collections import deque

from labdata.capture import Frame

OVER_S = 2.0


class FrameRate:
    """The rate over the last two seconds; frames that were not looked at count by their numbers."""

    def __init__(self) -> None:
        self._seen: deque[tuple[int, float]] = deque()

    def after(self, frame: Frame) -> float | None:
        """Return the rate after a further frame, Hz; None until two frames of one run were seen."""
        if self._seen and (frame.number <= self._seen[-1][0] or frame.time_s <= self._seen[-1][1]):
            self._seen.clear()
        self._seen.append((frame.number, frame.time_s))
        while len(self._seen) > 2 and frame.time_s - self._seen[0][1] > OVER_S:
            self._seen.popleft()
        (first, began_s), (last, ended_s) = self._seen[0], self._seen[-1]
        return (last - first) / (ended_s - began_s) if last > first else None
