"""What every driver must do with its instrument: the rules that each pair of driver and instrument is tried against.

A rule is a function of a `Pair`; it returns when the pair keeps it and raises AssertionError, or whatever the driver
raises wrongly, when it does not. `rules_for` returns those of a model, so that the maker of a new driver can run them
in a test of their own, or by the command `charact conform MODEL`.
"""

import contextlib
import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from drivers.errors import BenchError, InstrumentLost, InstrumentRefused, InstrumentSilent, InstrumentTripped
from drivers.instruments.models import Model
from drivers.instruments.voltage import DISCHARGED_V
from drivers.tube.safe import make_safe
from drivers.wire.port import ANSWER_S
from labdata.errors import BadInput

WRONGS = ("silent", "mute", "garbage", "half-lines", "late", "unplugged", "power-cycle", "trip")
"""What a pair can be made to suffer; a late answer comes 0.6 s after its time."""

PATIENCE_S = 1.0
_RATE_HZ, _WIDTH_NS, _LIMIT_V, _LIMIT_A = 60.0, 1e6, 900.0, 0.5


class Pair(Protocol):
    """A driver's model and an instrument that it can be tried on, at rest when a rule begins."""

    @property
    def model(self) -> Model:
        """The model."""
        ...

    def driver(self) -> Any:
        """Open the line anew, after closing the one before, and return a driver on it."""
        ...

    def outputs(self) -> Mapping[str, Any]:
        """What the instrument puts out now, beside its line: gate_open, gate_ns, mcp_v, position, current_a, ..."""
        ...

    def suffer(self, wrong: str) -> None:
        """Begin one of `WRONGS`, all others ended."""
        ...

    def heal(self) -> None:
        """End what is wrong, and clear a trip as a person at the instrument would."""
        ...


Rule = Callable[[Pair], None]


def rules_for(model: Model) -> tuple[Rule, ...]:
    """Return the rules that hold for a model: those of every instrument, and those of its role."""
    return (*COMMON, *OF_ROLE[model.role])


# Of every instrument


def says_who_it_is(pair: Pair) -> None:
    """It says who it is, twice the same."""
    driver = pair.driver()
    assert driver.identify() == driver.identify() != ""


def silence_is_told_in_time(pair: Pair) -> None:
    """An instrument that says nothing is InstrumentSilent within its answer time and a second."""
    driver = pair.driver()
    identity = driver.identify()
    pair.suffer("silent")
    began_s = time.monotonic()
    _must_raise(InstrumentSilent, lambda: _probe(pair, driver))
    assert time.monotonic() - began_s < ANSWER_S + PATIENCE_S
    pair.heal()
    assert driver.identify() == identity


def half_lines_are_no_answers(pair: Pair) -> None:
    """Half an answer is an error, and the line is in step afterwards."""
    _suffers_and_recovers(pair, "half-lines")


def garbage_is_no_answer(pair: Pair) -> None:
    """Characters that are no answer are an error, and the line is in step afterwards."""
    _suffers_and_recovers(pair, "garbage")


def a_late_answer_is_not_taken_for_the_next(pair: Pair) -> None:
    """An answer that comes late is not taken for the answer to the next question."""
    driver = pair.driver()
    identity = driver.identify()
    pair.suffer("late")
    with contextlib.suppress(BenchError):
        _probe(pair, driver)
    pair.heal()
    assert driver.identify() == identity


def a_pulled_plug_is_told_and_put_back(pair: Pair) -> None:
    """A pulled plug is InstrumentLost; with the plug back in, a new line works."""
    driver = pair.driver()
    identity = driver.identify()
    pair.suffer("unplugged")
    _must_raise(InstrumentLost, lambda: _probe(pair, driver))
    pair.heal()
    assert pair.driver().identify() == identity


def a_loss_of_power_leaves_it_at_rest(pair: Pair) -> None:
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


# Of a gate


