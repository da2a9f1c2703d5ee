"""Conformance tests of every instrument, and the pair of driver and instrument they run on."""

import contextlib
import time
from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any, Protocol

from drivers.errors import BenchError, BenchStopped, InstrumentDisconnected, InstrumentTimeout
from drivers.instruments.instrument import InstrumentModel
from drivers.serial_lines.port import ANSWER_S
from labdata.instrument_config import Role

# Faults of a pair; a late reply comes 0.6 s after its time, "panel" changes a setting by hand
WRONGS = (
    "silent",
    "mute",
    "garbage",
    "half-lines",
    "late",
    "unplugged",
    "power-cycle",
    "trip",
    "panel",
)


class ConformancePair(Protocol):
    """A driver's model and an instrument to test it on, in the safe state when a rule begins."""

    @property
    def model(self) -> InstrumentModel:
        """The model."""
        ...

    def driver(self) -> Any:
        """Close the line, open a new one, and return a driver on it."""
        ...

    def outputs(self) -> Mapping[str, Any]:
        """Physical outputs of the instrument: gate_open, gate_ns, mcp_v, position, current_a,
        ...
        """
        ...

    def suffer(self, fault: str, setting: str = "") -> None:
        """Begin one of `WRONGS` and end all others.

        "panel" needs a setting: of a gate "source", "idle level", "width" or "busy" (every second
        trigger is lost), of a supply "voltage" or "on".
        """

    def heal(self) -> None:
        """End all faults, and clear a trip as at the instrument."""


Rule = Callable[[ConformancePair], None]
_RULES: dict[Role | None, list[Rule]] = {}


def rules_for(model: InstrumentModel) -> tuple[Rule, ...]:
    """Return the rules of a model: those of every instrument, and those of its role."""
    return (*_RULES[None], *_RULES[model.role])


def identify_driver(pair: ConformancePair) -> Any:
    """Return a driver with identified instrument."""
    driver = pair.driver()
    driver.identify()
    return driver


def rule_of(
    role: Role | None, prepare: Callable[[ConformancePair], Any] = identify_driver
) -> Callable[[Callable[[ConformancePair, Any], None]], Rule]:
    """Register a rule for a role; None: for every instrument. It begins with the driver that
    `prepare` returns.
    """

    def enter(rule: Callable[[ConformancePair, Any], None]) -> Rule:
        @wraps(rule)
        def prepared(pair: ConformancePair) -> None:
            rule(pair, prepare(pair))

        _RULES.setdefault(role, []).append(prepared)
        return prepared

    return enter


def must_raise(kind: type[Exception], action: Callable[[], object]) -> None:
    """Require that an action raises an error of a kind."""
    try:
        result = action()
    except kind:
        return
    raise AssertionError(f"it must end in {kind.__name__}, got {result!r}")


def wait_for(condition: Callable[[], bool], within_s: float = 5.0) -> None:
    """Wait until a condition is true."""
    deadline_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline_s, f"the outputs must follow within {within_s:g} s"
        time.sleep(0.01)


def discard_log(step: str, **details: object) -> None:
    """Discard a step of the safe action."""


PATIENCE_S = 1.0


@rule_of(None)
def says_who_it_is(pair: ConformancePair, driver: Any) -> None:
    """It says who it is, twice the same."""
    identity = driver.identify()
    assert driver.identify() == identity != ""


@rule_of(None)
def silence_is_reported_in_time(pair: ConformancePair, driver: Any) -> None:
    """An instrument that says nothing is InstrumentTimeout within its answer time and a second."""
    identity = driver.identify()
    pair.suffer("silent")
    began_s = time.monotonic()
    must_raise(InstrumentTimeout, lambda: _probe(pair, driver))
    assert time.monotonic() - began_s < ANSWER_S + PATIENCE_S
    pair.heal()
    assert driver.identify() == identity


@rule_of(None)
def half_lines_and_garbage_are_no_answers(pair: ConformancePair, driver: Any) -> None:
    """Half an answer, or characters that are none, is an error, and the line is in step
    afterwards.
    """
    identity = driver.identify()
    for fault in ("half-lines", "garbage"):
        pair.suffer(fault)
        must_raise(BenchError, lambda: _probe(pair, driver))
        pair.heal()
        assert driver.identify() == identity
        _probe(pair, driver)


@rule_of(None)
def a_late_answer_is_not_taken_for_the_next(pair: ConformancePair, driver: Any) -> None:
    """An answer that comes late is taken for no other, neither by this program nor by the next that
    opens the line.
    """
    for is_reopened in (False, True):
        identity = driver.identify()
        pair.suffer("late")
        with contextlib.suppress(BenchError):
            _probe(pair, driver)
        pair.heal()
        driver = pair.driver() if is_reopened else driver
        assert driver.identify() == identity
        _probe(pair, driver)


@rule_of(None)
def a_pulled_plug_is_reported_and_put_back(pair: ConformancePair, driver: Any) -> None:
    """A pulled plug is InstrumentDisconnected; with the plug back in, the line works once reopened,
    and a new one.
    """
    identity = driver.identify()
    pair.suffer("unplugged")
    must_raise(InstrumentDisconnected, lambda: _probe(pair, driver))
    must_raise(InstrumentDisconnected, driver.line.reopen)
    pair.heal()
    driver.line.reopen()
    assert driver.identify() == identity
    assert pair.driver().identify() == identity


@rule_of(None)
def a_line_that_was_taken_over_obeys_the_safe_action_alone(
    pair: ConformancePair, driver: Any
) -> None:
    """A line that the safe action has taken over obeys it alone, until it is released."""
    identity = driver.identify()
    driver.line.take_over()
    must_raise(BenchStopped, driver.identify)
    with driver.line.safing():
        assert driver.identify() == identity
    must_raise(BenchStopped, driver.identify)
    driver.line.release()
    assert driver.identify() == identity


@rule_of(None)
def a_loss_of_power_leaves_it_at_rest(pair: ConformancePair, driver: Any) -> None:
    """After a loss of power the line works again, and nothing is on that was not on before."""
    identity = driver.identify()
    before = dict(pair.outputs())
    pair.suffer("power-cycle")
    time.sleep(0.1)
    pair.heal()
    assert pair.driver().identify() == identity
    now = pair.outputs()
    assert all(now[name] == before[name] for name in before if name != "sensors_lit")


def _probe(pair: ConformancePair, driver: Any) -> None:
    """Send a query without side effect; a supply that is off has no on state to check."""
    driver.read_voltage_v() if pair.model.role == "supply" else driver.look()
