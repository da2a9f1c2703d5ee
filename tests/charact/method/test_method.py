"""Methods: entry points of others, the clock of a measurement, and agreement within a tolerance."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from importlib.metadata import EntryPoint, EntryPoints
from types import ModuleType

import numpy as np
import pytest
from numba import njit
from numba.core import event

import charact
from charact.estimators import mtf
from charact.method import METHODS, Context, register, registry, stopwatch
from charact.method.registry import beyond_note, meets
from charact.method.stopwatch import Stopwatch, announce_compilation, time_text, with_timing
from labdata import Result, make_measurement, make_refusal, measurement_from_sd
from tests.truth import BarScene, EdgeScene, PointScene

# A method of another package is listed and used by its name.


@pytest.fixture
def package(monkeypatch: pytest.MonkeyPatch):
    """A package whose module registers the method "edge-theirs" when it is imported."""

    def install(module: str) -> None:
        point = EntryPoint(name="edge-theirs", value=module, group=registry.ENTRY_POINTS)
        monkeypatch.setattr(registry, "entry_points", lambda group: EntryPoints([point]))

    yield install
    METHODS.pop(("edge", "edge-theirs"), None)
    sys.modules.pop("their_package", None)


def test_a_method_of_another_package_is_listed_and_measures(package, monkeypatch):
    module = ModuleType("their_package")
    monkeypatch.setitem(sys.modules, "their_package", module)
    package("their_package")

    @register("edge", "edge-theirs", quantities=("mtf50",), scope="always 0.3")
    def measure(stack, *, region, context) -> Result:
        return Result(
            measurements=(measurement_from_sd("mtf50", "cy/px", 0.3, 0.01, method="edge-theirs"),)
        )

    assert "edge-theirs" in registry.methods_of_kind("edge")
    found = charact.mtf(np.zeros((40, 40)), roi=(0, 0, 40, 40), method="edge-theirs")
    assert found.mtf50.value == 0.3


def test_a_package_that_cannot_be_imported_is_one_sentence(package):
    package("no_such_package")
    with pytest.raises(charact.BadInput, match=r"edge-theirs.*must be importable"):
        charact.mtf(np.zeros((40, 40)), method="edge-theirs")


# A measurement's time is that of the call that made it, refused or not; what numba compiles in it
# is not counted.


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


# `auto` says where the tolerance that it was given may not be met: by the chart, or by a number's
# own interval.


QUICK = Context(quick=True)


def number(value, low, high, **fields):
    return make_measurement(
        "mtf50", "cy/px", value, (low, high), (low, high), method="fake", **fields
    )


def test_the_further_end_of_the_interval_is_what_counts():
    """0.2 is 1.5 % from its lower end and 3 % from its upper one."""
    found = number(0.2, 0.197, 0.206)
    assert beyond_note(found, 3.01) is None
    assert beyond_note(found, 2.0) == (
        "95 % interval extends 3 % from the value, beyond the tolerance `within_percent` 2 %."
    )
    assert beyond_note(make_refusal("mtf50", "cy/px", "nothing to see", method="fake"), 2.0) is None


def test_a_method_meets_a_tolerance_by_the_upper_limit_of_its_errors_where_the_chart_has_one():
    assert meets({"error_percent": 1.6}, 2.0)
    assert not meets({"error_percent": 1.6, "error_limit_percent": 2.4}, 2.0)
    assert meets({"error_percent": 1.6, "error_limit_percent": 1.9}, 2.0)


@pytest.mark.parametrize(
    ("kind", "scene", "target", "quantity"),
    [
        ("edge", EdgeScene(), {}, "mtf50"),
        (
            "bars",
            BarScene(),
            {"bars": BarScene().bars, "frequency_cy_per_px": BarScene().frequency_cy_per_px},
            "mtf",
        ),
        ("point", PointScene(), {}, "mtf50"),
    ],
)
def test_only_numbers_that_auto_was_to_measure_better_are_told(
    kind, scene, target, quantity, seed, monkeypatch
):
    """Asked for half and for twice as much as the interval reaches; a method that was named was
    asked for nothing.
    """
    rows = [
        {"method": name, "error_percent": 0.0, "seconds": 1.0}
        for name in registry.methods_of_kind(kind)
    ]
    monkeypatch.setattr(registry, "chart_table", lambda _: rows)
    stack = scene.frames_drawn(np.random.default_rng(seed))

    def notes(within_percent, method="auto"):
        found = mtf.measure(
            kind, stack, method=method, within_percent=within_percent, context=QUICK, **target
        )
        told = [
            m for m in found.measurements if any("`within_percent`" in note for note in m.notes)
        ]
        assert {m.quantity for m in told} <= {quantity}
        return found.find(quantity)[0], len(told)

    plain, none = notes(1000.0)
    reach = (
        100
        * max(plain.value - plain.interval95[0], plain.interval95[1] - plain.value)
        / plain.value
    )
    assert none == 0
    strict, told = notes(reach / 2)
    assert told >= 1
    assert f"{reach:.2g} % from the value" in strict.notes[-1]
    assert strict.flags == plain.flags
    assert notes(reach / 2, method=plain.method)[1] == 0
