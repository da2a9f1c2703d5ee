"""A virtual Stanford DG535 delay generator behind its GPIB connector: two-letter commands, status
bytes, AB output.
"""

import re
from enum import IntEnum, IntFlag
from typing import Any

from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.instrument import (
    LINE_HZ,
    STEP_S,
    BusInstrument,
    EdgeDelays,
    GateGenerator,
    RefusedCommand,
    VirtualModel,
    parse_number,
    read_register,
)
from simulate.virtual_bench.outputs import Trigger
from simulate.virtual_bench.prologix import PrologixAdapter

LONGEST_S = 1000.0
T0, A, B, AB, C, D, CD = 1, 2, 3, 4, 5, 6, 7
EDGES = (A, B, C, D)
OUTPUTS = (T0, A, B, AB, C, D, CD)


class ErrorStatus(IntFlag):
    """Error status register."""

    UNRECOGNISED = 1
    COUNT = 2
    VALUE = 4
    MODE = 8
    LINKAGE = 16
    RANGE = 32


class InstrumentStatus(IntFlag):
    """Instrument status register."""

    COMMAND_ERROR = 1
    TRIGGERED = 4
    RATE = 16


class TriggerMode(IntEnum):
    """Trigger modes of TM."""

    INTERNAL = 0
    EXTERNAL = 1
    SINGLE_SHOT = 2
    LINE = 4


_COMMAND = re.compile(r"([A-Z]{2})(.*)", re.DOTALL)
_LEVELS_V = {0: (0.0, 4.0), 1: (-0.8, 0.0), 2: (-1.8, -0.8)}  # TTL, NIM, ECL
VARIABLE = 3

# One number each, or one per index: (indices, lowest, highest, value when new, form of the answer).
_SETTINGS = {
    "TM": ((), 0, 4, TriggerMode.SINGLE_SHOT, "{:d}"),
    "TL": ((), -2.56, 2.56, 1.0, "{:+.2f}"),
    "TS": ((), 0, 1, 1, "{:d}"),
    "TR": ((0, 1), 1e-3, 1e6, 1e4, "{:.10g}"),
    "TZ": ((0, *OUTPUTS), 0, 1, 1, "{:d}"),
    "OM": (OUTPUTS, 0, 3, 0, "{:d}"),
    "OP": (OUTPUTS, 0, 1, 1, "{:d}"),
    "OA": (OUTPUTS, -4.0, 4.0, 1.0, "{:+.2f}"),
    "OO": (OUTPUTS, -4.0, 4.0, 0.0, "{:+.2f}"),
}
_ONLY_VARIABLE = ("OA", "OO")


class Dg535(BusInstrument, GateGenerator):
    """The instrument, as it came; what is set survives a loss of power (recalled)."""

    edges = (A, B)

    def __init__(self) -> None:
        super().__init__()
        self._clear_settings()
        self._errors, self._status = 0, 0

    def power_cycle(self) -> None:
        """Power cycle: settings stay, registers and buffers are cleared."""
        self.clear()
        self._errors = self._status = 0

    def _overrun(self) -> None:
        self._errors |= ErrorStatus.UNRECOGNISED

    def _message(self, line: str) -> None:
        for command in filter(None, line.upper().replace(" ", "").split(";")):
            try:
                match = _COMMAND.fullmatch(command)
                if match is None:
                    raise RefusedCommand(ErrorStatus.UNRECOGNISED)
                answer = self._obey(match[1], match[2].split(",") if match[2] else [])
            except RefusedCommand as refusal:
                self._errors |= refusal.code
                self._status |= InstrumentStatus.COMMAND_ERROR
                continue
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
        index = _number(arguments[0]) if indices else 0
        if indices and index not in indices:
            raise RefusedCommand(ErrorStatus.VALUE)
        kind = int if form == "{:d}" else float
        if asked:
            return form.format(kind(self._values[name, index]))
        value = _number(arguments[-1], kind)
        if not lowest <= value <= highest:
            raise RefusedCommand(ErrorStatus.VALUE)
        if name in _ONLY_VARIABLE and self._values["OM", index] != VARIABLE:
            raise RefusedCommand(ErrorStatus.MODE)
        self._values[name, index] = float(f"{value:.4g}") if name == "TR" else value
        return None

    def _delay(self, arguments: list[str]) -> str | None:
        if len(arguments) not in (1, 3):
            raise RefusedCommand(ErrorStatus.COUNT)
        edge, *reference = (_number(text) for text in arguments[:2])
        if edge not in EDGES or (reference and reference[0] not in (T0, *EDGES)):
            raise RefusedCommand(ErrorStatus.VALUE)
        if not reference:
            return self._delays.text(edge)
        seconds = _number(arguments[2], float)
        if not abs(seconds) < LONGEST_S:
            raise RefusedCommand(ErrorStatus.RANGE)
        delays = self._delays.with_edge(edge, reference[0], round(seconds / STEP_S))
        try:
            if any(not 0 <= delays.total(other) * STEP_S < LONGEST_S for other in EDGES):
                raise RefusedCommand(ErrorStatus.RANGE)
        except RecursionError:
            raise RefusedCommand(ErrorStatus.LINKAGE) from None
        self._delays = delays
        return None

    def _register(self, name: str, arguments: list[str]) -> str:
        refusals = ErrorStatus.COUNT, ErrorStatus.VALUE, ErrorStatus.VALUE
        if name == "ES":
            value, self._errors = read_register(self._errors, arguments, refusals)
        else:
            value, self._status = read_register(self._status, arguments, refusals)
        return str(value)

    def _clear_settings(self) -> None:
        self._values: dict[tuple[str, int], float] = {
            (name, index): value
            for name, (indices, _, _, value, _) in _SETTINGS.items()
            for index in indices or (0,)
        }
        self._delays = EdgeDelays(dict.fromkeys(EDGES, T0), start=T0)

    # Physics

    def _levels_v(self) -> tuple[float, float]:
        mode = int(self._values["OM", AB])
        if mode == VARIABLE:
            return self._values["OO", AB], self._values["OO", AB] + self._values["OA", AB]
        low_v, high_v = _LEVELS_V[mode]
        return (low_v, high_v) if self._values["OP", AB] else (high_v, low_v)

    def _trigger(self) -> Trigger:
        return "mains" if self._values["TM", 0] == TriggerMode.LINE else "clock"

    def _trigger_hz(self) -> float:
        rates_hz: dict[int, float] = {
            TriggerMode.INTERNAL: self._values["TR", 0],
            TriggerMode.LINE: LINE_HZ,
        }
        return rates_hz.get(int(self._values["TM", 0]), 0.0)

    def _busy_s(self) -> float:
        # after the longest delay, before the next trigger is taken; recalled
        return max(self._delays.total(edge) for edge in EDGES) * STEP_S + 1e-6

    def advance(self, now_s: float, faults: Faults) -> None:
        """Update the status of triggers used and lost."""
        if triggers_hz := self._trigger_hz():
            lost = InstrumentStatus.RATE if triggers_hz * self._busy_s() > 1 else 0
            self._status |= InstrumentStatus.TRIGGERED | lost


def _number(text: str, kind: type = int) -> Any:
    return parse_number(text, kind, ErrorStatus.VALUE)


MODEL = VirtualModel(
    name="dg535",
    bench_name="delay_generator",
    make=lambda address, scale: PrologixAdapter(address, Dg535()),
    baud=None,
    panel={
        "source": ("TM 4",),
        "idle level": ("OP 4,0",),
        "width": ("DT 3,2,0.002",),
        "busy": ("DT 5,1,0.02",),
    },
)
