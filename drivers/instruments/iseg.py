"""High-voltage supply: iseg NHQ or SHQ with its own ramp.

Source: the maker's manuals of the SHQ and EHQ series (legacy command set), unless marked
unverified.
"""

import math
import re
import time
from collections.abc import Callable

from drivers.instruments.instrument import InstrumentModel
from drivers.instruments.voltage_limits import POLL_S, SETTLED_V, Supply
from drivers.serial_lines.line import EchoCheckedLine, InstrumentLine, KnownAnswer
from labdata.errors import BadInput

SLOWEST_V_PER_S, FASTEST_V_PER_S = 2, 255

SETTLE_S = 3.0
MANUAL, POSITIVE, SWITCH_OFF = 1, 4, 8  # module status
TRIPS = {
    "TRP": "on current",
    "ERR": "at a limit",
    "INH": "on its inhibit input",
    "OFF": "at its panel switch",
    "MAN": "to manual control",
}
STATES = ("ON", "L2H", "H2L", "LAS", "QUA", *TRIPS)
KNOWN = KnownAnswer(question="#", form=r"\d+;[\w.]+;\d+V;\d+(\.\d+)?[um]A")
_SCALED = re.compile(r"([+-]?\d{1,9})([+-]\d{1,2})")
_PLAIN = re.compile(r"[+-]?\d{1,9}(\.\d{1,9})?")

END = b"\r\n"

QUICK = "W=1"

REFUSALS = (
    (r"\?\?\?\?", "it does not understand"),
    (r"\?WCN", "it has no such channel"),
    (r"\?TOT", "the command was not over in time, and it restarts"),
    (r"\? ?UMAX=.*", "beyond its limit"),
)


class IsegLine(EchoCheckedLine):
    """Line of an iseg supply, two text lines per exchange; parameters as for `InstrumentLine`.

    The echo is compared every time, so that echo and reply cannot be confused.
    """

    def _order(self, command: str) -> None:
        # The empty line ends an incomplete command of another program.
        self._send(END + command.encode("ascii") + END)
        self._drain()  # the unit accepts the next command after the echo

    def _get_into_step(self) -> None:
        """Resynchronise: select fast replies, discard late input, and wait for the identity."""
        self._send(END + QUICK.encode() + END)
        # By default the unit waits about 255 ms after each character it sends
        # the echo and answer of one question and the echo of QUICK: 22 characters
        self._drain(quiet_s=0.5, within_s=6.0)
        self._send(KNOWN.question.encode() + END)
        self._await_known(END, KNOWN)

    def _exchange(self, question: str) -> str:
        self._send(question.encode("ascii") + END)
        echo = self._until(END, f"the echo of {question}")
        if echo != question:
            raise self.reply_error(f"echo {question!r}", repr(echo[:80]))
        return self._until(END, question).strip()

    def _refusal(self, answer: str) -> str | None:
        meanings = (meaning for form, meaning in REFUSALS if re.fullmatch(form, answer))
        return next((f"{answer}: {meaning}" for meaning in meanings), None)


