"""Light of the bench behind the interlock: an illuminance becomes a filter turned in the dark, then a current."""

import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Mapping
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

from drivers.bench.interlock import Interlock
from drivers.bench.setup import BenchSetup
from drivers.bench.state import Command, FilterMoved, FilterRead, LightRead, SetLight, TurnFilter
from drivers.errors import BenchError, BenchStopped
from drivers.serial_lines.line import InstrumentLine
from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.instrument_config import Role
from labdata.session import Kind
from labdata.target import Target

if TYPE_CHECKING:
    from drivers.bench.client import BenchClient
    from drivers.bench.local_bench import LocalBench
    from drivers.interface import Operator


METER_ZERO = 1e-3
"""A meter that reads less than this share of the largest light allowed reads its own zero once the light is blocked."""


class Station:
    """One instrument: its line, its driver, and the lock of whoever runs a procedure on it."""

    def __init__(self, line: InstrumentLine, driver: Any) -> None:
        self.line, self.driver = line, driver
        self.procedure = threading.RLock()
        self.watched = False


class LightControl(ABC):
    """The light of a bench: a lamp known by its calibration with the filter wheel before it, or a person's."""

    interlock: Interlock
    stations: Mapping[Role, Station]
    _setup: BenchSetup
    _is_stopped = False
    """Whether a safe action began since the present order did."""
    _position = 1

    @abstractmethod
    def check(self) -> None:
        """Raise what went wrong at the bench."""

    @abstractmethod
    def _using(self, *roles: Role) -> AbstractContextManager[None]:
        """Run a procedure on some instruments; what goes wrong on them makes safe."""

    def _permit(self, command: Command) -> None:
        """Let a command of an order pass; an order in which a safe action began does not go on (BenchStopped)."""
        if self._is_stopped:
            raise BenchStopped("the tube was made safe in the middle of an order")
        self.interlock.permit(command)

    def light_unknown(self) -> bool:
        """Know nothing of the light any more; return whether the bench has a lamp of its own."""
        self.interlock.tell(LightRead(illuminance_lux=math.inf))
        return self._setup.lamp is not None

    def permit_light(self, illuminance_lux: float, *, point: bool, target: Target) -> None:
        """Refuse (InterlockRefused) a target and a light that a rule forbids; else it counts as set."""
        self.interlock.permit(SetLight(illuminance_lux=illuminance_lux, point=point, target=target))

    def light_read(self, illuminance_lux: float, *, zero: bool = False) -> None:
        """Take in what the light was read as; with `zero`, next to nothing is the zero of the meter."""
        zero_lux = METER_ZERO * self.interlock.limits.largest_lux(point=self.interlock.state.point)
        lux = 0.0 if zero and illuminance_lux <= zero_lux else illuminance_lux
        self.interlock.tell(LightRead(illuminance_lux=lux))
        self.check()

    def darken(self) -> None:
        """Put the lamp out, if there is one, which needs no leave; read back."""
        if self._setup.lamp is not None:
            with self._using("light-source"):
                self._turn_lamp_off()

    def shine(self, illuminance_lux: float, *, point: bool, target: Target, filter_density: float | None) -> Conditions:
        """Turn the filter in the dark, then light the lamp; return the light that the current read back makes.

        Raises
        ------
        BadInput
            If there is no lamp, or the target was not placed in the dark.
        InterlockRefused
            If a rule forbids the filter or the light.
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
            read = self._setup.lamp.lit(source.driver.shine(setting.current_a), self._position)
            source.watched = True
            self.interlock.tell(LightRead(illuminance_lux=read.illuminance_lux or ordered_lux))
        self.check()
        return read

    def _prepare_lamp(self) -> None:
        """Go dark, have the source itself refuse more than was calibrated, and read where the wheel stands.

        Raises
        ------
        BadInput
            If the wheel has fewer positions than the calibration has filters.
        """
        if (lamp := self._setup.lamp) is None:
            return
        filters, wheel = len(lamp.filter_density), self.stations.get("filter-wheel")
        if wheel is not None:
            self.interlock.tell(FilterMoved())
        source = self.stations["light-source"].driver
        source.identify()
        source.prepare(limit_a=lamp.limit_a)
        if wheel is None:
            if filters > 1:
                raise BadInput(f"a lamp without a filter wheel must have one filter density, got {filters}")
            return
        wheel.driver.identify()
        if (positions := wheel.driver.positions) < filters:
            raise BadInput(f"the filter wheel must have a position for each filter, got {positions} for {filters}")
        self._take_filter(wheel.driver.position())

    def _turn_lamp_off(self) -> None:
        source = self.stations["light-source"]
        source.watched = False
        source.driver.darken()
        self.interlock.tell(LightRead(illuminance_lux=0.0))

    def _turn_filter(self, position: int) -> None:
        """Have the wheel, where there is one, stand at a position; turned in the dark only."""
        if (wheel := self.stations.get("filter-wheel")) is None:
            return
        wheel.watched = False
        if wheel.driver.position() != position:
            self._permit(TurnFilter(position=position))
            wheel.driver.turn_to(position)
        self._take_filter(position)

    def _take_filter(self, position: int) -> None:
        """Know the filter that the wheel stands at; one that was not calibrated is left at the first turn."""
        assert self._setup.lamp is not None
        if 1 <= position <= len(self._setup.lamp.filter_density):
            self._position = position
            self.interlock.tell(FilterRead(position=position))
            self.stations["filter-wheel"].watched = True


class GuardedLight:
    """An operator behind the interlock, and the lamp of the bench, if it has one.

    Parameters
    ----------
    operator
        Places targets; sets the light where there is no lamp.
    bench
        Asked before each placement, given what the meter reads after it.
    """

    def __init__(self, operator: "Operator", bench: "BenchClient | LocalBench") -> None:
        self._operator, self._bench = operator, bench
        self._has_lamp = bench.light_unknown()
        operator.while_waiting = self.while_waiting = bench.check

    @property
    def is_by_hand(self) -> bool:
        """Whether a person sets the light, for whom the gate is shut meanwhile."""
        return self._operator.is_by_hand and not self._has_lamp

    def darken(self) -> None:
        """Block the light, which needs no leave."""
        self._operator.darken()
        self._bench.darken()
        if not self._has_lamp:
            self._bench.light_read(0.0)

    def place(
        self, *, kind: Kind, target: Target, illuminance_lux: float, filter_density: float | None = None
    ) -> Conditions:
        """Put a target before the camera and set the light, if no rule forbids it; return what is read.

        Raises
        ------
        InterlockRefused
            If a rule forbids it; nothing was moved then.
        BenchError
            If the meter reads a light that the tube must be made safe for.
        """
        self._bench.check()
        point = kind == "point"
        if self._has_lamp and illuminance_lux:
            return self._bench.shine(illuminance_lux, point=point, target=target, filter_density=filter_density)
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
