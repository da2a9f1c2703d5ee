"""A virtual Stanford DG535 delay generator behind its GPIB connector: two-letter commands, status bytes, AB output."""

import math
import re
from enum import IntEnum, IntFlag
from pathlib import Path

from simulate.virtual_bench.dg645_settings import RefusedCommand
from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.outputs import GateOutput, publish_gate

STEP_S = 5e-12
LONGEST_S = 1000.0
DEAD_S = 1e-6  # after the longest delay, before the next trigger is taken; recalled
GATE_UNIT_THRESHOLD_V = 1.5
BUFFER_LENGTH = 256
T0, A, B, AB, C, D, CD = 1, 2, 3, 4, 5, 6, 7
EDGES = (A, B, C, D)
OUTPUTS = (T0, A, B, AB, C, D, CD)
LINE_HZ = 60.0


class ErrorStatus(IntFlag):
    """Error status register."""

    UNRECOGNISED = 1
    COUNT = 2
    VALUE = 4
    MODE = 8
    LINKAGE = 16
    RANGE = 32
    RECALL = 64


class InstrumentStatus(IntFlag):
    """Instrument status register."""

    COMMAND_ERROR = 1
    BUSY = 2
    TRIGGERED = 4
    PLL = 8
    RATE = 16


class TriggerMode(IntEnum):
    """Trigger modes of TM."""

    INTERNAL = 0
    EXTERNAL = 1
    SINGLE_SHOT = 2
    BURST = 3
    LINE = 4


class OutputMode(IntEnum):
    """Output levels of OM."""

    TTL = 0
    NIM = 1
    ECL = 2
    VAR = 3


_COMMAND = re.compile(r"([A-Z]{2})(.*)", re.DOTALL)

# One number each, or one per index: (indices, lowest, highest, value when new, form of the answer).
_SETTINGS = {
    "TM": ((), 0, 4, TriggerMode.SINGLE_SHOT, "{:d}"),
    "TL": ((), -2.56, 2.56, 1.0, "{:+.2f}"),
    "TS": ((), 0, 1, 1, "{:d}"),
    "TR": ((0, 1), 1e-3, 1e6, 1e4, "{:.10g}"),
    "TZ": ((0, *OUTPUTS), 0, 1, 1, "{:d}"),
    "OM": (OUTPUTS, 0, 3, OutputMode.TTL, "{:d}"),
    "OP": (OUTPUTS, 0, 1, 1, "{:d}"),
    "OA": (OUTPUTS, -4.0, 4.0, 1.0, "{:+.2f}"),
    "OO": (OUTPUTS, -4.0, 4.0, 0.0, "{:+.2f}"),
}
_ONLY_VARIABLE = ("OA", "OO")


