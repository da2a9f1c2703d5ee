"""What every instrument must do: say who it is, and report every failure of its line in time."""

import contextlib
import time
from typing import Any

from drivers.errors import BenchError, BenchStopped, InstrumentDisconnected, InstrumentTimeout
from drivers.instruments.conformance.conformance_pair import ConformancePair, must_raise, rule_of
from drivers.serial_lines.port import ANSWER_S

PATIENCE_S = 1.0


@rule_of(None)
def says_who_it_is(pair: ConformancePair) -> None:
    """It says who it is, twice the same."""
    driver, identity = _new_driver(pair)
    assert driver.identify() == identity != ""


@rule_of(None)
def silence_is_reported_in_time(pair: ConformancePair) -> None:
    """An instrument that says nothing is InstrumentTimeout within its answer time and a second."""
    driver, identity = _new_driver(pair)
    pair.suffer("silent")
    began_s = time.monotonic()
    must_raise(InstrumentTimeout, lambda: _probe(pair, driver))
    assert time.monotonic() - began_s < ANSWER_S + PATIENCE_S
    pair.heal()
    assert driver.identify() == identity


@rule_of(None)
def half_lines_and_garbage_are_no_answers(pair: ConformancePair) -> None:
    """Half an answer, or characters that are none, is an error, and the line is in step afterwards."""
    driver, identity = _new_driver(pair)
    for wrong in ("half-lines", "garbage"):
        pair.suffer(wrong)
        must_raise(BenchError, lambda: _probe(pair, driver))
        pair.heal()
        assert driver.identify() == identity
        _probe(pair, driver)


@rule_of(None)
def a_late_answer_is_not_taken_for_the_next(pair: ConformancePair) -> None:
    """An answer that comes late is taken for no other, neither by this program nor by the next that opens the line."""
    for is_reopened in (False, True):
        driver, identity = _new_driver(pair)
        pair.suffer("late")
        with contextlib.suppress(BenchError):
            _probe(pair, driver)
        pair.heal()
        driver = pair.driver() if is_reopened else driver
        assert driver.identify() == identity
        _probe(pair, driver)


@rule_of(None)
def a_pulled_plug_is_reported_and_put_back(pair: ConformancePair) -> None:
    """A pulled plug is InstrumentDisconnected; with the plug back in, the line works once reopened, and a new one."""
    driver, identity = _new_driver(pair)
    pair.suffer("unplugged")
    must_raise(InstrumentDisconnected, lambda: _probe(pair, driver))
    must_raise(InstrumentDisconnected, driver.line.reopen)
    pair.heal()
    driver.line.reopen()
    assert driver.identify() == identity
    assert pair.driver().identify() == identity


@rule_of(None)
def a_line_that_was_taken_over_obeys_the_safe_action_alone(pair: ConformancePair) -> None:
    """A line that the safe action has taken over obeys it alone, until it is released."""
    driver, identity = _new_driver(pair)
    driver.line.take_over()
    must_raise(BenchStopped, driver.identify)
    with driver.line.safing():
        assert driver.identify() == identity
    must_raise(BenchStopped, driver.identify)
    driver.line.release()
    assert driver.identify() == identity


@rule_of(None)
def a_loss_of_power_leaves_it_at_rest(pair: ConformancePair) -> None:
    """After a loss of power the line works again, and nothing is on that was not on before."""
    _, identity = _new_driver(pair)
    before = dict(pair.outputs())
    pair.suffer("power-cycle")
    time.sleep(0.1)
    pair.heal()
    assert pair.driver().identify() == identity
    now = pair.outputs()
    assert all(now[name] == before[name] for name in before if name != "sensors_lit")


def _new_driver(pair: ConformancePair) -> tuple[Any, str]:
    """Return a driver on a new line, and the identity of its instrument."""
    driver = pair.driver()
    return driver, driver.identify()


def _probe(pair: ConformancePair, driver: Any) -> None:
    """One question that changes nothing; a supply at rest is not asked whether it is on."""
    driver.read_voltage_v() if pair.model.role == "supply" else driver.look()
