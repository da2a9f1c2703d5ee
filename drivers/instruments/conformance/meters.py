"""What every light meter and thermometer must do: read finite numbers again and again, in the unit it is asked for."""

import math

from drivers.errors import BenchError
from drivers.instruments.conformance.conformance_pair import ConformancePair, Rule, identify_driver, must_raise


def the_meter_reads_watts_at_a_wavelength(pair: ConformancePair) -> None:
    """Watts are read, in the dark next to none, and a wavelength that its head does not see is refused."""
    driver = identify_driver(pair)
    driver.tune(650.0)
    assert all(abs(driver.power_w()) < 1e-9 for _ in range(5))
    must_raise(BenchError, lambda: driver.tune(1e6))
    driver.tune(550.0)
    assert math.isfinite(driver.power_w())


def the_thermometer_reads_degrees_celsius(pair: ConformancePair) -> None:
    """What it puts out as a temperature is what it reads, again and again."""
    driver = identify_driver(pair)
    true_c = pair.outputs()["temperature_c"]
    assert all(abs(driver.temperature_c() - true_c) < 0.1 for _ in range(5))


METER_RULES: tuple[Rule, ...] = (the_meter_reads_watts_at_a_wavelength,)

THERMOMETER_RULES: tuple[Rule, ...] = (the_thermometer_reads_degrees_celsius,)