def the_gate_opens_as_read_back_and_shuts(pair: Pair) -> None:
    """The gate opens for the width and at the rate that were read back, and shuts."""
    driver = _identified(pair)
    driver.shut()
    assert not pair.outputs()["gate_open"]
    read_ns = driver.open(width_ns=_WIDTH_NS, rate_hz=_RATE_HZ, delay_ns=500.0)
    assert abs(read_ns - _WIDTH_NS) <= 1e-6 * _WIDTH_NS
    _await(lambda: pair.outputs()["gate_open"])
    out = pair.outputs()
    assert abs(out["gate_ns"] - read_ns) <= 1e-6 * read_ns
    assert abs(out["gate_hz"] - _RATE_HZ) <= 1e-3 * _RATE_HZ
    driver.shut()
    _await(lambda: not pair.outputs()["gate_open"])


def an_impossible_pulse_is_refused_untouched(pair: Pair) -> None:
    """A pulse that is too short, too fine, or longer than the time between triggers is refused before it is sent."""
    driver = _identified(pair)
    driver.shut()
    for width_ns in (0.0, 1e-3, 10.0012, 1e9 / _RATE_HZ + 1.0, float("nan")):
        _must_raise(BadInput, lambda width_ns=width_ns: driver.open(width_ns=width_ns, rate_hz=_RATE_HZ))
    _must_raise(BadInput, lambda: driver.open(width_ns=100.0, rate_hz=_RATE_HZ, delay_ns=0.0012))
    assert not pair.outputs()["gate_open"]


def making_safe_shuts_the_gate(pair: Pair) -> None:
    """The safe action shuts an open gate and verifies it."""
    driver = _identified(pair)
    driver.open(width_ns=_WIDTH_NS, rate_hz=_RATE_HZ)
    _await(lambda: pair.outputs()["gate_open"])
    assert make_safe(gate=driver, supply=None, record=_unheard).gate_shut
    _await(lambda: not pair.outputs()["gate_open"])


def making_safe_shuts_a_gate_that_cannot_answer(pair: Pair) -> None:
    """The safe action shuts the gate of an instrument that hears and cannot be heard, and says that nothing is sure."""
    driver = _identified(pair)
    driver.open(width_ns=_WIDTH_NS, rate_hz=_RATE_HZ)
    _await(lambda: pair.outputs()["gate_open"])
    pair.suffer("mute")
    assert not make_safe(gate=driver, supply=None, record=_unheard).gate_shut
    _await(lambda: not pair.outputs()["gate_open"])
    pair.heal()


# Of a supply


def the_voltage_rises_no_faster_than_asked_and_is_measured(pair: Pair) -> None:
    """The voltage rises no faster than asked, is measured where it is, falls, and goes off."""
    driver = _ready(pair)
    assert pair.outputs()["mcp_v"] <= DISCHARGED_V
    driver.switch_on()
    began_s = time.monotonic()
    measured_v = driver.raise_to(400.0, rate_v_per_s=1e6)
    assert time.monotonic() - began_s < 20.0
    assert abs(measured_v - 400.0) <= 2.0
    assert abs(pair.outputs()["mcp_v"] - 400.0) <= 2.0
    driver.check_on()
    assert abs(driver.lower_to(200.0) - 200.0) <= 2.0
    assert driver.off() <= DISCHARGED_V
    assert pair.outputs()["mcp_v"] <= DISCHARGED_V + 1.0


def the_ramp_is_checked_at_every_step(pair: Pair) -> None:
    """What the caller's check raises ends a ramp before its goal."""
    driver = _ready(pair)
    driver.switch_on()

    def fault() -> None:
        raise InstrumentTripped("told by the caller")

    _must_raise(InstrumentTripped, lambda: driver.raise_to(800.0, rate_v_per_s=20.0, check=fault))
    assert pair.outputs()["mcp_v"] < 790.0
    driver.off()


