"""What every instrument must do: say who it is, and tell of every failure of its line in time."""

import contextlib
import time
from typing import Any

from drivers.errors import BenchError, BenchStopped, InstrumentDisconnected, InstrumentTimeout
from drivers.instruments.conformance.conformance_pair import ConformancePair, Rule, must_raise
from drivers.serial_lines.port import ANSWER_S

PATIENCE_S = 1.0


def says_who_it_is(pair: ConformancePair) -> None:
    """It says who it is, twice the same."""
    driver = pair.driver()
    assert driver.identify() == driver.identify() != ""


def silence_is_told_in_time(pair: ConformancePair) -> None:
    """An instrument that says nothing is InstrumentTimeout within its answer time and a second."""
    driver = pair.driver()
    identity = driver.identify()
    pair.suffer("silent")
    began_s = time.monotonic()
    must_raise(InstrumentTimeout, lambda: _probe(pair, driver))
    assert time.monotonic() - began_s < ANSWER_S + PATIENCE_S
    pair.heal()
    assert driver.identify() == identity


def half_lines_are_no_answers(pair: ConformancePair) -> None:
    """Half an answer is an error, and the line is in step afterwards."""
    _suffers_and_recovers(pair, "half-lines")


def garbage_is_no_answer(pair: ConformancePair) -> None:
    """Characters that are no answer are an error, and the line is in step afterwards."""
    _suffers_and_recovers(pair, "garbage")


def a_late_answer_is_not_taken_for_the_next(pair: ConformancePair) -> None:
    """An answer that comes late is not taken for the answer to the next question."""
    driver = pair.driver()
    identity = driver.identify()
    pair.suffer("late")
    with contextlib.suppress(BenchError):
        _probe(pair, driver)
    pair.heal()
    assert driver.identify() == identity


def an_answer_left_due_is_not_taken_by_who_opens_the_line_next(pair: ConformancePair) -> None:
    """An answer that comes late is not taken by the next program for its own, whatever that asks first."""
    driver = pair.driver()
    identity = driver.identify()
    pair.suffer("late")
    with contextlib.suppress(BenchError):
        _probe(pair, driver)
    pair.heal()
    driver = pair.driver()
    assert driver.identify() == identity
    _probe(pair, driver)


def a_pulled_plug_is_told_and_put_back(pair: ConformancePair) -> None:
    """A pulled plug is InstrumentDisconnected; with the plug back in, the line works once reopened, and a new one."""
    driver = pair.driver()
    identity = driver.identify()
    pair.suffer("unplugged")
    must_raise(InstrumentDisconnected, lambda: _probe(pair, driver))
    must_raise(InstrumentDisconnected, driver.line.reopen)
    pair.heal()
    driver.line.reopen()
    assert driver.identify() == identity
    assert pair.driver().identify() == identity


def a_line_that_was_taken_over_obeys_the_safe_action_alone(pair: ConformancePair) -> None:
    """A line that the safe action has taken over obeys it alone, until it is released."""
    driver = pair.driver()
    identity = driver.identify()
    driver.line.take_over()
    must_raise(BenchStopped, driver.identify)
    with driver.line.safing():
        assert driver.identify() == identity
    must_raise(BenchStopped, driver.identify)
    driver.line.release()
    assert driver.identify() == identity


def a_loss_of_power_leaves_it_at_rest(pair: ConformancePair) -> None:
    """After a loss of power the line works again, and nothing is on that was not on before."""
    driver = pair.driver()
    identity = driver.identify()
    before = dict(pair.outputs())
    pair.suffer("power-cycle")
    time.sleep(0.1)
    pair.heal()
    assert pair.driver().identify() == identity
    now = pair.outputs()
    assert {name: now[name] for name in before if name != "sensors_lit"} == {
        name: before[name] for name in before if name != "sensors_lit"
    }


COMMON: tuple[Rule, ...] = (
    says_who_it_is,
    silence_is_told_in_time,
    half_lines_are_no_answers,
    garbage_is_no_answer,
    a_late_answer_is_not_taken_for_the_next,
    an_answer_left_due_is_not_taken_by_who_opens_the_line_next,
    a_pulled_plug_is_told_and_put_back,
    a_line_that_was_taken_over_obeys_the_safe_action_alone,
    a_loss_of_power_leaves_it_at_rest,
)


def _probe(pair: ConformancePair, driver: Any) -> None:
    """One question that changes nothing; a supply at rest is not asked whether it is on."""
    driver.measured_v() if pair.model.role == "supply" else driver.look()


def _suffers_and_recovers(pair: ConformancePair, wrong: str) -> None:
    driver = pair.driver()
    identity = driver.identify()
    pair.suffer(wrong)
    must_raise(BenchError, lambda: _probe(pair, driver))
    pair.heal()
    assert driver.identify() == identity
    _probe(pair, driver)
