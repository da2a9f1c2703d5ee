"""A virtual Stanford PS350 high-voltage supply: commands, latched trips, and an output that slews and decays."""

import math
from collections.abc import Callable
from enum import IntFlag
from pathlib import Path

from simulate.virtual_bench.dg645_settings import Command, RefusedCommand, StandardEvent, commands_of
from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.outputs import publish_voltage

IDENTITY = "StanfordResearchSystems,PS350,2067,1.40"
FULL_SCALE_V, MINIMUM_V, STEP_V = 5000.0, 50.0, 1.0  # below the minimum only 0 can be set; recalled
FULL_SCALE_A = 5.25e-3
RISE_V_PER_S = FULL_SCALE_V / 3.0  # full scale in about 3 s
DECAY_S = 6.0 / math.log(100.0)  # unloaded, to a hundredth in about 6 s
LOAD_OHM = 100e6  # strip resistance of the microchannel plate
STABLE_V = 1.0
BUFFER_LENGTH = 256
VOLTS, AMPERES = "{:.0f}", "{:.3E}"  # forms of the answers; recalled


class StatusByte(IntFlag):
    """Status byte of the PS350; the first bits but one latch."""

    STABLE = 1
    VOLTAGE_TRIP = 2
    CURRENT_TRIP = 4
    CURRENT_LIMIT = 8
    MAV = 16
    ESB = 32
    MSS = 64
    HV_ON = 128


LATCHED = StatusByte.VOLTAGE_TRIP | StatusByte.CURRENT_TRIP | StatusByte.CURRENT_LIMIT


