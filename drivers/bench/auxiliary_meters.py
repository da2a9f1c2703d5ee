"""Auxiliary meters: light meter and thermometer, read with every stack and never set."""

import time
from collections.abc import Callable, Mapping
from typing import Any

from drivers.errors import BenchError
from labdata.conditions import Conditions
from labdata.meters import Meters
from labdata.wires import Role

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
        self._light, self._warmth = drivers.get("light-meter"), drivers.get("thermometer")
        self._meters = meters
        self._tuned = False

    def prepare(self) -> None:
        """Make sure of the meters that are needed; a BenchError where one is not what it should be."""
        if self._light is not None and self._meters.light_needed:
            self._tune()
        if self._warmth is not None and self._meters.temperature_needed:
            self._warmth.identify()

    def read(self) -> Reading:
        """Read them; one that is needed and does not answer is a BenchError."""
        light, no_light = self._tried(self._light, self.read_light, needed=self._meters.light_needed)
        warmth, no_warmth = self._tried(self._warmth, self._warm, needed=self._meters.temperature_needed)
        known = {name: value for one in (light, warmth) for name, value in vars(one).items() if value is not None}
        return Conditions(**known), (*no_light, *no_warmth)

    def _tried(self, meter: Any, read: Callable[[], Conditions], *, needed: bool) -> Reading:
        if meter is None:
            return Conditions(), ()
        try:
            return read(), ()
        except BenchError as error:
            if needed:
                raise
            return Conditions(), (f"not read with the stack: {error}",)

    def read_light(self) -> Conditions:
        """Read the light meter, which must be there."""
        assert self._light is not None
        if not self._tuned:
            self._tune()
        watts, now_s = self._light.power_w(), time.time()
        lux = None if self._meters.lux_per_w is None else watts * self._meters.lux_per_w
        return Conditions(metered_w=watts, metered_lux=lux, metered_time_s=now_s)

    def _tune(self) -> None:
        assert self._light is not None
        self._light.identify()
        self._light.tune(self._meters.wavelength_nm)
        self._tuned = True

    def _warm(self) -> Conditions:
        assert self._warmth is not None
        return Conditions(temperature_c=self._warmth.temperature_c(), temperature_time_s=time.time())