def an_impossible_voltage_is_refused_untouched(pair: Pair) -> None:
    """A voltage that is too low, too high or too fine for the model is refused before it is sent."""
    driver = _ready(pair)
    for volts in (1.0, 100.3, 1e5, float("nan")):
        _must_raise(BadInput, lambda volts=volts: driver.raise_to(volts, rate_v_per_s=50.0))
    assert pair.outputs()["mcp_v"] <= DISCHARGED_V


def the_supply_itself_refuses_more_than_its_limit(pair: Pair) -> None:
    """More than the limit is refused by the instrument too, should a caller ask for it."""
    driver = _ready(pair)
    driver.switch_on()
    driver.raise_to(880.0, rate_v_per_s=1e6)
    _must_raise(InstrumentRefused, lambda: driver.raise_to(_LIMIT_V + 10.0, rate_v_per_s=1e6))
    assert pair.outputs()["mcp_v"] <= _LIMIT_V + 1.0
    driver.off()


def a_trip_is_told(pair: Pair) -> None:
    """A supply that switched itself off is InstrumentTripped, and its output falls."""
    _goes_off_by_itself(pair, "trip")


def a_loss_of_power_while_on_is_told(pair: Pair) -> None:
    """A supply that lost its power while on is not taken for one that is still on."""
    _goes_off_by_itself(pair, "power-cycle")


def making_safe_takes_the_voltage_off(pair: Pair) -> None:
    """The safe action takes the voltage off and follows it down."""
    driver = _ready(pair)
    driver.switch_on()
    driver.raise_to(300.0, rate_v_per_s=1e6)
    safety = make_safe(gate=None, supply=driver, record=_unheard)
    assert safety.off_ordered
    assert safety.residual_v is not None and safety.residual_v <= DISCHARGED_V
    assert pair.outputs()["mcp_v"] <= DISCHARGED_V + 1.0


def making_safe_takes_the_voltage_of_a_mute_supply_off(pair: Pair) -> None:
    """The safe action takes the voltage off a supply that hears and cannot be heard, and claims nothing."""
    driver = _ready(pair)
    driver.switch_on()
    driver.raise_to(300.0, rate_v_per_s=1e6)
    pair.suffer("mute")
    assert make_safe(gate=None, supply=driver, record=_unheard).residual_v is None
    _await(lambda: pair.outputs()["mcp_v"] <= DISCHARGED_V)
    pair.heal()


# Of a filter wheel


def the_wheel_reaches_every_position(pair: Pair) -> None:
    """The wheel reaches every position, and its own lamps are out."""
    driver = _identified(pair)
    for position in range(driver.positions, 0, -1):
        assert driver.turn_to(position) == position
        _await(lambda position=position: pair.outputs()["position"] == position)
    assert not pair.outputs()["sensors_lit"]


def a_position_that_is_not_there_is_refused(pair: Pair) -> None:
    """A position that the wheel has not is refused, and it stands still."""
    driver = _identified(pair)
    driver.turn_to(2)
    for position in (0, -1, driver.positions + 1):
        _must_raise(BadInput, lambda position=position: driver.turn_to(position))
    assert driver.position() == 2


# Of a light source


def the_light_shines_as_read_back_and_goes_dark(pair: Pair) -> None:
    """The light takes the current that was read back, and goes dark."""
    driver = _identified(pair)
    driver.prepare(limit_a=_LIMIT_A)
    assert pair.outputs()["current_a"] == 0.0
    read_a = driver.shine(0.1)
    _await(lambda: abs(pair.outputs()["current_a"] - read_a) < 1e-9)
    driver.darken()
    _await(lambda: pair.outputs()["current_a"] == 0.0)


def the_source_itself_refuses_more_than_its_limit(pair: Pair) -> None:
    """More than the limit is refused by the instrument, and a current finer than a step before it is sent."""
    driver = _identified(pair)
    driver.prepare(limit_a=_LIMIT_A)
    _must_raise(InstrumentRefused, lambda: driver.shine(_LIMIT_A + 0.1))
    _must_raise(BadInput, lambda: driver.shine(0.0001))
    _must_raise(BadInput, lambda: driver.shine(-0.1))
    assert pair.outputs()["current_a"] == 0.0