class HighVoltageSupply:
    """High-voltage supply behind its GPIB connector after power-on; it moves `time_scale` times faster than life."""

    def __init__(self, *, time_scale: float = 1.0) -> None:
        self._time_scale = time_scale
        self._set = {"VSET": 0.0, "VLIM": FULL_SCALE_V, "ILIM": FULL_SCALE_A, "ITRP": FULL_SCALE_A}
        self._switches = {"TMOD": 0, "SMOD": 0, "*ESE": 0, "*SRE": 0, "*PSC": 1}
        self._input, self._output = b"", b""
        self._event_status, self._latched = StandardEvent.PON, 0
        self._on, self._trip_pending = False, False
        self._now_s: float | None = None
        self._published_v: float | None = None
        self.output_v = 0.0

    # The bus

    def listen(self, data: bytes, *, end: bool) -> None:
        """Take bytes from the bus; `end`: EOI with the last byte. A line feed or EOI ends a message."""
        self._input += data + (b"\n" if end else b"")
        *lines, self._input = self._input.split(b"\n")
        if len(self._input) > BUFFER_LENGTH:
            self._input, self._output = b"", b""
            self._event_status |= StandardEvent.DDE
        for line in lines:
            self._message(line.decode("ascii", "replace").replace("\r", ""))

    def talk(self) -> bytes:
        """Return the answer, EOI with its last byte; empty, with a query error, without a query."""
        if not self._output:
            self._event_status |= StandardEvent.QYE
            return b""
        said, self._output = self._output, b""
        return said

    def serial_poll(self) -> int:
        """Status byte by serial poll; the latches stay."""
        return self._status_byte()

    def clear(self) -> None:
        """Device clear: empty both buffers."""
        self._input = self._output = b""

    def _message(self, line: str) -> None:
        if line.strip() and self._output:  # a new message before the answer was taken
            self._output = b""
            self._event_status |= StandardEvent.QYE
        answers = []
        for command in commands_of(line):
            try:
                answer = self._obey(command)
            except RefusedCommand as refusal:
                self._event_status |= refusal.code
                continue
            if answer is not None:
                answers.append(answer)
        if answers:
            self._output = ";".join(answers).encode() + b"\n"

    def _obey(self, command: Command | None) -> str | None:
        if command is None:
            raise RefusedCommand(StandardEvent.CME)
        known = (self._quantity, self._switch, self._reading, self._action)
        for family in known:
            done, answer = family(command)
            if done:
                return answer
        raise RefusedCommand(StandardEvent.CME)

    def _quantity(self, command: Command) -> tuple[bool, str | None]:
        """VSET, VLIM, ILIM, ITRP."""
        name = command.mnemonic
        if name not in self._set:
            return False, None
        form = VOLTS if name[0] == "V" else AMPERES
        if command.query:
            _no_arguments(command)
            return True, form.format(self._set[name])
        value = _number(command)
        if name[0] == "V":
            value = round(value / STEP_V) * STEP_V
        self._check_range(name, value)
        self._set[name] = value
        return True, None

    def _check_range(self, name: str, value: float) -> None:
        if name[0] == "V":
            allowed = value == 0 or MINIMUM_V <= value <= FULL_SCALE_V
            ordered = value <= self._set["VLIM"] if name == "VSET" else value >= self._set["VSET"]
        else:
            allowed, ordered = 0 < value <= FULL_SCALE_A, True
        if not (allowed and ordered):
            raise RefusedCommand(StandardEvent.EXE)

    def _switch(self, command: Command) -> tuple[bool, str | None]:
        """TMOD, SMOD and the enable registers."""
        name = command.mnemonic
        if name not in self._switches:
            return False, None
        if command.query:
            _no_arguments(command)
            return True, str(self._switches[name])
        value = int(_number(command))
        if not 0 <= value <= (255 if name in ("*ESE", "*SRE") else 1):
            raise RefusedCommand(StandardEvent.EXE)
        self._switches[name] = value
        return True, None

    def _reading(self, command: Command) -> tuple[bool, str | None]:
        """Queries without a setting behind them."""
        if not command.query:
            return False, None
        plain: dict[str, Callable[[], str]] = {
            "*IDN": lambda: IDENTITY,
            "*OPC": lambda: "1",
            "*TST": lambda: "0",
            "VOUT": lambda: VOLTS.format(self.output_v),
            "IOUT": lambda: AMPERES.format(round(self._load_a(self.output_v), 6)),
        }
        registers = {"*STB": self._take_status_byte, "*ESR": self._take_event_status}
        if command.mnemonic in plain:
            _no_arguments(command)
            return True, plain[command.mnemonic]()
        if command.mnemonic in registers:
            bit = int(_number(command)) if command.arguments else None
            if bit is not None and not 0 <= bit <= 7:
                raise RefusedCommand(StandardEvent.EXE)
            return True, str(registers[command.mnemonic](bit))
        return False, None

    def _action(self, command: Command) -> tuple[bool, str | None]:
        """Commands without an argument."""
        actions = {
            "HVON": self._switch_on,
            "HVOF": self._switch_off,
            "TCLR": self._clear_trip,
            "*RST": self._reset,
            "*CLS": self._clear_status,
            "*OPC": self._operation_complete,
            "*WAI": lambda: None,
        }
        if command.query or command.mnemonic not in actions:
            return False, None
        _no_arguments(command)
        actions[command.mnemonic]()
        return True, None

    # Switches and registers

    def _switch_on(self) -> None:
        if self._trip_pending:
            raise RefusedCommand(StandardEvent.EXE)
        self._on = True

    def _switch_off(self) -> None:
        self._on = False

    def _clear_trip(self) -> None:
        self._trip_pending = False

    def _reset(self) -> None:
        self._on = False
        self._set = {"VSET": 0.0, "VLIM": FULL_SCALE_V, "ILIM": FULL_SCALE_A, "ITRP": FULL_SCALE_A}

    def _clear_status(self) -> None:
        self._event_status = self._latched = 0

    def _operation_complete(self) -> None:
        self._event_status |= StandardEvent.OPC

    def _take_event_status(self, bit: int | None) -> int:
        mask = 0xFF if bit is None else 1 << bit
        status, self._event_status = self._event_status & mask, self._event_status & ~mask
        return status if bit is None else int(bool(status))

    def _status_byte(self) -> int:
        stable = self._on and abs(self.output_v - self._goal_v()) < STABLE_V
        event = bool(self._event_status & self._switches["*ESE"])
        byte = (
            self._latched
            | StatusByte.STABLE * stable
            | StatusByte.ESB * event
            | StatusByte.HV_ON * self._on
            | StatusByte.MAV * bool(self._output)
        )
        return byte | StatusByte.MSS * bool(byte & self._switches["*SRE"])

    def _take_status_byte(self, bit: int | None) -> int:
        byte = self._status_byte()
        mask = 0xFF if bit is None else 1 << bit
        self._latched &= ~(LATCHED & mask)
        return byte if bit is None else int(bool(byte & mask))

    # Physics

    def _goal_v(self) -> float:
        return min(self._set["VSET"], self._set["ILIM"] * LOAD_OHM) if self._on else 0.0

    def _load_a(self, volts: float) -> float:
        return volts / LOAD_OHM

    def advance(self, now_s: float, faults: Faults) -> None:
        """Advance the output to a time, s: up at a constant rate, down by discharge through load and bleeder."""
        elapsed_s = 0.0 if self._now_s is None else (now_s - self._now_s) * self._time_scale
        self._now_s = now_s
        self._trip_where_due(faults.tripped)
        goal_v = self._goal_v()
        if self.output_v < goal_v:
            self.output_v = min(goal_v, self.output_v + RISE_V_PER_S * elapsed_s)
        else:
            self.output_v = max(goal_v, self.output_v * math.exp(-elapsed_s / DECAY_S))
        if not self._on and self.output_v < 0.05:
            self.output_v = 0.0
        if self._on and self._set["VSET"] > self._set["ILIM"] * LOAD_OHM:
            self._latched |= StatusByte.CURRENT_LIMIT

    def _trip_where_due(self, shorted: bool) -> None:
        if self._on and (shorted or self._load_a(self.output_v) > self._set["ITRP"]):
            self._on, self._trip_pending = False, self._switches["TMOD"] == 0
            self._latched |= StatusByte.CURRENT_TRIP

    def power_cycle(self) -> None:
        """Lose power and get it back: settings stay, the high voltage comes up off (recalled)."""
        self.clear()
        self._on, self._trip_pending, self._latched = False, False, 0
        self._event_status = StandardEvent.PON

    def publish(self, folder: Path) -> None:
        """Publish the voltage if it changed."""
        if self.output_v != self._published_v:
            publish_voltage(folder, self.output_v)
            self._published_v = self.output_v


def _no_arguments(command: Command) -> None:
    if command.arguments:
        raise RefusedCommand(StandardEvent.CME)


def _number(command: Command) -> float:
    try:
        (text,) = command.arguments
        value = float(text)
    except ValueError:
        raise RefusedCommand(StandardEvent.CME) from None
    if not math.isfinite(value):
        raise RefusedCommand(StandardEvent.CME)
    return value
