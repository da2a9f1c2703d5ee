"""What every filter wheel, light source and meter must do: stand, shine and read as it says, and go dark."""

import math
from typing import Any

from drivers.bench.safe_state import make_safe
from drivers.errors import BenchError, InstrumentRejected
from drivers.instruments.conformance.conformance_pair import (
    ConformancePair,
    discard_log,
    identify_driver,
    must_raise,
    rule_of,
    wait_for,
)
from labdata.errors import BadInput

_LIMIT_A = 0.5


@rule_of("filter-wheel")
def the_wheel_reaches_every_position(pair: ConformancePair) -> None:
    """The wheel reaches every position, and its own lamps are out."""
    driver = identify_driver(pair)
    for position in range(driver.positions, 0, -1):
        assert driver.turn_to(position) == position
        wait_for(lambda position=position: pair.outputs()["position"] == position)
    assert not pair.outputs()["sensors_lit"]


@rule_of("filter-wheel")
def a_position_that_is_not_there_is_refused(pair: ConformancePair) -> None:
    """A position that the wheel has not is refused, and it stands still."""
    driver = identify_driver(pair)
    driver.turn_to(2)
    for position in (0, -1, driver.positions + 1):
        must_raise(BadInput, lambda position=position: driver.turn_to(position))
    assert driver.position() == 2


@rule_of("light-source")
def the_light_shines_as_read_back_and_goes_dark(pair: ConformancePair) -> None:
    """The light takes the current that was read back, and goes dark."""
    driver = _ready(pair)
    assert pair.outputs()["current_a"] == 0.0
    read_a = driver.shine(0.1)
    wait_for(lambda: abs(pair.outputs()["current_a"] - read_a) < 1e-9)
    driver.darken()
    wait_for(lambda: pair.outputs()["current_a"] == 0.0)


@rule_of("light-source")
def the_source_itself_refuses_more_than_its_limit(pair: ConformancePair) -> None:
    """More than the limit is refused by the instrument, and a current finer than a step before it is sent."""
    driver = _ready(pair)
    must_raise(InstrumentRejected, lambda: driver.shine(_LIMIT_A + 0.1))
    must_raise(BadInput, lambda: driver.shine(0.0001))
    must_raise(BadInput, lambda: driver.shine(-0.1))
    assert pair.outputs()["current_a"] == 0.0


@rule_of("light-source")
def a_lamp_that_goes_out_is_reported(pair: ConformancePair) -> None:
    """A lamp that goes out by itself is reported at the next look."""
    driver = _ready(pair)
    driver.shine(0.1)
    pair.suffer("trip")
    wait_for(lambda: pair.outputs()["current_a"] == 0.0)
    must_raise(BenchError, driver.look)
    pair.heal()
    driver.darken()


@rule_of("light-source")
def making_safe_puts_a_mute_lamp_out(pair: ConformancePair) -> None:
    """The safe action puts a lamp out that hears and cannot be heard, and claims nothing."""
    driver = _ready(pair)
    driver.shine(0.1)
    pair.suffer("mute")
    assert not make_safe(gate=None, supply=None, lamps=[driver], record=discard_log).light_dark
    wait_for(lambda: pair.outputs()["current_a"] == 0.0)
    pair.heal()


@rule_of("light-meter")
def the_meter_reads_watts_at_a_wavelength(pair: ConformancePair) -> None:
    """Watts are read, in the dark next to none, and a wavelength that its head does not see is refused."""
    driver = identify_driver(pair)
    driver.tune(650.0)
    assert all(abs(driver.power_w()) < 1e-9 for _ in range(5))
    must_raise(BenchError, lambda: driver.tune(1e6))
    driver.tune(550.0)
    assert math.isfinite(driver.power_w())


@rule_of("thermometer")
def the_thermometer_reads_degrees_celsius(pair: ConformancePair) -> None:
    """What it puts out as a temperature is what it reads, again and again."""
    driver = identify_driver(pair)
    true_c = pair.outputs()["temperature_c"]
    assert all(abs(driver.temperature_c() - true_c) < 0.1 for _ in range(5))


def _ready(pair: ConformancePair) -> Any:
    driver = identify_driver(pair)
    driver.prepare(limit_a=_LIMIT_A)
    return driver
