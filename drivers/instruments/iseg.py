"""The gain, natively serial: an iseg NHQ or SHQ supply, which ramps by itself and says its state in three letters.

Facts are from the maker's manuals of the SHQ and EHQ series (legacy command set); what is recalled says so.
"""

import math
import re
import time
from collections.abc import Callable

from drivers.errors import InstrumentTripped
from drivers.instruments.voltage_limits import DISCHARGED_V, FALL_S, check_voltage
from drivers.serial_lines.line import InstrumentLine
from drivers.serial_lines.replies import query_int, rejected_error, reply_error
from labdata.errors import BadInput

LOWEST_V = 10.0
"""Voltage at switching on, V: a set value of 0 then betrays a unit that lost its power meanwhile."""

STEP_V = 1.0
SLOWEST_V_PER_S, FASTEST_V_PER_S = 2, 255
SWITCH_STEP_PERCENT = 10
"""One position of the rotary switch of the hardware limit, % of the nominal voltage; recalled."""

SETTLED_V, SETTLE_S, POLL_S = 2.0, 3.0, 0.1
MANUAL, POSITIVE, SWITCH_OFF = 1, 4, 8  # module status
TRIPS = {"TRP": "on current", "ERR": "at a limit", "INH": "on its inhibit input", "OFF": "at its panel switch",
         "MAN": "to manual control"}  # fmt: skip
STATES = ("ON", "L2H", "H2L", "LAS", "QUA", *TRIPS)
_IDENTITY = re.compile(r"(\d+);([\w.]+);(\d+)V;(\d+(?:\.\d+)?)([um])A")
_SCALED = re.compile(r"([+-]?\d{1,9})([+-]\d{1,2})")
_PLAIN = re.compile(r"[+-]?\d{1,9}(\.\d{1,9})?")


