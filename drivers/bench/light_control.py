"""Lamp, filter wheel and operator behind the interlock."""

import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Mapping
from contextlib import AbstractContextManager
from typing import Any

from drivers.bench.interlock import Interlock
from drivers.bench.setup import BenchSetup
from drivers.bench.state import Command, FilterRead, LightRead, SetLight, TurnFilter
from drivers.errors import BenchError, BenchStopped
from drivers.instruments.models import model_of
from drivers.interface import Operator
from drivers.serial_lines.line import InstrumentLine
from labdata import BadInput, Conditions, Kind, Target
from labdata.instrument_config import InstrumentConfig, Role

# Fraction of the largest allowed light below which a reading with blocked light is the zero of the
# meter
METER_ZERO = 1e-3


class Station:
    """One instrument: line, driver, and the lock of a procedure that uses it."""

    def __init__(self, line: InstrumentLine, driver: Any) -> None:
        self.line, self.driver = line, driver
        self.procedure = threading.RLock()
        self.watched = False


def stations_on(
    lines: Mapping[Role, InstrumentLine], wires: InstrumentConfig
) -> dict[Role, Station]:
    """Return the instruments of a bench that have a line, by role."""
    return {
        connection.role: Station(
            lines[connection.role], model_of(connection).driver(lines[connection.role])
        )
        for connection in wires.instruments
        if connection.role in lines
    }


class LightControl(ABC):
    """Light of a bench: a calibrated lamp with its filter wheel, or light set by a person."""

    interlock: Interlock
    stations: Mapping[Role, Station]
    _setup: BenchSetup
    _is_stopped = False  # Whether a safe action began since the present command
    _position = 1

    @abstractmethod
    def check(self) -> None:
        """Raise an error of the bench."""

    @abstractmethod
    def _using(self, *roles: Role) -> AbstractContextManager[None]:
        """Run a procedure on several instruments; an error makes the tube safe."""

    def _permit(self, command: Command) -> None:
        """Permit a command of a procedure; BenchStopped if a safe action has begun since."""
        if self._is_stopped:
            raise BenchStopped("the tube was made safe in the middle of an order")
        self.interlock.permit(command)

    def light_unknown(self) -> bool:
        """Set the light to unknown; return whether the bench has a lamp."""
        self.interlock.tell(LightRead(illuminance_lux=math.inf))
        return self._setup.lamp is not None

    def permit_light(self, illuminance_lux: float, *, point: bool, target: Target) -> None:
        """Permit a target and a light, which then count as set, or refuse them
        (InterlockRefused).
        """
        self.interlock.permit(SetLight(illuminance_lux=illuminance_lux, point=point, target=target))

    def light_read(self, illuminance_lux: float, *, zero: bool = False) -> None:
        """Take a reading of the light; with `zero`, a reading near zero is the zero of the
        meter.
        """
        zero_lux = METER_ZERO * self.interlock.limits.largest_lux(point=self.interlock.state.point)
        lux = 0.0 if zero and illuminance_lux <= zero_lux else illuminance_lux
        self.interlock.tell(LightRead(illuminance_lux=lux))
        self.check()

    def darken(self) -> None:
        """Switch the lamp off, if there is one, and read it back."""
        if self._setup.lamp is not None:
            with self._using("light-source"):
                self._turn_lamp_off()

    def shine(
        self, illuminance_lux: float, *, point: bool, target: Target, filter_density: float | None
    ) -> Conditions:
        """Turn the filter in the dark, then switch the lamp on; return the light of the read-back
        current.

        A bench without a lamp, or a target not placed in the dark, is BadInput; a rule may be
        InterlockRefused.
        """
        if self._setup.lamp is None:
            raise BadInput("a light of its own must have a lamp at the bench, got none")
        if (target, point) != (self.interlock.state.target, self.interlock.state.point):
            raise BadInput(f"a target must be placed in the dark before it is lit, got {target}")
        self._is_stopped = False
        with self._using("light-source", "filter-wheel"):
            setting = self._setup.lamp.setting(illuminance_lux, filter_density)
            self._turn_lamp_off()
            self._turn_filter(setting.position)
            self.check()  # a wheel takes its time
            ordered_lux = setting.read.illuminance_lux or 0.0
            self._permit(SetLight(illuminance_lux=ordered_lux, point=point, target=target))
            source = self.stations["light-source"]
            read = self._setup.lamp.light_at(source.driver.shine(setting.current_a), self._position)
            source.watched = True
            self.interlock.tell(LightRead(illuminance_lux=read.illuminance_lux or ordered_lux))
        self.check()
        return read

    def _prepare_lamp(self) -> None:
        """Switch the lamp off, limit its current to the calibration, and read the position of the
        wheel.
        """
        if (lamp := self._setup.lamp) is None:
            return
        filters, wheel = len(lamp.filter_density), self.stations.get("filter-wheel")
        if wheel is not None:
            self.interlock.tell(FilterRead(known=False))
        source = self.stations["light-source"].driver
        source.identify()
        source.prepare(limit_a=lamp.limit_a)
        if wheel is None:
            if filters > 1:
                raise BadInput(
                    f"a lamp without a filter wheel must have one filter density, got {filters}"
                )
            return
        wheel.driver.identify()
        if (positions := wheel.driver.positions) < filters:
            raise BadInput(
                f"the filter wheel must have a position for each filter, got {positions} for "
                f"{filters}"
            )
        self._take_filter(wheel.driver.position())

    def _turn_lamp_off(self) -> None:
        source = self.stations["light-source"]
        source.watched = False
        source.driver.darken()
        self.interlock.tell(LightRead(illuminance_lux=0.0))

    def _turn_filter(self, position: int) -> None:
        """Turn the wheel, if there is one, to a position, in the dark only."""
        if (wheel := self.stations.get("filter-wheel")) is None:
            return
        wheel.watched = False
        if wheel.driver.position() != position:
            self._permit(TurnFilter())
            wheel.driver.turn_to(position)
        self._take_filter(position)

    def _take_filter(self, position: int) -> None:
        """Record the filter at the position of the wheel, if it is calibrated."""
        assert self._setup.lamp is not None
        if 1 <= position <= len(self._setup.lamp.filter_density):
            self._position = position
            self.interlock.tell(FilterRead(known=True))
            self.stations["filter-wheel"].watched = True


