"""A virtual iseg SHQ high-voltage supply: echo, two-line exchanges, its own ramp, states, latches
and a slow start.
"""

import math

from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.instrument import (
    LOAD_OHM,
    RefusedCommand,
    VirtualModel,
    VoltageSource,
    parse_number,
)

IDENTITY = "480012;3.15;3000V;100uA"
HARDWARE_LIMIT_PERCENT = 30  # position of the rotary switch
END = b"\r\n"
BUFFER_LENGTH = 64
COMMAND_S = 2e-3
# The break between output characters is said to be 0 ms after power-up and is the longest until it
# is set.
LONGEST_BREAK_MS = 255
SETTLED_V = 1.0
MANUAL, POSITIVE = 1, 4
SYNTAX, WRONG_CHANNEL = "????", "?WCN"


class IsegSupply(VoltageSource):
    """High-voltage supply after power-on: 0 V, positive, remote control; faster than life by
    `time_scale`.
    """

    def __init__(self, *, time_scale: float = 1.0) -> None:
        super().__init__(time_scale=time_scale)
        self.power_cycle()

    def power_cycle(self) -> None:
        """Power cycle: settings are lost and the load discharges the output."""
        self._break_ms, self._break_said = LONGEST_BREAK_MS, 0
        self._set_v, self._goal_v, self._ramp_v_per_s = 0.0, 0.0, 2
        self._trip_a = 0.0
        self._tripped, self._beyond = False, False
        self._line, self._powered_down = b"", True

    # The line

    def receive(self, data: bytes) -> list[tuple[float, bytes]]:
        """Take bytes; return echo and answers, each character with the break before it, s."""
        replies: list[tuple[float, bytes]] = []
        for value in data:
            byte = bytes([value])
            replies.append((self._break_ms * 1e-3, byte))
            self._line += byte
            if byte == b"\n":
                line, self._line = self._line.decode("ascii", "replace").strip(), b""
                if line:
                    replies += self._answer(line)
            elif len(self._line) > BUFFER_LENGTH:
                self._line = b""
                replies += self._spoken(SYNTAX)
        return replies

    def _answer(self, line: str) -> list[tuple[float, bytes]]:
        try:
            answer = self._obey(line)
        except RefusedCommand as refusal:
            answer = str(refusal.code)
        return [(COMMAND_S, b""), *self._spoken(answer)]

    def _spoken(self, answer: str) -> list[tuple[float, bytes]]:
        return [(self._break_ms * 1e-3, bytes([byte])) for byte in answer.encode() + END]

    def _obey(self, line: str) -> str:
        name, mark, value = line.upper().partition("=")
        if name == "#" and not mark:
            return IDENTITY
        if name == "W":
            return self._break(value) if mark else f"{self._break_said:03d}"
        if len(name) != 2 or not name[1].isdigit():
            raise RefusedCommand(SYNTAX)
        if name[1] != "1":
            raise RefusedCommand(WRONG_CHANNEL)
        if mark:
            sets = {"D": self._set_voltage, "V": self._set_ramp, "L": self._set_trip}
            if name[0] not in sets:
                raise RefusedCommand(SYNTAX)
            sets[name[0]](parse_number(value, float, SYNTAX))
            return ""
        asks = {
            "U": lambda: _format_scaled(self.output_v, -1),
            "I": lambda: _format_scaled(self.output_v / LOAD_OHM, -9),
            "M": lambda: f"{HARDWARE_LIMIT_PERCENT:03d}",
            "N": lambda: "100",
            "D": lambda: _format_scaled(self._set_v, -1),
            "V": lambda: f"{self._ramp_v_per_s:03d}",
            "L": lambda: _format_scaled(self._trip_a, -9),
            "G": self._start,
            "S": self._take_state,
            "T": lambda: f"{POSITIVE:03d}",
            "A": lambda: "000",
        }
        if name[0] not in asks:
            raise RefusedCommand(SYNTAX)
        return asks[name[0]]()

    def _break(self, value: str) -> str:
        milliseconds = round(parse_number(value, float, SYNTAX))
        if not 0 <= milliseconds <= LONGEST_BREAK_MS:
            raise RefusedCommand(SYNTAX)
        self._break_ms = self._break_said = milliseconds
        return ""

    def _set_voltage(self, volts: float) -> None:
        limit_v = 3000.0 * HARDWARE_LIMIT_PERCENT / 100.0
        if not 0 <= volts <= limit_v:
            raise RefusedCommand(f"? UMAX={limit_v:04.0f}")
        self._set_v = round(volts, 2)

    def _set_ramp(self, volts_per_s: float) -> None:
        if volts_per_s != round(volts_per_s) or not 2 <= volts_per_s <= 255:
            raise RefusedCommand(SYNTAX)
        self._ramp_v_per_s = round(volts_per_s)

    def _set_trip(self, current: float) -> None:
        self._trip_a = current * 1e-9

    def _start(self) -> str:
        if not (self._tripped or self._beyond):
            self._goal_v, self._powered_down = self._set_v, False
        return f"S1={self._state():<3}"

    def _take_state(self) -> str:
        state = self._state()
        if self._tripped or self._beyond:
            # The latch opens when it is read; the set value must be started anew.
            self._tripped = self._beyond = False
        return f"S1={state:<3}"

    def _state(self) -> str:
        if self._tripped:
            return "TRP"
        if self._beyond:
            return "ERR"
        if abs(self.output_v - self._goal_v) < SETTLED_V:
            return "ON"
        return "L2H" if self.output_v < self._goal_v else "H2L"

    # Physics

    def advance(self, now_s: float, faults: Faults) -> None:
        """Advance the ramp to a time, s; after a trip or a loss of power the load discharges the
        output.
        """
        elapsed_s = self._pass_time(now_s)
        if self._goal_v and (faults.tripped or 0 < self._trip_a < self.output_v / LOAD_OHM):
            self._tripped, self._goal_v = True, 0.0
        largest_v = self._ramp_v_per_s * elapsed_s
        if self._tripped or self._powered_down:
            self.output_v *= math.exp(-elapsed_s)
        elif self.output_v < self._goal_v:
            self.output_v = min(self._goal_v, self.output_v + largest_v)
        else:
            self.output_v = max(self._goal_v, self.output_v - largest_v)
        if self.output_v < 0.05:
            self.output_v = 0.0


def _format_scaled(value: float, exponent: int) -> str:
    """Format a number as the SHQ does: sign, five digits, signed exponent, no E."""
    return f"{round(value / 10.0**exponent):+06d}{exponent:+03d}"


MODEL = VirtualModel(
    name="iseg",
    bench_name="high_voltage",
    make=lambda address, scale: IsegSupply(time_scale=scale),
    baud=9600,
    panel={"voltage": ("D1=350", "G1"), "on": ("D1=100", "G1")},
)
