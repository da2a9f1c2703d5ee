"""One line of a benchmark: our time, what it is held against, and the ratio."""

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Row:
    """A timing.

    Parameters
    ----------
    name
        What was timed.
    seconds
        Our best time, s.
    peer, peer_seconds
        What does the same work, and its best time in this run, s.
    limit_seconds
        The time promised, s, or None.
    """

    name: str
    seconds: float
    peer: str
    peer_seconds: float
    limit_seconds: float | None = None

    @property
    def kept(self) -> bool:
        """Whether the promise holds."""
        return self.limit_seconds is None or self.seconds <= self.limit_seconds

    def text(self) -> str:
        """One line for people."""
        promise = (
            ""
            if self.limit_seconds is None
            else f"   promised {self.limit_seconds:g} s: {'kept' if self.kept else 'BROKEN'}"
        )
        ratio = self.peer_seconds / self.seconds
        against = f"{ratio:6.2f} x as fast as {self.peer} ({self.peer_seconds:.4f} s)"
        return f"{self.name:42} {self.seconds:8.4f} s   {against}{promise}"


def best_seconds(work: Callable[[], object], repeats: int = 5) -> float:
    """The shortest of several timings, s: the least disturbed by other work on the machine."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)