class Iseg:
    """The supply of the microchannel plate, positive polarity, under remote control.

    Parameters
    ----------
    line
        InstrumentLine to the instrument.
    """

    off_commands = (f"V1={FASTEST_V_PER_S}", "D1=0", "G1")
    """There is no off: the fastest ramp to 0 V."""

    reading = "U1"

    def __init__(self, line: InstrumentLine) -> None:
        self.line = line
        self.is_on = False
        self._nominal_v = math.inf

    def identify(self) -> str:
        """Return serial number, firmware and ratings, and clear old latches; a negative unit is InstrumentRejected."""
        identity = self.line.ask("#")
        match = _IDENTITY.fullmatch(identity)
        if match is None:
            raise reply_error(self.line, "be an iseg supply of the legacy command set", repr(identity))
        self._nominal_v = float(match[3])
        if not query_int(self.line, "T1") & POSITIVE:
            raise rejected_error(self.line, "be of positive polarity", "a negative one: turn its polarity switch")
        return identity

    def look(self) -> None:
        """Look for a trip, see `check_on`."""
        if self.is_on:
            self.check_on()

    def check_voltage(self, volts: float) -> None:
        """Refuse (BadInput) a voltage that this unit cannot hold or cannot set so finely."""
        check_voltage(volts, lowest_v=LOWEST_V, highest_v=self._nominal_v, step_v=STEP_V)

    def prepare(self, *, limit_v: float) -> None:
        """Take the voltage off; the hardware limit must stand no higher than its first position at or above a limit, V.

        An old trip is InstrumentTripped. The limit is a rotary switch at the unit, and only a hand can turn it.
        """
        self.order_off()
        if (state := self._state()) in ("TRP", "ERR"):
            raise self._tripped(f"{TRIPS[state]} before anything was switched on")
        position_v = self._nominal_v * SWITCH_STEP_PERCENT / 100.0
        allowed_v = math.ceil(limit_v / position_v - 1e-9) * position_v
        kept_v = self._nominal_v * query_int(self.line, "M1") / 100.0
        if kept_v > allowed_v + 0.5:
            raise rejected_error(
                self.line,
                f"limit itself to {allowed_v:g} V for a limit of {limit_v:g} V",
                f"{kept_v:g} V: turn its rotary switch down",
            )

    def order_off(self) -> None:
        """Order the fastest ramp to 0 V."""
        self.is_on = False
        for command in self.off_commands[:2]:
            self.line.write(command)
        self._start()

    def switch_on(self) -> None:
        """Raise to the lowest voltage; a unit that is switched off or to manual at its panel is InstrumentRejected."""
        status = query_int(self.line, "T1")
        if status & SWITCH_OFF:
            raise rejected_error(self.line, "be switched on at its panel", "its switch off")
        if status & MANUAL:
            raise rejected_error(self.line, "be under remote control", "its switch at manual")
        self._go(LOWEST_V, FASTEST_V_PER_S)
        self.is_on = True

    def raise_to(self, goal_v: float, *, rate_v_per_s: float, check: Callable[[], None] = lambda: None) -> float:
        """Let the unit ramp up no faster than a rate, and return the voltage measured once settled, V.

        Parameters
        ----------
        goal_v
            Voltage to reach, V.
        rate_v_per_s
            Largest rate, V/s; the unit knows whole ones from 2 to 255.
        check
            Called at every look; what it raises ends the wait.

        Raises
        ------
        BadInput
            If goal or rate are none that the unit can set.
        InstrumentRejected
            If the output does not get there.
        """
        self.check_voltage(goal_v)
        rate = min(math.floor(rate_v_per_s), FASTEST_V_PER_S)
        if rate < SLOWEST_V_PER_S:
            raise BadInput(f"ramp_v_per_s must be at least {SLOWEST_V_PER_S} for this supply, got {rate_v_per_s:g}")
        return self._ramp(goal_v, rate, check)

    def lower_to(self, goal_v: float, *, check: Callable[[], None] = lambda: None) -> float:
        """Lower the voltage as fast as the unit can, and return the voltage measured once settled, V."""
        self.check_voltage(goal_v)
        return self._ramp(goal_v, FASTEST_V_PER_S, check)

    def off(self) -> float:
        """Order off, wait until the output is discharged, and return it, V."""
        self.order_off()
        deadline_s = time.monotonic() + FALL_S
        while (volts := self.measured_v()) > DISCHARGED_V:
            if time.monotonic() > deadline_s:
                raise rejected_error(
                    self.line, f"fall below {DISCHARGED_V:g} V within {FALL_S:g} s of off", f"{volts:g} V"
                )
            time.sleep(POLL_S)
        return volts

    def measured_v(self) -> float:
        """Voltage at the output, V."""
        return self._volts("U1")

    def check_on(self) -> None:
        """Raise InstrumentTripped if the unit took its voltage off.

        Reading the state clears a latched trip: only the one owner of the line may do it.
        """
        if (state := self._state()) in TRIPS:
            raise self._tripped(TRIPS[state])
        if self._volts("D1") < LOWEST_V:
            raise self._tripped("without a word: its set value is gone, as after a loss of power")

    def _ramp(self, goal_v: float, rate_v_per_s: int, check: Callable[[], None]) -> float:
        now_v = self.measured_v()
        deadline_s = time.monotonic() + 1.2 * abs(goal_v - now_v) / rate_v_per_s + SETTLE_S
        self._go(goal_v, rate_v_per_s)
        while abs((now_v := self.measured_v()) - goal_v) > SETTLED_V:
            check()
            if time.monotonic() > deadline_s:
                raise rejected_error(self.line, f"put out {goal_v:g} V as set", f"{now_v:g} V")
            time.sleep(POLL_S)
        return now_v

    def _go(self, goal_v: float, rate_v_per_s: int) -> None:
        self.line.write(f"V1={rate_v_per_s}")
        self.line.write(f"D1={goal_v:.0f}")
        if abs((kept_v := self._volts("D1")) - goal_v) > STEP_V / 2:
            raise rejected_error(self.line, f"keep a set value of {goal_v:g} V", f"{kept_v:g} V back")
        self._start()

    def _start(self) -> None:
        self._known_state(self.line.ask("G1"), "G1")

    def _state(self) -> str:
        return self._known_state(self.line.ask("S1"), "S1")

    def _known_state(self, answer: str, question: str) -> str:
        name, mark, state = answer.partition("=")
        if name != "S1" or not mark or state.strip() not in STATES:
            raise reply_error(self.line, f"answer {question} with its state", repr(answer))
        return state.strip()

    def _volts(self, question: str) -> float:
        answer = self.line.ask(question)
        value = legacy_number(answer)
        if value is None:
            raise reply_error(self.line, f"answer {question} with a number", repr(answer))
        return value

    def _tripped(self, how: str) -> InstrumentTripped:
        return InstrumentTripped(f"the {self.line.name} must stay on, got a trip {how}", instrument=self.line.name)


def legacy_number(text: str) -> float | None:
    """Read a number as a model of the legacy set writes it; None if it is none.

    An SHQ writes mantissa and exponent without an E ("-05000-01" is -500.0), an EHQ a plain voltage ("+0100") and a
    current with an exponent of one digit ("0001-7" is 1e-7).
    """
    if match := _SCALED.fullmatch(text):
        return float(f"{match[1]}e{match[2]}")
    return float(text) if _PLAIN.fullmatch(text) else None
