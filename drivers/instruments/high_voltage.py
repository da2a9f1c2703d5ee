"""The gain: a Stanford PS350 high-voltage supply across the microchannel plate, raised slowly and verified."""

import re
import time
from collections.abc import Callable

from drivers.errors import InstrumentRejected, InstrumentReplyError, InstrumentTripped
from drivers.instruments.voltage_limits import DISCHARGED_V, FALL_S, check_voltage
from drivers.serial_lines.line import InstrumentLine
from drivers.serial_lines.replies import query_float, query_int

IDENTITY = r"(?i).*(PS3\d\d|2290).*"
MINIMUM_V, FULL_SCALE_V, STEP_V = 50.0, 5000.0, 1.0  # minimum and step are recalled
STEP_LARGEST_V = 50.0
STEP_S = 0.2
SETTLED_V = 2.0
SETTLE_S, SETTLE_READINGS = 0.1, 25
VOLTAGE_TRIP, CURRENT_TRIP, CURRENT_LIMIT, HV_ON = 2, 4, 8, 128
EXECUTION_ERROR, COMMAND_ERROR = 16, 32

OFF_COMMAND = "HVOF"


class HighVoltage:
    """The supply of the microchannel plate, positive polarity.

    Parameters
    ----------
    line
        InstrumentLine to the instrument.
    """

    off_commands = (OFF_COMMAND,)
    reading = "VOUT?"

    def __init__(self, line: InstrumentLine) -> None:
        self.line = line
        self.is_on = False
        """Whether this object switched it on and not off; the status byte belongs to whoever watches for trips."""

    def identify(self) -> str:
        """Return the instrument's identity and clear old status; another instrument is InstrumentReplyError."""
        identity = self.line.ask("*IDN?")
        if not re.fullmatch(IDENTITY, identity):
            raise InstrumentReplyError(
                f"the {self.line.name} must be of the PS300 series, got {identity[:80]!r}", instrument=self.line.name
            )
        self.line.write("*CLS")
        return identity

    def look(self) -> None:
        """Look for a trip, see `check_on`."""
        if self.is_on:
            self.check_on()

    def check_voltage(self, volts: float) -> None:
        """Refuse (BadInput) a voltage that this model cannot hold or cannot set so finely."""
        check_voltage(volts, lowest_v=MINIMUM_V, highest_v=FULL_SCALE_V, step_v=STEP_V)

    def prepare(self, *, limit_v: float) -> None:
        """Switch off, and make the supply itself refuse more than a limit, V; an old trip is InstrumentTripped."""
        self.order_off()
        if self._status() & (VOLTAGE_TRIP | CURRENT_TRIP):
            raise self._tripped("before anything was switched on")
        self._set(f"VSET {MINIMUM_V:.0f}")
        self._set(f"VLIM {limit_v:.0f}")
        if (kept_v := query_float(self.line, "VLIM?")) > limit_v:
            raise self._refused(f"must keep a limit of {limit_v:g} V, got {kept_v:g} V back")

    def order_off(self) -> None:
        """Order the high voltage off; the charge takes seconds to leave, see `measured_v`."""
        self.line.write(OFF_COMMAND)
        self.is_on = False
        self._refuse_errors(OFF_COMMAND)

    def switch_on(self) -> None:
        """Switch on at the lowest voltage; a trip that was not cleared at the instrument is InstrumentTripped."""
        self._set(f"VSET {MINIMUM_V:.0f}")
        self.line.write("HVON")
        if query_int(self.line, "*ESR?") & EXECUTION_ERROR:
            raise self._tripped("not cleared since: find its cause, then clear it at the instrument")
        self.is_on = True

    def raise_to(self, goal_v: float, *, rate_v_per_s: float, check: Callable[[], None] = lambda: None) -> float:
        """Raise the voltage of a supply that is on, in small steps no faster than a rate.

        Parameters
        ----------
        goal_v
            Voltage to reach, V.
        rate_v_per_s
            Largest rate, V/s; no step is larger than 50 V.
        check
            Called at every step; what it raises ends the ramp.

        Returns
        -------
        float
            Voltage measured at the output once settled, V.

        Raises
        ------
        BadInput
            If the goal is below the supply's minimum.
        InstrumentTripped
            If the supply switches off on the way.
        InstrumentRejected
            If it refuses a step or its output does not follow.
        """
        self.check_voltage(goal_v)
        start_v = query_float(self.line, "VSET?")
        step_v = min(STEP_LARGEST_V, rate_v_per_s * STEP_S)
        began_s, level_v = time.monotonic(), start_v
        while level_v < goal_v:
            level_v = min(level_v + step_v, goal_v)
            time.sleep(max(0.0, began_s + (level_v - start_v) / rate_v_per_s - time.monotonic()))
            check()
            self._set(f"VSET {level_v:.10g}")
        return self._settled_v(goal_v, check)

    def lower_to(self, goal_v: float, *, check: Callable[[], None] = lambda: None) -> float:
        """Lower the voltage at once, as fast as the load lets it fall, and return the settled output, V."""
        self.check_voltage(goal_v)
        self._set(f"VSET {goal_v:.10g}")
        deadline_s = time.monotonic() + FALL_S
        while self.measured_v() > goal_v + SETTLED_V and time.monotonic() < deadline_s:
            check()
            time.sleep(SETTLE_S)
        return self._settled_v(goal_v, check)

    def off(self) -> float:
        """Order off and wait until the output is discharged; return it, V."""
        self.order_off()
        deadline_s = time.monotonic() + FALL_S
        while (volts := self.measured_v()) > DISCHARGED_V:
            if time.monotonic() > deadline_s:
                raise self._refused(f"must fall below {DISCHARGED_V:g} V within {FALL_S:g} s of off, got {volts:g} V")
            time.sleep(SETTLE_S)
        return volts

    def measured_v(self) -> float:
        """Voltage at the output, V."""
        return query_float(self.line, "VOUT?")

    def check_on(self) -> None:
        """Raise InstrumentTripped if the supply switched itself off.

        Reading the status byte clears its trips: only the one owner of the line may do it.
        """
        status = self._status()
        if status & VOLTAGE_TRIP:
            raise self._tripped("on voltage")
        if status & CURRENT_TRIP:
            raise self._tripped("on current")
        if not status & HV_ON:
            raise self._tripped("without a trip bit")

    def _settled_v(self, goal_v: float, check: Callable[[], None]) -> float:
        """Output once two readings agree; a driver's usual patience."""
        before_v = now_v = self.measured_v()
        for reading in range(SETTLE_READINGS):
            time.sleep(SETTLE_S + 0.5 * SETTLE_S * reading)
            check()
            now_v = self.measured_v()
            if abs(now_v - before_v) < SETTLED_V:
                break
            before_v = now_v
        if abs(now_v - goal_v) > SETTLED_V:
            raise self._refused(f"must put out {goal_v:g} V as set, got {now_v:g} V")
        return now_v

    def _set(self, command: str) -> None:
        self.line.write(command)
        self._refuse_errors(command)

    def _refuse_errors(self, command: str) -> None:
        if code := query_int(self.line, "*ESR?") & (EXECUTION_ERROR | COMMAND_ERROR):
            meaning = "not possible in its present state or range" if code & EXECUTION_ERROR else "not understood"
            raise self._refused(f"must accept {command!r}, got event status {code}: {meaning}", code)

    def _status(self) -> int:
        return query_int(self.line, "*STB?")

    def _refused(self, rule: str, code: int | None = None) -> InstrumentRejected:
        return InstrumentRejected(f"the {self.line.name} {rule}", instrument=self.line.name, code=code)

    def _tripped(self, how: str) -> InstrumentTripped:
        return InstrumentTripped(f"the {self.line.name} must stay on, got a trip {how}", instrument=self.line.name)
