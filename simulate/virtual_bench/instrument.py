"""Common parts of the virtual instruments: lines, buses, command language, delays, published
outputs, models by name.

A package brings a virtual instrument with a Python entry point of the group
`charact.virtual_instruments` whose value is a `VirtualModel`; its name is the one of the driver's
model in the group `charact.instruments`.
"""

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntFlag
from pathlib import Path
from typing import Any, ClassVar, Protocol

from labdata.errors import BadInput
from labdata.instrument_config import models_by_name
from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.outputs import GATE_FILE, VOLTAGE_FILE, GateOutput, Trigger, publish

GATE_UNIT_THRESHOLD_V = 1.5
LINE_HZ = 60.0
LOAD_OHM = 100e6  # strip resistance of the microchannel plate
STEP_S = 5e-12  # of the delay generators


class SerialInstrument(Protocol):
    """Instrument on a serial line."""

    def receive(self, data: bytes) -> list[tuple[float, bytes]]:
        """Take bytes from the line; return answers, each with the time it takes to make, s."""
        ...

    def advance(self, now_s: float, faults: Faults) -> None:
        """Advance the physics to a time, s."""

    def publish(self, folder: Path) -> None:
        """Publish the outputs that changed."""

    def power_cycle(self) -> None:
        """Lose power and get it back."""


@dataclass(frozen=True, kw_only=True)
class VirtualModel:
    """One model of virtual instrument."""

    name: str  #: Name of the model, such as "dg645"
    #: Where it stands at the bench, such as "delay_generator": the name of its port and of its
    #: faults
    bench_name: str
    #: Makes it, from its address on a bus and how much faster than life it moves
    make: Callable[[int, float], SerialInstrument]
    baud: int | None  #: Rate set on it, baud; None: a USB adapter, which has none
    #: Commands that do what a hand at its panel does, by setting: of a gate "source", "idle level",
    #: "width" and "busy" : (every second trigger is lost), of a supply "voltage" and "on"
    panel: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


class VirtualInstrument(ABC):
    """An instrument whose outputs are published in a file of the bench."""

    output_file: ClassVar[str]
    _published: dict[str, Any] | None = None

    @abstractmethod
    def outputs(self) -> dict[str, Any]:
        """Return what it puts out, by name."""

    def advance(self, now_s: float, faults: Faults) -> None:
        """Advance the physics to a time, s; by default there is none."""
        return None

    @abstractmethod
    def power_cycle(self) -> None:
        """Lose power and get it back."""

    def publish(self, folder: Path) -> None:
        """Publish the outputs that changed."""
        if (now := self.outputs()) != self._published:
            publish(folder, self.output_file, now)
            self._published = now


class LineInstrument(VirtualInstrument):
    """An instrument with commands of one text line; those that set something answer nothing."""

    command_s: ClassVar[float] = 2e-3
    longest_line: ClassVar[int] = 256
    answer_end: bytes = b"\r\n"
    _line = b""

    def receive(self, data: bytes) -> list[tuple[float, bytes]]:
        """Take bytes; return answers, each with the time it takes, s."""
        *lines, self._line = (self._line + data.replace(b"\r", b"\n")).split(b"\n")
        if len(self._line) > self.longest_line:
            self._line = self._overrun(self._line)
        replies = (
            reply
            for line in lines
            if line.strip()
            for reply in self._replies(line.decode("ascii", "replace"))
        )
        return [
            (seconds, answer.encode("latin-1") + self.answer_end) for seconds, answer in replies
        ]

    def _overrun(self, line: bytes) -> bytes:
        """Return what is kept of a line that is too long."""
        return line[-self.longest_line :]

    def _replies(self, line: str) -> Iterable[tuple[float, str]]:
        """Obey a line; return its answers, each with the time it takes, s."""
        answer = self._answer(line.strip())
        return [] if answer is None else [(self.command_s, answer)]

    def _answer(self, line: str) -> str | None:
        raise NotImplementedError


