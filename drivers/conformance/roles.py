"""Conformance tests by role: gates, filter wheels, light sources, meters and supplies."""

import math
import time
from typing import Any

from drivers.bench.safe_state import make_safe
from drivers.conformance.conformance_pair import (
    ConformancePair,
    discard_log,
    identify_driver,
    must_raise,
    rule_of,
    wait_for,
)
from drivers.errors import BenchError, InstrumentRejected, InstrumentTimeout, InstrumentTripped
from drivers.instruments.voltage_limits import DISCHARGED_V
from labdata.errors import BadInput

_RATE_HZ, _WIDTH_NS = 60.0, 1e6
_TWO_TRIGGERS_S = 0.1


@rule_of("gate")
def the_gate_opens_as_read_back_and_shuts(pair: ConformancePair, driver: Any) -> None:
    """The gate opens for the width and at the rate that were read back, and shuts."""
    driver.shut()
    assert not pair.outputs()["gate_open"]
    read_ns = driver.open(width_ns=_WIDTH_NS, rate_hz=_RATE_HZ, delay_ns=500.0)
    assert abs(read_ns - _WIDTH_NS) <= 1e-6 * _WIDTH_NS
    wait_for(lambda: pair.outputs()["gate_open"])
    out = pair.outputs()
    assert abs(out["gate_ns"] - read_ns) <= 1e-6 * read_ns
    assert abs(out["gate_hz"] - _RATE_HZ) <= 1e-3 * _RATE_HZ
    driver.shut()
    wait_for(lambda: not pair.outputs()["gate_open"])


@rule_of("gate")
def an_impossible_pulse_is_refused_untouched(pair: ConformancePair, driver: Any) -> None:
    """A pulse that is too short, too fine, or longer than the time between triggers is refused
    before it is sent.
    """
    driver.shut()
    for width_ns in (0.0, 1e-3, 10.0012, 1e9 / _RATE_HZ + 1.0, float("nan")):
        must_raise(
            BadInput, lambda width_ns=width_ns: driver.open(width_ns=width_ns, rate_hz=_RATE_HZ)
        )
    must_raise(BadInput, lambda: driver.open(width_ns=100.0, rate_hz=_RATE_HZ, delay_ns=0.0012))
    assert not pair.outputs()["gate_open"]


@rule_of("gate")
def making_safe_shuts_the_gate(pair: ConformancePair, driver: Any) -> None:
    """The safe action shuts an open gate and verifies it; a mute one is shut too, and nothing is
    claimed.
    """
    for is_mute in (False, True):
        driver.open(width_ns=_WIDTH_NS, rate_hz=_RATE_HZ)
        wait_for(lambda: pair.outputs()["gate_open"])
        if is_mute:
            pair.suffer("mute")
        assert make_safe(gate=driver, supply=None, record=discard_log).gate_shut is not is_mute
        wait_for(lambda: not pair.outputs()["gate_open"])
    pair.heal()


@rule_of("gate")
def a_setting_changed_at_the_panel_is_reported(pair: ConformancePair, driver: Any) -> None:
    """A source, idle level or width changed at the panel is reported at the next look, with the
    gate open or shut.
    """
    driver.look()
    for is_open, setting in (
        (1, "source"),
        (1, "idle level"),
        (1, "width"),
        (0, "source"),
        (0, "idle level"),
    ):
        if is_open:
            driver.open(width_ns=_WIDTH_NS, rate_hz=_RATE_HZ)
            driver.look()
        driver.look()
        pair.suffer("panel", setting)
        must_raise(InstrumentRejected, driver.look)
        driver.shut()


@rule_of("gate")
def lost_triggers_are_reported(pair: ConformancePair, driver: Any) -> None:
    """Triggers of an external source that come while the gate is busy are reported at the next
    look.
    """
    driver.open(width_ns=_WIDTH_NS, rate_hz=_RATE_HZ, sync="line-locked")
    time.sleep(_TWO_TRIGGERS_S)
    driver.look()
    pair.suffer("panel", "busy")
    time.sleep(_TWO_TRIGGERS_S)
    must_raise(InstrumentRejected, driver.look)
    driver.open(width_ns=_WIDTH_NS, rate_hz=_RATE_HZ, sync="line-locked")
    driver.look()
    driver.shut()


_LIMIT_A = 0.5