class Dg535:
    """The instrument, as it came; what is set survives a loss of power (recalled)."""

    def __init__(self) -> None:
        self._clear_settings()
        self._errors, self._status = 0, 0
        self._input, self._output = b"", b""
        self._published: GateOutput | None = None

    # The bus

    def listen(self, data: bytes, *, end: bool) -> None:
        """Take bytes from the bus; a line feed or EOI ends a message."""
        *lines, self._input = (self._input + data + (b"\n" if end else b"")).split(b"\n")
        if len(self._input) > BUFFER_LENGTH:
            self._input = b""
            self._errors |= ErrorStatus.UNRECOGNISED
        for line in lines:
            for command in line.decode("ascii", "replace").upper().replace(" ", "").replace("\r", "").split(";"):
                if command:
                    self._take(command)

    def talk(self) -> bytes:
        """Return the answer, EOI with its last byte; empty without a query."""
        said, self._output = self._output, b""
        return said

    def serial_poll(self) -> int:
        """Instrument status by serial poll."""
        return self._status

    def clear(self) -> None:
        """Device clear: empty both buffers."""
        self._input = self._output = b""

    def power_cycle(self) -> None:
        """Power cycle: settings stay, registers and buffers are cleared."""
        self.clear()
        self._errors = self._status = 0

    def _take(self, command: str) -> None:
        try:
            match = _COMMAND.fullmatch(command)
            if match is None:
                raise RefusedCommand(ErrorStatus.UNRECOGNISED)
            answer = self._obey(match[1], match[2].split(",") if match[2] else [])
        except RefusedCommand as refusal:
            self._errors |= refusal.code
            self._status |= InstrumentStatus.COMMAND_ERROR
            return
        if answer is not None:
            self._output = answer.encode() + b"\r\n"

    def _obey(self, name: str, arguments: list[str]) -> str | None:
        if name in _SETTINGS:
            return self._setting(name, arguments)
        if name == "DT":
            return self._delay(arguments)
        if name in ("ES", "IS"):
            return self._register(name, arguments)
        if name not in ("CL", "SS"):
            raise RefusedCommand(ErrorStatus.UNRECOGNISED)
        if arguments:
            raise RefusedCommand(ErrorStatus.COUNT)
        if name == "CL":
            self._clear_settings()
        elif self._values["TM", 0] != TriggerMode.SINGLE_SHOT:
            raise RefusedCommand(ErrorStatus.MODE)
        return None

    def _setting(self, name: str, arguments: list[str]) -> str | None:
        indices, lowest, highest, _, form = _SETTINGS[name]
        asked = len(arguments) == bool(indices)
        if not asked and len(arguments) != bool(indices) + 1:
            raise RefusedCommand(ErrorStatus.COUNT)
        index = _whole(arguments[0]) if indices else 0
        if indices and index not in indices:
            raise RefusedCommand(ErrorStatus.VALUE)
        whole = form == "{:d}"
        if asked:
            value = self._values[name, index]
            return form.format(int(value) if whole else value)
        value = _whole(arguments[-1]) if whole else _real(arguments[-1])
        if not lowest <= value <= highest:
            raise RefusedCommand(ErrorStatus.VALUE)
        if name in _ONLY_VARIABLE and self._values["OM", index] != OutputMode.VAR:
            raise RefusedCommand(ErrorStatus.MODE)
        self._values[name, index] = float(f"{value:.4g}") if name == "TR" else value
        return None

    def _delay(self, arguments: list[str]) -> str | None:
        if len(arguments) not in (1, 3):
            raise RefusedCommand(ErrorStatus.COUNT)
        edge = _whole(arguments[0])
        if edge not in EDGES:
            raise RefusedCommand(ErrorStatus.VALUE)
        if len(arguments) == 1:
            picoseconds = 5 * abs(self._steps[edge])
            sign = "-" if self._steps[edge] < 0 else "+"
            return f"{self._reference[edge]},{sign}{picoseconds // 10**12}.{picoseconds % 10**12:012d}"
        reference = _whole(arguments[1])
        if reference not in (T0, *EDGES):
            raise RefusedCommand(ErrorStatus.VALUE)
        kept = dict(self._reference), dict(self._steps)
        seconds = _real(arguments[2])
        if not abs(seconds) < LONGEST_S:
            raise RefusedCommand(ErrorStatus.RANGE)
        self._reference[edge], self._steps[edge] = reference, round(seconds / STEP_S)
        try:
            if any(not 0 <= self._after_trigger_s(other) < LONGEST_S for other in EDGES):
                raise RefusedCommand(ErrorStatus.RANGE)
        except RefusedCommand:
            self._reference, self._steps = kept
            raise
        return None

    def _after_trigger_s(self, edge: int) -> float:
        steps, seen = 0, set()
        while edge != T0:
            if edge in seen:
                raise RefusedCommand(ErrorStatus.LINKAGE)
            seen.add(edge)
            steps, edge = steps + self._steps[edge], self._reference[edge]
        return steps * STEP_S

    def _register(self, name: str, arguments: list[str]) -> str:
        if len(arguments) > 1:
            raise RefusedCommand(ErrorStatus.COUNT)
        mask = 0xFF
        if arguments:
            if not 0 <= _whole(arguments[0]) <= 7:
                raise RefusedCommand(ErrorStatus.VALUE)
            mask = 1 << _whole(arguments[0])
        if name == "ES":
            value, self._errors = self._errors & mask, self._errors & ~mask
        else:
            value, self._status = self._status & mask, self._status & ~mask
        return str(int(bool(value)) if arguments else value)

    def _clear_settings(self) -> None:
        self._values: dict[tuple[str, int], float] = {
            (name, index): value for name, (indices, _, _, value, _) in _SETTINGS.items() for index in indices or (0,)
        }
        self._reference: dict[int, int] = dict.fromkeys(EDGES, T0)
        self._steps: dict[int, int] = dict.fromkeys(EDGES, 0)

    # Physics

    def gate(self) -> GateOutput:
        """What the AB output does to a gate unit that opens above its threshold."""
        idle_v, active_v = self._levels_v()
        if idle_v > GATE_UNIT_THRESHOLD_V:
            return GateOutput(gate_open=True, gate_ns=math.inf, gate_hz=0.0)
        width_ns = abs(self._after_trigger_s(B) - self._after_trigger_s(A)) * 1e9
        rate_hz = self._pulse_hz()
        if active_v <= GATE_UNIT_THRESHOLD_V or not width_ns or not rate_hz:
            return GateOutput()
        trigger = "mains" if int(self._values["TM", 0]) == TriggerMode.LINE else "clock"
        delay_ns = min(self._after_trigger_s(A), self._after_trigger_s(B)) * 1e9
        return GateOutput(
            gate_open=True, gate_ns=width_ns, gate_hz=rate_hz, gate_trigger=trigger, gate_delay_ns=delay_ns
        )

    def _levels_v(self) -> tuple[float, float]:
        mode = self._values["OM", AB]
        if mode == OutputMode.VAR:
            return self._values["OO", AB], self._values["OO", AB] + self._values["OA", AB]
        levels_v = {OutputMode.TTL: (0.0, 4.0), OutputMode.NIM: (-0.8, 0.0), OutputMode.ECL: (-1.8, -0.8)}
        low_v, high_v = levels_v[OutputMode(int(mode))]
        return (low_v, high_v) if self._values["OP", AB] else (high_v, low_v)

    def _trigger_hz(self) -> float:
        rates_hz = {TriggerMode.INTERNAL: self._values["TR", 0], TriggerMode.LINE: LINE_HZ}
        return rates_hz.get(TriggerMode(int(self._values["TM", 0])), 0.0)

    def _busy_s(self) -> float:
        return max(self._after_trigger_s(edge) for edge in EDGES) + DEAD_S

    def _pulse_hz(self) -> float:
        triggers_hz = self._trigger_hz()
        return triggers_hz / math.ceil(triggers_hz * self._busy_s() - 1e-12) if triggers_hz else 0.0

    def advance(self, now_s: float, faults: Faults) -> None:
        """Update the status of triggers used and lost."""
        if triggers_hz := self._trigger_hz():
            self._status |= InstrumentStatus.TRIGGERED | (
                InstrumentStatus.RATE if triggers_hz * self._busy_s() > 1 else 0
            )

    def publish(self, folder: Path) -> None:
        """Publish the gate drive if it changed."""
        gate = self.gate()
        if gate != self._published:
            publish_gate(folder, gate)
            self._published = gate


def _whole(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise RefusedCommand(ErrorStatus.VALUE) from None


def _real(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise RefusedCommand(ErrorStatus.VALUE) from None
    if not math.isfinite(value):
        raise RefusedCommand(ErrorStatus.VALUE)
    return value
