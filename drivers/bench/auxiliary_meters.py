"""Auxiliary meters: light meter and thermometer, read with every stack and never set."""

import time
from collections.abc import Mapping
from typing import Any

from drivers.errors import BenchError
from labdata.conditions import Conditions
from labdata.instrument_config import Role
from labdata.meters import Meters

Reading = tuple[Conditions, tuple[str, ...]]
"""What was read, and one sentence for each meter that did not answer."""


class AuxiliaryMeters:
    """Light meter and thermometer, as far as they are there.

    Parameters
    ----------
    drivers
        The drivers of the bench, by role.
    meters
        How to read them, and whether they are needed.
    """

    def __init__(self, drivers: Mapping[Role, Any], meters: Meters) -> None:
        self._light_meter, self._thermometer = drivers.get("light-meter"), drivers.get("thermometer")
        self._meters, self._is_tuned = meters, False

    def prepare(self) -> None:
        """Make sure of the meters that are needed; a BenchError where one is not what it should be."""
        if self._light_meter is not None and self._meters.light_needed:
            self._tune(self._light_meter)
        if self._thermometer is not None and self._meters.temperature_needed:
            self._thermometer.identify()

    def read(self) -> Reading:
        """Read them; one that is needed and does not answer is a BenchError."""
        known: dict[str, Any] = {}
        silent: list[str] = []
        for meter, read, needed in (
            (self._light_meter, self.read_light, self._meters.light_needed),
            (self._thermometer, self._read_temperature, self._meters.temperature_needed),
        ):
            try:
                known |= {} if meter is None else read(meter)
            except BenchError as error:
                if needed:
                    raise
                silent.append(f"not read with the stack: {error}")
        return Conditions(**known), tuple(silent)

    def read_light(self, meter: Any) -> dict[str, Any]:
        """Read the light meter, and return conditions by name."""
        if not self._is_tuned:
            self._tune(meter)
        watts, now_s = meter.power_w(), time.time()
        lux = None if self._meters.lux_per_w is None else watts * self._meters.lux_per_w
        return {"metered_w": watts, "metered_lux": lux, "metered_time_s": now_s}

    def _tune(self, meter: Any) -> None:
        meter.identify()
        meter.tune(self._meters.wavelength_nm)
        self._is_tuned = True

    def _read_temperature(self, meter: Any) -> dict[str, Any]:
        return {"temperature_c": meter.temperature_c(), "temperature_time_s": time.time()}