class GuardedLight:
    """Operator who places targets, behind the interlock of the bench, with its lamp, if it has
    one; `bench` is a `TubeBench`, or a client with its commands.
    """

    def __init__(self, operator: Operator, bench: Any) -> None:
        self._operator, self._bench = operator, bench
        self._has_lamp = bench.light_unknown()
        operator.while_waiting = self.while_waiting = bench.check

    @property
    def is_by_hand(self) -> bool:
        """Whether a person sets the light; the gate is then shut meanwhile."""
        return self._operator.is_by_hand and not self._has_lamp

    def darken(self) -> None:
        """Block the light."""
        self._operator.darken()
        self._bench.darken()
        if not self._has_lamp:
            self._bench.light_read(0.0)

    def place(
        self,
        *,
        kind: Kind,
        target: Target,
        illuminance_lux: float,
        filter_density: float | None = None,
    ) -> Conditions:
        """Place a target and set the light, if no rule refuses it; return the reading.

        Nothing was moved at InterlockRefused; a reading that requires the safe state is BenchError.
        """
        self._bench.check()
        point = kind == "point"
        if self._has_lamp and illuminance_lux:
            return self._bench.shine(
                illuminance_lux, point=point, target=target, filter_density=filter_density
            )
        if self._has_lamp:
            self._bench.darken()
        elif self.is_by_hand:
            self._bench.shut_gate()
        self._bench.permit_light(illuminance_lux, point=point, target=target)
        read = self._operator.place(
            kind=kind, target=target, illuminance_lux=illuminance_lux, filter_density=filter_density
        )
        if self._has_lamp:
            read = Conditions(illuminance_lux=0.0, lamp_a=0.0)
        lux = illuminance_lux if read.illuminance_lux is None else read.illuminance_lux
        try:
            self._bench.light_read(lux, zero=not illuminance_lux)
        except BenchError:
            self._operator.darken()
            raise
        return read