class BusInstrument(VirtualInstrument):
    """An instrument behind its GPIB connector; a line feed or EOI ends a message."""

    def __init__(self) -> None:
        self._input, self._output = b"", b""

    def listen(self, data: bytes, *, end: bool) -> None:
        """Take bytes from the bus; `end`: EOI came with the last."""
        *lines, self._input = (self._input + data + (b"\n" if end else b"")).split(b"\n")
        if len(self._input) > 256:
            self._input = b""
            self._overrun()
        for line in lines:
            self._message(line.decode("ascii", "replace").replace("\r", ""))

    def talk(self) -> bytes:
        """Return the answer, EOI with its last byte; empty without a query."""
        answer, self._output = self._output, b""
        return answer

    def clear(self) -> None:
        """Device clear: empty both buffers."""
        self._input = self._output = b""

    @abstractmethod
    def _overrun(self) -> None: ...

    @abstractmethod
    def _message(self, line: str) -> None: ...


# Commands


class StandardEvent(IntFlag):
    """Event status register of IEEE 488.2."""

    OPC = 1
    QYE = 4
    DDE = 8
    EXE = 16
    CME = 32
    PON = 128


class RefusedCommand(Exception):
    """The instrument refuses a command; `code` is its error code, the bit of its status register,
    or its words.
    """

    def __init__(self, code: Any) -> None:
        super().__init__(code)
        self.code = code


def parse_number(text: str, kind: type, code: object) -> Any:
    """Return the finite number of a command; any other text is refused with a code."""
    try:
        value = kind(text)
    except ValueError:
        raise RefusedCommand(code) from None
    if not math.isfinite(value):
        raise RefusedCommand(code)
    return value


def read_register(
    value: int, arguments: Sequence[str], refusals: tuple[Any, Any, Any], kind: type = int
) -> tuple[int, int]:
    """Return a register, or the bit that a command names, and its value after the reading;
    `refusals` are the codes of too many arguments, of one that is no number, and of no such bit.
    """
    too_many, no_number, no_bit = refusals
    if len(arguments) > 1:
        raise RefusedCommand(too_many)
    if not arguments:
        return value & 0xFF, value & ~0xFF
    bit = int(parse_number(arguments[0], kind, no_number))
    if not 0 <= bit <= 7:
        raise RefusedCommand(no_bit)
    return value >> bit & 1, value & ~(1 << bit)


@dataclass(frozen=True, kw_only=True)
class Command:
    """One command of a line, such as "DLAY? 2"."""

    mnemonic: str  #: Upper case
    query: bool
    arguments: tuple[str, ...]  #: As they were written, stripped of blanks


_COMMAND = re.compile(r"^(\*[A-Z]{3}|[A-Z]{4})(\?)?\s*(.*)$", re.DOTALL)


def commands_of(line: str) -> list[Command | None]:
    """Split a line into commands; None stands for invalid text."""
    return [_command(part) for part in line.upper().split(";") if part.strip()]


def _command(text: str) -> Command | None:
    match = _COMMAND.match(text.strip())
    if match is None:
        return None
    mnemonic, mark, arguments_text = match.groups()
    arguments = (
        tuple(part.strip() for part in arguments_text.split(",")) if arguments_text.strip() else ()
    )
    return Command(mnemonic=mnemonic, query=bool(mark), arguments=arguments)


# Physics