class Iseg(Supply):
    """iseg NHQ or SHQ supply under remote control."""

    # There is no off command: the fastest ramp to 0 V
    off_commands = f"V1={FASTEST_V_PER_S}", "D1=0", "G1"

    reading = "U1"
    lowest_v = 10.0  # Voltage at switching on, V, so that a set value of 0 reveals a loss of power

    def __init__(self, line: InstrumentLine) -> None:
        super().__init__(line)
        self.highest_v = math.inf

    def identify(self) -> str:
        """Return serial number, firmware and ratings, and clear old latches; a negative unit is
        InstrumentRejected.
        """
        identity = self._identity(
            KNOWN.question, KNOWN.form, "an iseg supply of the legacy command set"
        )
        self.highest_v = float(identity.split(";")[2].removesuffix("V"))
        if not self.line.query_int("T1") & POSITIVE:
            raise self.line.rejection(
                "be of positive polarity", "a negative one: turn its polarity switch"
            )
        return identity

    def prepare(self, *, limit_v: float) -> None:
        """Switch off; require the rotary switch of the limit at its first position at or above a
        limit, V, or lower.
        """
        self.order_off()
        if (state := self._state()) in ("TRP", "ERR"):
            raise self._trip_error(f"{TRIPS[state]} before anything was switched on")
        # One position of the rotary switch of the hardware limit, % of the nominal voltage
        # (unverified)
        position_v = self.highest_v * 10 / 100.0
        allowed_v = math.ceil(limit_v / position_v - 1e-9) * position_v
        kept_v = self.highest_v * self.line.query_int("M1") / 100.0
        if kept_v > allowed_v + 0.5:
            raise self.line.rejection(
                f"limit itself to {allowed_v:g} V for a limit of {limit_v:g} V",
                f"{kept_v:g} V: turn its rotary switch down",
            )

    def read_voltage_v(self) -> float:
        return self._volts("U1")

    def check_on(self) -> None:
        self._require_untripped()
        if self._volts("D1") < self.lowest_v:
            raise self._trip_error(
                "without a word: its set value is gone, as after a loss of power"
            )

    def _require_untripped(self) -> None:
        # Reading the state clears a latched trip: only the owner of the line may do it.
        if (state := self._state()) in TRIPS:
            raise self._trip_error(TRIPS[state])

    def _require_off(self) -> None:
        if (state := self._state()) in ("L2H", "MAN"):
            raise self.line.rejection("stay off", f"{state}: somebody switched it on at the panel")

    def _order_off(self) -> None:
        for command in self.off_commands[:2]:
            self.line.write(command)
        self._state("G1")

    def _switch_on(self) -> None:
        """Raise to the lowest voltage; a unit off or under manual control at its panel is
        InstrumentRejected.
        """
        status = self.line.query_int("T1")
        if status & SWITCH_OFF:
            raise self.line.rejection("be switched on at its panel", "its switch off")
        if status & MANUAL:
            raise self.line.rejection("be under remote control", "its switch at manual")
        self._go(self.lowest_v, FASTEST_V_PER_S)

    def _raise(self, goal_v: float, rate_v_per_s: float, check: Callable[[], None]) -> float:
        rate = min(math.floor(rate_v_per_s), FASTEST_V_PER_S)
        if rate < SLOWEST_V_PER_S:
            raise BadInput(
                f"ramp_v_per_s must be at least {SLOWEST_V_PER_S} for this supply, got "
                f"{rate_v_per_s:g}"
            )
        return self._ramp(goal_v, rate, check)

    def _lower(self, goal_v: float, check: Callable[[], None]) -> float:
        return self._ramp(goal_v, FASTEST_V_PER_S, check)

    def _ramp(self, goal_v: float, rate_v_per_s: int, check: Callable[[], None]) -> float:
        now_v = self.read_voltage_v()
        deadline_s = time.monotonic() + 1.2 * abs(goal_v - now_v) / rate_v_per_s + SETTLE_S
        self._go(goal_v, rate_v_per_s)
        while abs((now_v := self.read_voltage_v()) - goal_v) > SETTLED_V:
            check()
            self.check_on()
            if time.monotonic() > deadline_s:
                raise self._wrong_output(goal_v, f"{now_v:g} V")
            time.sleep(POLL_S)
        return now_v

    def _go(self, goal_v: float, rate_v_per_s: int) -> None:
        self.line.write(f"V1={rate_v_per_s}")
        self.line.write(f"D1={goal_v:.0f}")
        if abs((kept_v := self._volts("D1")) - goal_v) > self.step_v / 2:
            raise self.line.rejection(f"keep a set value of {goal_v:g} V", f"{kept_v:g} V back")
        self._state("G1")

    def _state(self, question: str = "S1") -> str:
        """Return the state, which is also the reply to a ramp start ("G1")."""
        name, mark, state = (answer := self.line.ask(question)).partition("=")
        if name != "S1" or not mark or state.strip() not in STATES:
            raise self.line.reply_error(f"answer {question} with its state", repr(answer))
        return state.strip()

    def _volts(self, question: str) -> float:
        answer = self.line.ask(question)
        if (value := legacy_number(answer)) is None:
            raise self.line.reply_error(f"answer {question} with a number", repr(answer))
        return value


def legacy_number(text: str) -> float | None:
    """Parse a number of the legacy command set; None if it is invalid.

    An SHQ sends mantissa and exponent without an E ("-05000-01" is -500.0), an EHQ a plain voltage
    ("+0100") and a current with an exponent of one digit ("0001-7" is 1e-7).
    """
    if match := _SCALED.fullmatch(text):
        return float(f"{match[1]}e{match[2]}")
    return float(text) if _PLAIN.fullmatch(text) else None


MODEL = InstrumentModel(
    name="iseg",
    role="supply",
    title="high-voltage supply",
    line=lambda port, address: IsegLine(port, name="high-voltage supply"),
    driver=Iseg,
)
