"""Common part of the high-voltage supplies: range, discharge and comparison with the set-point."""

import math
import time
from abc import abstractmethod
from collections.abc import Callable
from typing import ClassVar

from drivers.errors import InstrumentRejected, InstrumentTripped
from drivers.instruments.instrument import Instrument
from drivers.serial_lines.line import InstrumentLine
from labdata.errors import BadInput

FALL_S = 15.0  # Longest discharge of an output after off, s
DISCHARGED_V = 10.0  # Largest voltage of a discharged output, V
SETTLED_V = 2.0  # Settling tolerance of an output, V: two steps of the coarsest display

# Deviation from the set-point, or rise after off, that counts as a change at the panel, V
# Accuracy of the measured output, V: 0.05 % of the 5 kV full scale of a PS350; an SHQ is better
# (data sheets)
HELD_V = SETTLED_V + 2.5

POLL_S = 0.1


class Supply(Instrument):
    """A high-voltage supply of positive polarity across the microchannel plate.

    It stores its set-point, and `look` compares the measured output with it.
    """

    # Commands that switch the high voltage off, sent one by one by the safe action
    off_commands: ClassVar[tuple[str, ...]]

    reading: ClassVar[str]  # Query of the output voltage, for the log

    lowest_v: ClassVar[float]
    step_v: ClassVar[float] = 1.0
    highest_v: float

    def __init__(self, line: InstrumentLine) -> None:
        super().__init__(line)
        self.is_on = False  # Whether this driver switched it on and not off
        self._reached_v: float | None = None  # set-point that the output has reached
        # lowest output seen since it was ordered off; None: nothing was set
        self._fallen_to_v: float | None = None

    def look(self) -> None:
        """Compare the output with the set-point: on, no trip and near it; off, not on again and not
        rising.

        A supply that switched itself off is InstrumentTripped, one that was set at its panel
        InstrumentRejected.
        """
        if self.is_on:
            self._require_untripped()
            if (
                self._reached_v is not None
                and abs((now_v := self.read_voltage_v()) - self._reached_v) > HELD_V
            ):
                self.check_on()
                raise self.line.rejection(
                    f"put out {self._reached_v:g} V as set",
                    f"{now_v:g} V: somebody changed it at the panel",
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
        """Require a voltage in the supply's range, without rounding to its steps."""
        if not volts >= self.lowest_v:
            raise BadInput(f"mcp_v must be 0 (off) or at least {self.lowest_v:g}, got {volts:g}")
        if volts > self.highest_v:
            raise BadInput(f"mcp_v must not exceed the supply's {self.highest_v:g}, got {volts:g}")
        if abs(volts / self.step_v - round(volts / self.step_v)) > 1e-6:
            raise BadInput(
                f"mcp_v must be a multiple of the supply's {self.step_v:g} V, got {volts:.10g}"
            )

    @abstractmethod
    def prepare(self, *, limit_v: float) -> None:
        """Switch off, and set the supply's own limit, V; an old trip is InstrumentTripped."""

    def order_off(self) -> None:
        """Send the off command; the output discharges within seconds, see `read_voltage_v`."""
        self.is_on, self._reached_v, self._fallen_to_v = False, None, math.inf
        self._order_off()

    def off(self) -> float:
        """Switch off, wait until the output is discharged, and return its voltage, V."""
        self.order_off()
        deadline_s = time.monotonic() + FALL_S
        while (volts := self.read_voltage_v()) > DISCHARGED_V:
            if time.monotonic() > deadline_s:
                raise self.line.rejection(
                    f"fall below {DISCHARGED_V:g} V within {FALL_S:g} s of off", f"{volts:g} V"
                )
            time.sleep(POLL_S)
        return volts

    def switch_on(self) -> None:
        """Switch on at the lowest voltage."""
        self._reached_v, self._fallen_to_v = None, math.inf
        self._switch_on()
        self.is_on = True

    def raise_to(
        self, goal_v: float, *, rate_v_per_s: float, check: Callable[[], None] = lambda: None
    ) -> float:
        """Raise the voltage of a supply that is on at a limited rate, and return the settled
        output, V.

        `check` is called at every step; an exception ends the ramp. A supply that switches itself
        off is InstrumentTripped, one that refuses a step or does not follow InstrumentRejected.
        """
        return self._move(goal_v, lambda: self._raise(goal_v, rate_v_per_s, check))

    def lower_to(self, goal_v: float, *, check: Callable[[], None] = lambda: None) -> float:
        """Lower the voltage as fast as the supply can, and return the settled output, V."""
        return self._move(goal_v, lambda: self._lower(goal_v, check))

    @abstractmethod
    def read_voltage_v(self) -> float:
        """Return the measured output voltage, V."""

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
        """Raise InstrumentTripped if a single query reports a trip."""
        self.check_on()

    @abstractmethod
    def _require_off(self) -> None:
        """Raise InstrumentRejected if a single query reports the supply on."""

    @abstractmethod
    def _order_off(self) -> None:
        """Send the commands that switch the voltage off."""

    @abstractmethod
    def _switch_on(self) -> None:
        """Switch on at the lowest voltage."""

    @abstractmethod
    def _raise(self, goal_v: float, rate_v_per_s: float, check: Callable[[], None]) -> float:
        """Raise the voltage, and return the settled output, V."""

    @abstractmethod
    def _lower(self, goal_v: float, check: Callable[[], None]) -> float:
        """Lower the voltage, and return the settled output, V."""

    def _trip_error(self, how: str) -> InstrumentTripped:
        return InstrumentTripped.of(self.line.name, "stay on", f"a trip {how}")

    def _wrong_output(self, goal_v: float, got: str) -> InstrumentRejected:
        return self.line.rejection(f"put out {goal_v:g} V as set", got)
