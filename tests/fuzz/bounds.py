"""Bounds on whoever reads bytes from outside: a time after which it hangs, and memory that it may
not ask for.
"""

import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

LONGEST_S = 10.0
"""What takes longer hangs, s of the processor: a busy machine may take longer."""

MOST_BYTES = 4 << 30
"""Address space that a process which reads may take, bytes."""

MOST_GROWTH_MB = 300.0
"""Memory by which a process may grow over one small file or answer, MB."""


class TookTooLong(BaseException):
    """No reader takes this one for a damaged file."""


@contextmanager
def in_time(longest_s: float = LONGEST_S) -> Iterator[None]:
    """Raise TookTooLong in what takes longer, s of the processor."""

    def late(*_: Any) -> None:
        raise TookTooLong(f"what is read must be read within {longest_s:g} s")

    before = signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, longest_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def limit_memory() -> None:
    """Let this process ask for no more memory than is reasonable; what asks for more gets a
    MemoryError.
    """
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, hard))


def most_resident_mb() -> float:
    """Return the most memory that this process ever had in use, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6


def require_little(grown_mb: float) -> None:
    """Refuse growth of the most memory ever in use, MB that no small file explains."""
    if grown_mb > MOST_GROWTH_MB:
        raise MemoryError(
            f"a small file must be read in {MOST_GROWTH_MB:g} MB, got {grown_mb:.0f} MB more"
        )