def _ready_lamp(pair: ConformancePair) -> Any:
    driver = identify_driver(pair)
    driver.prepare(limit_a=_LIMIT_A)
    return driver


@rule_of("filter-wheel")
def the_wheel_reaches_every_position(pair: ConformancePair, driver: Any) -> None:
    """The wheel reaches every position, and its own lamps are out."""
    for position in range(driver.positions, 0, -1):
        assert driver.turn_to(position) == position
        wait_for(lambda position=position: pair.outputs()["position"] == position)
    assert not pair.outputs()["sensors_lit"]


@rule_of("filter-wheel")
def a_position_that_is_not_there_is_refused(pair: ConformancePair, driver: Any) -> None:
    """A position that the wheel has not is refused, and it stands still."""
    driver.turn_to(2)
    for position in (0, -1, driver.positions + 1):
        must_raise(BadInput, lambda position=position: driver.turn_to(position))
    assert driver.position() == 2


@rule_of("light-source", _ready_lamp)
def the_light_shines_as_read_back_and_goes_dark(pair: ConformancePair, driver: Any) -> None:
    """The light takes the current that was read back, and goes dark."""
    assert pair.outputs()["current_a"] == 0.0
    read_a = driver.shine(0.1)
    wait_for(lambda: abs(pair.outputs()["current_a"] - read_a) < 1e-9)
    driver.darken()
    wait_for(lambda: pair.outputs()["current_a"] == 0.0)


@rule_of("light-source", _ready_lamp)
def the_source_itself_refuses_more_than_its_limit(pair: ConformancePair, driver: Any) -> None:
    """More than the limit is refused by the instrument, and a current finer than a step before it
    is sent.
    """
    must_raise(InstrumentRejected, lambda: driver.shine(_LIMIT_A + 0.1))
    must_raise(BadInput, lambda: driver.shine(0.0001))
    must_raise(BadInput, lambda: driver.shine(-0.1))
    assert pair.outputs()["current_a"] == 0.0


@rule_of("light-source", _ready_lamp)
def a_lamp_that_goes_out_is_reported(pair: ConformancePair, driver: Any) -> None:
    """A lamp that goes out by itself is reported at the next look."""
    driver.shine(0.1)
    pair.suffer("trip")
    wait_for(lambda: pair.outputs()["current_a"] == 0.0)
    must_raise(BenchError, driver.look)
    pair.heal()
    driver.darken()


@rule_of("light-source", _ready_lamp)
def making_safe_puts_a_mute_lamp_out(pair: ConformancePair, driver: Any) -> None:
    """The safe action puts a lamp out that hears and cannot be heard, and claims nothing."""
    driver.shine(0.1)
    pair.suffer("mute")
    assert not make_safe(gate=None, supply=None, lamps=[driver], record=discard_log).light_dark
    wait_for(lambda: pair.outputs()["current_a"] == 0.0)
    pair.heal()


@rule_of("light-meter")
def the_meter_reads_watts_at_a_wavelength(pair: ConformancePair, driver: Any) -> None:
    """Watts are read, in the dark next to none, and a wavelength that its head does not see is
    refused.
    """
    driver.tune(650.0)
    assert all(abs(driver.power_w()) < 1e-9 for _ in range(5))
    must_raise(BenchError, lambda: driver.tune(1e6))
    driver.tune(550.0)
    assert math.isfinite(driver.power_w())


@rule_of("thermometer")
def the_thermometer_reads_degrees_celsius(pair: ConformancePair, driver: Any) -> None:
    """What it puts out as a temperature is what it reads, again and again."""
    true_c = pair.outputs()["temperature_c"]
    assert all(abs(driver.temperature_c() - true_c) < 0.1 for _ in range(5))


_LIMIT_V = 900.0


def _ready_supply(pair: ConformancePair) -> Any:
    driver = identify_driver(pair)
    driver.prepare(limit_v=_LIMIT_V)
    driver.off()
    return driver


def _supply_at_300_v(pair: ConformancePair) -> Any:
    driver = _ready_supply(pair)
    driver.switch_on()
    driver.look()
    driver.raise_to(300.0, rate_v_per_s=1e6)
    return driver


@rule_of("supply", _ready_supply)
def the_voltage_rises_no_faster_than_asked_and_is_measured(
    pair: ConformancePair, driver: Any
) -> None:
    """The voltage rises no faster than asked, is measured where it is, falls, and goes off."""
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


