"""What every high-voltage supply must do: rise slowly, be measured, refuse its limit, report trips, and go off."""

import time
from typing import Any

from drivers.bench.safe_state import make_safe
from drivers.errors import InstrumentRejected, InstrumentTimeout, InstrumentTripped
from drivers.instruments.conformance.conformance_pair import (
    ConformancePair,
    discard_log,
    identify_driver,
    must_raise,
    rule_of,
    wait_for,
)
from drivers.instruments.voltage_limits import DISCHARGED_V
from labdata.errors import BadInput

_LIMIT_V = 900.0


@rule_of("supply")
def the_voltage_rises_no_faster_than_asked_and_is_measured(pair: ConformancePair) -> None:
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


@rule_of("supply")
def the_ramp_is_checked_at_every_step(pair: ConformancePair) -> None:
    """What the caller's check raises ends a ramp before its goal."""
    driver = _ready(pair)
    driver.switch_on()

    def fault() -> None:
        raise InstrumentTripped("raised by the caller")

    must_raise(InstrumentTripped, lambda: driver.raise_to(800.0, rate_v_per_s=20.0, check=fault))
    assert pair.outputs()["mcp_v"] < 790.0
    driver.off()


@rule_of("supply")
def an_impossible_voltage_is_refused_untouched(pair: ConformancePair) -> None:
    """A voltage that is too low, too high or too fine for the model is refused before it is sent."""
    driver = _ready(pair)
    for volts in (1.0, 100.3, 1e5, float("nan")):
        must_raise(BadInput, lambda volts=volts: driver.raise_to(volts, rate_v_per_s=50.0))
    assert pair.outputs()["mcp_v"] <= DISCHARGED_V


@rule_of("supply")
def the_supply_itself_refuses_more_than_its_limit(pair: ConformancePair) -> None:
    """More than the limit is refused by the instrument too, should a caller ask for it."""
    driver = _at(880.0, pair)
    must_raise(InstrumentRejected, lambda: driver.raise_to(_LIMIT_V + 10.0, rate_v_per_s=1e6))
    assert pair.outputs()["mcp_v"] <= _LIMIT_V + 1.0
    driver.off()


@rule_of("supply")
def a_trip_and_a_loss_of_power_are_reported(pair: ConformancePair) -> None:
    """A supply that switched itself off, or lost its power while on, is InstrumentTripped, and its output falls."""
    for wrong in ("trip", "power-cycle"):
        driver = _at(300.0, pair)
        driver.check_on()
        pair.suffer(wrong)
        wait_for(lambda: pair.outputs()["mcp_v"] < 290.0)
        # The line may have fallen out of step with the power: what is silent now must be reported at the next look.
        try:
            driver.check_on()
        except InstrumentTimeout:
            must_raise(InstrumentTripped, driver.check_on)
        except InstrumentTripped:
            pass
        else:
            raise AssertionError(f"a {wrong} must be reported, got a supply that is said to be on")
        pair.heal()
        pair.driver().off()


@rule_of("supply")
def making_safe_takes_the_voltage_off(pair: ConformancePair) -> None:
    """The safe action takes the voltage off and follows it down."""
    driver = _at(300.0, pair)
    safety = make_safe(gate=None, supply=driver, record=discard_log)
    assert safety.off_ordered
    assert safety.residual_v is not None and safety.residual_v <= DISCHARGED_V
    assert pair.outputs()["mcp_v"] <= DISCHARGED_V + 1.0


@rule_of("supply")
def making_safe_takes_the_voltage_of_a_mute_supply_off(pair: ConformancePair) -> None:
    """The safe action takes the voltage off a supply that hears and cannot be heard, and claims nothing."""
    driver = _at(300.0, pair)
    pair.suffer("mute")
    assert make_safe(gate=None, supply=driver, record=discard_log).residual_v is None
    wait_for(lambda: pair.outputs()["mcp_v"] <= DISCHARGED_V)
    pair.heal()


@rule_of("supply")
def a_voltage_changed_at_the_panel_is_reported(pair: ConformancePair) -> None:
    """A voltage that somebody changes at the panel is reported at the next look after the output has moved."""
    driver = _at(300.0, pair)
    driver.look()
    pair.suffer("panel", "voltage")
    wait_for(lambda: pair.outputs()["mcp_v"] > 310.0)
    must_raise(InstrumentRejected, driver.look)
    driver.off()
    driver.look()


@rule_of("supply")
def a_supply_switched_on_at_the_panel_is_reported(pair: ConformancePair) -> None:
    """A supply that is off and that somebody switches on at the panel is reported; one that nobody set is not."""
    pair.suffer("panel", "on")
    wait_for(lambda: pair.outputs()["mcp_v"] > 90.0)
    identify_driver(pair).look()
    driver = _ready(pair)
    driver.look()
    pair.suffer("panel", "on")
    wait_for(lambda: pair.outputs()["mcp_v"] > 90.0)
    must_raise(InstrumentRejected, driver.look)
    driver.off()


def _ready(pair: ConformancePair) -> Any:
    driver = identify_driver(pair)
    driver.prepare(limit_v=_LIMIT_V)
    driver.off()
    return driver


def _at(volts: float, pair: ConformancePair) -> Any:
    driver = _ready(pair)
    driver.switch_on()
    driver.look()
    driver.raise_to(volts, rate_v_per_s=1e6)
    return driver