class EdgeDelays:
    """Delays of a generator's edges, each behind another one, in steps of 5 ps; `start` is the
    trigger.
    """

    def __init__(self, reference: dict[int, int], start: int) -> None:
        self.reference, self.start = dict(reference), start
        self.steps = dict.fromkeys(reference, 0)

    def with_edge(self, edge: int, reference: int, steps: int) -> "EdgeDelays":
        """Return other delays, with one edge moved."""
        delays = EdgeDelays({**self.reference, edge: reference}, self.start)
        delays.steps = {**self.steps, edge: steps}
        return delays

    def total(self, edge: int) -> int:
        """Steps of an edge after the trigger; edges that refer to each other in a ring are a
        RecursionError.
        """
        steps, visited = 0, set()
        while edge != self.start:
            if edge in visited:
                raise RecursionError
            visited.add(edge)
            steps, edge = steps + self.steps[edge], self.reference[edge]
        return steps

    def text(self, edge: int, steps: int | None = None) -> str:
        """Return reference and delay of an edge as the generators answer them."""
        steps = self.steps[edge] if steps is None else steps
        picoseconds = 5 * abs(steps)
        sign = "-" if steps < 0 else "+"
        return f"{self.reference[edge]},{sign}{picoseconds // 10**12}.{picoseconds % 10**12:012d}"


class GateGenerator(VirtualInstrument):
    """A generator whose AB output drives a gate unit that opens above its threshold."""

    output_file = GATE_FILE
    edges: ClassVar[tuple[int, int]]  # A and B
    _delays: EdgeDelays

    def gate(self) -> GateOutput:
        """Effect of the AB output on the gate unit."""
        idle_v, active_v = self._levels_v()
        if idle_v > GATE_UNIT_THRESHOLD_V:
            return GateOutput(gate_open=True, gate_ns=math.inf, gate_hz=0.0)
        first, second = (self._delays.total(edge) for edge in self.edges)
        width_ns, rate_hz = abs(second - first) * STEP_S * 1e9, self._pulse_hz()
        if active_v <= GATE_UNIT_THRESHOLD_V or not width_ns or not rate_hz:
            return GateOutput()
        return GateOutput(
            gate_open=True,
            gate_ns=width_ns,
            gate_hz=rate_hz,
            gate_trigger=self._trigger(),
            gate_delay_ns=min(first, second) * STEP_S * 1e9,
        )

    def outputs(self) -> dict[str, Any]:
        return vars(self.gate())

    def _pulse_hz(self) -> float:
        """Pulses a second: triggers that come while it is busy are lost."""
        triggers_hz = self._trigger_hz()
        return triggers_hz / math.ceil(triggers_hz * self._busy_s() - 1e-12) if triggers_hz else 0.0

    @abstractmethod
    def _levels_v(self) -> tuple[float, float]:
        """Idle and active level of the output, V."""

    @abstractmethod
    def _trigger(self) -> Trigger: ...

    @abstractmethod
    def _trigger_hz(self) -> float:
        """Triggers a second; the trigger button is never pressed."""

    @abstractmethod
    def _busy_s(self) -> float:
        """Time after a trigger in which none is taken, s."""


class VoltageSource(VirtualInstrument):
    """A high-voltage supply, which moves `time_scale` times faster than life."""

    output_file = VOLTAGE_FILE

    def __init__(self, *, time_scale: float = 1.0) -> None:
        self._time_scale, self.output_v = time_scale, 0.0
        self._now_s: float | None = None

    def outputs(self) -> dict[str, Any]:
        return {"mcp_v": self.output_v}

    def _pass_time(self, now_s: float) -> float:
        """Return the time since the last call, s of the supply."""
        elapsed_s = 0.0 if self._now_s is None else (now_s - self._now_s) * self._time_scale
        self._now_s = now_s
        return elapsed_s


def virtual_models() -> dict[str, VirtualModel]:
    """Return all virtual models by name: those of the package `instruments`, and those of other
    packages.
    """
    return models_by_name(
        "simulate.virtual_bench.instruments", VirtualModel, "charact.virtual_instruments"
    )


def virtual_model(name: str) -> VirtualModel:
    """Return a virtual model by its name."""
    known = virtual_models()
    if name not in known:
        raise BadInput(
            f"a virtual instrument must be one of {', '.join(sorted(known))}, got {name!r}"
        )
    return known[name]
