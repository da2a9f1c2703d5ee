"""A measurement's time is that of the call that made it, refused or not; what numba compiles in it
is not counted.
"""

import threading
import time
from collections.abc import Callable, Iterator

import pytest
from numba import njit
from numba.core import event

from charact.method import METHODS, Context, register, stopwatch
from charact.method.stopwatch import Stopwatch, announce_compilation, time_text, with_timing
from labdata import Result, make_measurement, make_refusal

KIND = "kind of this test"
# What a toy works besides compiling, and how far its time may be from that on a busy machine, s.
WORKS_S, BUSY_S = 0.2, 0.1


@pytest.fixture
def registered() -> Iterator[Callable]:
    """Return what registers a function as a method for this test alone."""

    def enter(function: Callable[..., Result]) -> Callable[..., Result]:
        register(KIND, "toy", quantities=("mtf50",), scope="Holds in this test.")(function)
        return METHODS[KIND, "toy"].function

    yield enter
    METHODS.pop((KIND, "toy"), None)


def both(**fields) -> Result:
    """One measurement with a number, one without."""
    number = make_measurement("mtf50", "cy/px", 0.2, None, None, method="toy", **fields)
    return Result(
        measurements=(
            number,
            make_refusal("mtf10", "cy/px", "nothing there", method="toy", **fields),
        )
    )


def fresh() -> Callable[[float], float]:
    """A function that numba must compile, with another that it calls: one compiles while the other
    does.
    """

    @njit
    def inner(x: float) -> float:
        total = 0.0
        for k in range(100):
            total += x**k
        return total

    @njit
    def outer(x: float) -> float:
        return inner(x) + inner(2.0 * x)

    return outer


def working(function: Callable[[float], float]) -> Callable[..., Result]:
    """A method that calls a function and works for a known time."""

    def toy(*, context: Context | None = None) -> Result:
        function(0.5)
        time.sleep(WORKS_S)
        return both()

    return toy


def of_call(method: Callable[..., Result], **asked) -> tuple[float, float]:
    """Seconds that all measurements of a call state, and those of the wall."""
    began = time.perf_counter()
    stated = {m.seconds for m in method(**asked).measurements}
    wall = time.perf_counter() - began
    (seconds,) = stated
    return seconds, wall


def test_compiling_is_no_part_of_the_time(registered):
    toy = registered(working(fresh()))
    compiled: list[float] = []
    with event.install_timer("numba:compile", compiled.append):
        first, wall = of_call(toy)
    again, _ = of_call(toy)
    assert compiled[0] > 0.05  # else there is nothing to tell
    assert first <= wall - compiled[0]
    # Compiling the inner function within the outer is not taken out twice.
    assert first >= WORKS_S
    assert first == pytest.approx(again, abs=BUSY_S)


def test_what_another_thread_compiles_is_no_part_of_this_one():
    thread = threading.Thread(target=fresh(), args=(0.5,))
    watch, began = Stopwatch(), time.perf_counter()
    thread.start()
    thread.join()
    seconds, wall = watch.seconds(), time.perf_counter() - began
    assert seconds == pytest.approx(wall, abs=1e-3)


def test_a_measurement_that_states_its_time_keeps_it():
    inner = with_timing(lambda: both(seconds=7.0))
    result = with_timing(lambda: inner() + both())()
    assert [m.seconds for m in result.measurements[:2]] == [7.0, 7.0]
    assert all(0.0 <= m.seconds < 1.0 for m in result.measurements[2:])


def test_long_compiling_is_announced_once_and_counted(monkeypatch):
    monkeypatch.setattr(stopwatch, "LONG_S", 0.0)
    said: list[str] = []
    with announce_compilation(said.append):
        fresh()(0.5)
        fresh()(0.5)
    assert said[0].startswith("compiling once on this machine")
    assert said[1].startswith("compiled 4 functions in ")
    assert len(said) == 2
    monkeypatch.setattr(stopwatch, "LONG_S", 60.0)
    with announce_compilation(said.append):
        fresh()(0.5)
    assert len(said) == 2


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.00712, "7.1 ms"),
        (0.0994, "99 ms"),
        (0.0996, "0.1 s"),
        (0.4512, "0.45 s"),
        (12.34, "12 s"),
        (99.6, "1.7 min"),
        (5400.0, "90 min"),
        (36000.0, "10 h"),
    ],
)
def test_a_time_has_two_digits_and_the_unit_that_fits(seconds: float, text: str):
    assert time_text(seconds) == text