def a_lamp_that_goes_out_is_told(pair: Pair) -> None:
    """A lamp that goes out by itself is told at the next look."""
    driver = _identified(pair)
    driver.prepare(limit_a=_LIMIT_A)
    driver.shine(0.1)
    pair.suffer("trip")
    _await(lambda: pair.outputs()["current_a"] == 0.0)
    _must_raise(BenchError, driver.look)
    pair.heal()
    driver.darken()


COMMON: tuple[Rule, ...] = (
    says_who_it_is,
    silence_is_told_in_time,
    half_lines_are_no_answers,
    garbage_is_no_answer,
    a_late_answer_is_not_taken_for_the_next,
    a_pulled_plug_is_told_and_put_back,
    a_loss_of_power_leaves_it_at_rest,
)
OF_ROLE: dict[str, tuple[Rule, ...]] = {
    "gate": (
        the_gate_opens_as_read_back_and_shuts,
        an_impossible_pulse_is_refused_untouched,
        making_safe_shuts_the_gate,
        making_safe_shuts_a_gate_that_cannot_answer,
    ),
    "supply": (
        the_voltage_rises_no_faster_than_asked_and_is_measured,
        the_ramp_is_checked_at_every_step,
        an_impossible_voltage_is_refused_untouched,
        the_supply_itself_refuses_more_than_its_limit,
        a_trip_is_told,
        a_loss_of_power_while_on_is_told,
        making_safe_takes_the_voltage_off,
        making_safe_takes_the_voltage_of_a_mute_supply_off,
    ),
    "filter-wheel": (the_wheel_reaches_every_position, a_position_that_is_not_there_is_refused),
    "light-source": (
        the_light_shines_as_read_back_and_goes_dark,
        the_source_itself_refuses_more_than_its_limit,
        a_lamp_that_goes_out_is_told,
    ),
}


def _identified(pair: Pair) -> Any:
    driver = pair.driver()
    driver.identify()
    return driver


def _ready(pair: Pair) -> Any:
    driver = _identified(pair)
    driver.prepare(limit_v=_LIMIT_V)
    driver.off()
    return driver


def _probe(pair: Pair, driver: Any) -> None:
    """One question that changes nothing; a supply at rest is not asked whether it is on."""
    driver.measured_v() if pair.model.role == "supply" else driver.look()


def _suffers_and_recovers(pair: Pair, wrong: str) -> None:
    driver = pair.driver()
    identity = driver.identify()
    pair.suffer(wrong)
    _must_raise(BenchError, lambda: _probe(pair, driver))
    pair.heal()
    assert driver.identify() == identity
    _probe(pair, driver)


def _goes_off_by_itself(pair: Pair, wrong: str) -> None:
    driver = _ready(pair)
    driver.switch_on()
    driver.raise_to(300.0, rate_v_per_s=1e6)
    driver.check_on()
    pair.suffer(wrong)
    _await(lambda: pair.outputs()["mcp_v"] < 290.0)
    # The line may have fallen out of step with the power: what is silent now must be told at the next look.
    try:
        driver.check_on()
    except InstrumentSilent:
        _must_raise(InstrumentTripped, driver.check_on)
    except InstrumentTripped:
        pass
    else:
        raise AssertionError(f"a {wrong} must be told, got a supply that is said to be on")
    pair.heal()
    pair.driver().off()


def _must_raise(kind: type[Exception], action: Callable[[], object]) -> None:
    try:
        result = action()
    except kind:
        return
    raise AssertionError(f"it must end in {kind.__name__}, got {result!r}")


def _await(there: Callable[[], bool], within_s: float = 5.0) -> None:
    deadline_s = time.monotonic() + within_s
    while not there():
        assert time.monotonic() < deadline_s, f"the outputs must follow within {within_s:g} s"
        time.sleep(0.01)


def _unheard(step: str, **details: object) -> None:
    """Nobody keeps a log of the trial."""
