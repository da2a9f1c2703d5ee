"""High-voltage supplies: the voltages that can be set, when an output is discharged, and whether it stays as set."""

import math
import time
from abc import abstractmethod
from collections.abc import Callable
from typing import ClassVar

from drivers.errors import InstrumentRejected, InstrumentTripped
from drivers.instruments.instrument import Instrument
from drivers.serial_lines.line import InstrumentLine
from labdata.errors import BadInput

FALL_S = 15.0
"""Time within which an output must have discharged after off, s."""

DISCHARGED_V = 10.0
"""Voltage at the output that counts as none, V."""

SETTLED_V = 2.0
"""An output has settled this near to its set-point, V: two steps of the coarsest display."""

ACCURACY_V = 2.5
"""Accuracy of the measured output, V: 0.05 % of the 5 kV full scale of a PS350; an SHQ is better (data sheets)."""

HELD_V = SETTLED_V + ACCURACY_V
"""An output that is this far from its set-point, or rises by this much after off, was changed, V."""

POLL_S = 0.1
_ROUNDING = 1e-6


class Supply(Instrument):
    """A high-voltage supply of positive polarity across the microchannel plate.

    It remembers what it was set to, and `look` compares the measured output with it.
    """

    off_commands: ClassVar[tuple[str, ...]]
    """Commands that take the high voltage off, sent one by one when the tube is made safe."""

    reading: ClassVar[str]
    """The question whose answer is the voltage at the output, for the log."""

    lowest_v: ClassVar[float]
    step_v: ClassVar[float] = 1.0
    highest_v: float

    def __init__(self, line: InstrumentLine) -> None:
        super().__init__(line)
        self.is_on = False
        """Whether this object switched it on and not off; the status belongs to whoever watches for trips."""
        self._reached_v: float | None = None  # set-point that the output has reached
        self._fallen_to_v: float | None = None  # lowest output seen since it was ordered off; None: nothing was set

    def look(self) -> None:
        """Compare the output with what was set: on, no trip and near the set-point; off, not on again and not rising.

        A supply that switched itself off is InstrumentTripped, one that was set at its panel InstrumentRejected.
        """
        if self.is_on:
            self._require_untripped()
            if self._reached_v is not None and abs((now_v := self.read_voltage_v()) - self._reached_v) > HELD_V:
                self.check_on()
                raise self.line.rejection(
                    f"put out {self._reached_v:g} V as set", f"{now_v:g} V: somebody changed it at the panel"
                )
        elif self._fallen_to_v is None:
            self.read_voltage_v()
        else:
            self._require_off()
            now_v = self.read_voltage_v()
            self._fallen_to_v = min(self._fallen_to_v, now_v)
            if now_v > self._fallen_to_v + HELD_V:
                raise self.line.rejection(
                    f"stay off, at {self._fallen_to_v:g} V or less",
                    f"{now_v:g} V: somebody switched it on at the panel",
                )

    def check_voltage(self, volts: float) -> None:
        """Refuse (BadInput) a voltage outside of the supply's range, or between two steps, where it would round."""
        if not volts >= self.lowest_v:
            raise BadInput(f"mcp_v must be 0 (off) or at least {self.lowest_v:g}, got {volts:g}")
        if volts > self.highest_v:
            raise BadInput(f"mcp_v must not exceed the supply's {self.highest_v:g}, got {volts:g}")
        if abs(volts / self.step_v - round(volts / self.step_v)) > _ROUNDING:
            raise BadInput(f"mcp_v must be a multiple of the supply's {self.step_v:g} V, got {volts:.10g}")

    @abstractmethod
    def prepare(self, *, limit_v: float) -> None:
        """Switch off, and make the supply itself refuse more than a limit, V; an old trip is InstrumentTripped."""

    def order_off(self) -> None:
        """Order the high voltage off; the charge takes seconds to leave, see `read_voltage_v`."""
        self.is_on, self._reached_v, self._fallen_to_v = False, None, math.inf
        self._order_off()

    def off(self) -> float:
        """Order off, wait until the output is discharged, and return it, V."""
        self.order_off()
        deadline_s = time.monotonic() + FALL_S
        while (volts := self.read_voltage_v()) > DISCHARGED_V:
            if time.monotonic() > deadline_s:
                raise self.line.rejection(f"fall below {DISCHARGED_V:g} V within {FALL_S:g} s of off", f"{volts:g} V")
            time.sleep(POLL_S)
        return volts

    def switch_on(self) -> None:
        """Switch on at the lowest voltage."""
        self._reached_v, self._fallen_to_v = None, math.inf
        self._switch_on()
        self.is_on = True

    def raise_to(self, goal_v: float, *, rate_v_per_s: float, check: Callable[[], None] = lambda: None) -> float:
        """Raise the voltage of a supply that is on, no faster than a rate, and return the settled output, V.

        `check` is called at every step; what it raises ends the ramp.

        Raises
        ------
        BadInput
            If goal or rate are none that the supply can set.
        InstrumentTripped
            If the supply switches itself off on the way.
        InstrumentRejected
            If it refuses a step or its output does not follow.
        """
        return self._move(goal_v, lambda: self._raise(goal_v, rate_v_per_s, check))

    def lower_to(self, goal_v: float, *, check: Callable[[], None] = lambda: None) -> float:
        """Lower the voltage as fast as the supply can, and return the settled output, V."""
        return self._move(goal_v, lambda: self._lower(goal_v, check))

    @abstractmethod
    def read_voltage_v(self) -> float:
        """Voltage at the output, V."""

    @abstractmethod
    def check_on(self) -> None:
        """Raise InstrumentTripped if the supply switched itself off; reading may clear a trip."""

    def _move(self, goal_v: float, move: Callable[[], float]) -> float:
        self.check_voltage(goal_v)
        self._reached_v = None
        settled_v = move()
        self._reached_v = goal_v
        return settled_v

    def _require_untripped(self) -> None:
        """Raise InstrumentTripped if one question tells of a trip."""
        self.check_on()

    @abstractmethod
    def _require_off(self) -> None:
        """Raise InstrumentRejected if one question tells that the supply was switched on."""

    @abstractmethod
    def _order_off(self) -> None:
        """Send the orders that take the voltage off."""

    @abstractmethod
    def _switch_on(self) -> None:
        """Switch on at the lowest voltage."""

    @abstractmethod
    def _raise(self, goal_v: float, rate_v_per_s: float, check: Callable[[], None]) -> float:
        """Raise the voltage, and return the settled output, V."""

    @abstractmethod
    def _lower(self, goal_v: float, check: Callable[[], None]) -> float:
        """Lower the voltage, and return the settled output, V."""

    def _tripped(self, how: str) -> InstrumentTripped:
        return InstrumentTripped.of(self.line.name, "stay on", f"a trip {how}")

    def _wrong_output(self, goal_v: float, got: str) -> InstrumentRejected:
        return self.line.rejection(f"put out {goal_v:g} V as set", got)