@rule_of("supply", _ready_supply)
def the_ramp_is_checked_at_every_step(pair: ConformancePair, driver: Any) -> None:
    """What the caller's check raises ends a ramp before its goal."""
    driver.switch_on()

    def fault() -> None:
        raise InstrumentTripped("raised by the caller")

    must_raise(InstrumentTripped, lambda: driver.raise_to(800.0, rate_v_per_s=20.0, check=fault))
    assert pair.outputs()["mcp_v"] < 790.0
    driver.off()


@rule_of("supply", _ready_supply)
def an_impossible_voltage_is_refused_untouched(pair: ConformancePair, driver: Any) -> None:
    """A voltage that is too low, too high or too fine for the model is refused before it is
    sent.
    """
    for volts in (1.0, 100.3, 1e5, float("nan")):
        must_raise(BadInput, lambda volts=volts: driver.raise_to(volts, rate_v_per_s=50.0))
    assert pair.outputs()["mcp_v"] <= DISCHARGED_V


@rule_of("supply", _supply_at_300_v)
def the_supply_itself_refuses_more_than_its_limit(pair: ConformancePair, driver: Any) -> None:
    """More than the limit is refused by the instrument too, should a caller ask for it."""
    driver.raise_to(880.0, rate_v_per_s=1e6)
    must_raise(InstrumentRejected, lambda: driver.raise_to(_LIMIT_V + 10.0, rate_v_per_s=1e6))
    assert pair.outputs()["mcp_v"] <= _LIMIT_V + 1.0
    driver.off()


@rule_of("supply")
def a_trip_and_a_loss_of_power_are_reported(pair: ConformancePair, driver: Any) -> None:
    """A supply that switched itself off, or lost its power while on, is InstrumentTripped, and its
    output falls.
    """
    for fault in ("trip", "power-cycle"):
        driver = _supply_at_300_v(pair)
        driver.check_on()
        pair.suffer(fault)
        wait_for(lambda: pair.outputs()["mcp_v"] < 290.0)
        # The line may have fallen out of step with the power: what is silent now must be reported
        # at the next look.
        try:
            driver.check_on()
        except InstrumentTimeout:
            must_raise(InstrumentTripped, driver.check_on)
        except InstrumentTripped:
            pass
        else:
            raise AssertionError(f"a {fault} must be reported, got a supply reported as on")
        pair.heal()
        pair.driver().off()


@rule_of("supply", _supply_at_300_v)
def making_safe_takes_the_voltage_off(pair: ConformancePair, driver: Any) -> None:
    """The safe action takes the voltage off and follows it down."""
    safety = make_safe(gate=None, supply=driver, record=discard_log)
    assert safety.off_ordered
    assert safety.residual_v is not None and safety.residual_v <= DISCHARGED_V
    assert pair.outputs()["mcp_v"] <= DISCHARGED_V + 1.0


@rule_of("supply", _supply_at_300_v)
def making_safe_takes_the_voltage_of_a_mute_supply_off(pair: ConformancePair, driver: Any) -> None:
    """The safe action takes the voltage off a supply that hears and cannot be heard, and claims
    nothing.
    """
    pair.suffer("mute")
    assert make_safe(gate=None, supply=driver, record=discard_log).residual_v is None
    wait_for(lambda: pair.outputs()["mcp_v"] <= DISCHARGED_V)
    pair.heal()


@rule_of("supply", _supply_at_300_v)
def a_voltage_changed_at_the_panel_is_reported(pair: ConformancePair, driver: Any) -> None:
    """A voltage that somebody changes at the panel is reported at the next look after the output
    has moved.
    """
    driver.look()
    pair.suffer("panel", "voltage")
    wait_for(lambda: pair.outputs()["mcp_v"] > 310.0)
    must_raise(InstrumentRejected, driver.look)
    driver.off()
    driver.look()


@rule_of("supply")
def a_supply_switched_on_at_the_panel_is_reported(pair: ConformancePair, driver: Any) -> None:
    """A supply that is off and that somebody switches on at the panel is reported; one that nobody
    set is not.
    """
    pair.suffer("panel", "on")
    wait_for(lambda: pair.outputs()["mcp_v"] > 90.0)
    driver.look()
    driver = _ready_supply(pair)
    driver.look()
    pair.suffer("panel", "on")
    wait_for(lambda: pair.outputs()["mcp_v"] > 90.0)
    must_raise(InstrumentRejected, driver.look)
    driver.off()
