"""Run time of a measurement without numba's compilation.

Excluded is all that numba does once per process: compilation (half a minute on a fresh machine),
loading of cached functions (0.4 s for an edge) and waiting for another thread's compilation. Other
work of a first call is included, such as importing parts of SciPy (0.3 s).
"""

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from functools import cache, wraps
from time import perf_counter
from typing import TYPE_CHECKING, Any, ParamSpec

if TYPE_CHECKING:
    from labdata.measurement import Result

Arguments = ParamSpec("Arguments")

# numba holds its lock while it compiles, loads or saves; it compiles only what it could not load.
LOCKED, COMPILES = "numba:compiler_lock", "numba:compile"
# Compilation longer than this is announced, s.
LONG_S = 2.0
UNITS = (("ms", 1e-3), ("s", 1.0), ("min", 60.0), ("h", 3600.0))


class Stopwatch:
    """Elapsed time less numba's compilation time in this thread."""

    def __init__(self) -> None:
        # Without numba there is nothing to count.
        if "numba" in sys.modules:
            _listen()
        self._begun_s = perf_counter() - _HERE.seconds()

    def seconds(self) -> float:
        """Return the seconds since construction without compilation."""
        return perf_counter() - _HERE.seconds() - self._begun_s


def with_timing(
    function: "Callable[Arguments, Result]",
    inside: Callable[[], AbstractContextManager[Any]] = nullcontext,
) -> "Callable[Arguments, Result]":
    """Return a function that records its run time, without compilation, in each of its
    measurements.

    A measurement that already has a time keeps it: an inner timed call made it. `inside`: context
    of each call.
    """

    @wraps(function)
    def timing(*args: Arguments.args, **kwargs: Arguments.kwargs) -> "Result":
        watch = Stopwatch()
        with inside():
            result = function(*args, **kwargs)
        seconds = watch.seconds()
        measurements = (
            m if m.seconds is not None else m.with_(seconds=seconds) for m in result.measurements
        )
        return replace(result, measurements=tuple(measurements))

    return timing


def time_text(seconds: float) -> str:
    """Return a time with two significant digits in the unit that fits it: "9.4 ms", "0.45 s", "12
    s", "2.1 min".
    """
    name, unit = next((scale for scale in UNITS if seconds < 99.5 * scale[1]), UNITS[-1])
    return f"{seconds / unit:.2g} {name}"


class _Here(threading.local):
    """Compilation by numba in this thread."""

    depth: int = 0
    since_s: float = 0.0
    before_s: float = 0.0

    def seconds(self) -> float:
        """Return the seconds of compilation in this thread so far."""
        return self.before_s + (perf_counter() - self.since_s if self.depth else 0.0)


_HERE = _Here()
# Called at the start of each compiled function.
_ANNOUNCERS: list[Callable[[], None]] = []


@contextmanager
def announce_compilation(say: Callable[[str], None]) -> Iterator[None]:
    """Announce a long compilation within this block once, and the number of compiled functions at
    its end.
    """
    Stopwatch()
    before_s, functions, said = _HERE.seconds(), 0, False

    def begin() -> None:
        nonlocal functions, said
        functions += 1
        if not said and _HERE.seconds() - before_s > LONG_S:
            said = True
            say("compiling once on this machine, up to a minute; the next call finds it on disk")

    _ANNOUNCERS.append(begin)
    try:
        yield
    finally:
        _ANNOUNCERS.remove(begin)
        if said:
            say(f"compiled {functions} functions in {time_text(_HERE.seconds() - before_s)}")


@cache
def _listen() -> None:
    from numba.core import event

    class Listener(event.Listener):
        """Adds up the time between the first of numba's nested events and its end, per thread."""

        def on_start(self, event: event.Event) -> None:
            if _HERE.depth == 0:
                _HERE.since_s = perf_counter()
            _HERE.depth += 1
            if event.kind == COMPILES:
                for announcer in _ANNOUNCERS:
                    announcer()

        def on_end(self, event: event.Event) -> None:
            # An event that started before registration ends without a start.
            if _HERE.depth == 1:
                _HERE.before_s = _HERE.seconds()
            _HERE.depth = max(_HERE.depth - 1, 0)

    listener = Listener()
    for kind in (LOCKED, COMPILES):
        event.register(kind, listener)
