"""A virtual Stanford DG645 delay generator: commands, error queue and registers, and what its AB output does."""

import math
from collections import deque
from enum import IntFlag
from pathlib import Path

from simulate.virtual_bench.dg645_settings import (
    EDGES,
    SETTINGS,
    Command,
    Dg645Error,
    Dg645Setting,
    RefusedCommand,
    SettingsRegister,
    StandardEvent,
    commands_of,
    numbers,
)
from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.outputs import GateOutput, Trigger, publish_gate

IDENTITY = "Stanford Research Systems,DG645,s/n001234,ver1.00.00E"
STEP_S = 5e-12
LONGEST_DELAY_S = 2000.0
INSERTION_DEAD_S = 100e-9  # the next trigger must come this much after the longest delay
GATE_UNIT_THRESHOLD_V = 1.5
LINE_HZ = 60.0
FIELD_HZ = 60.0 / 1.001
_TRIGGERS: dict[int, Trigger] = {1: "camera", 2: "camera", 6: "mains"}
QUEUE_LENGTH = 20
BUFFER_LENGTH = 256
SELF_TEST_S = 2.0
COMMAND_S = 2e-3


class InstrumentStatus(IntFlag):
    """Instrument status register."""

    TRIG = 1
    RATE = 2
    END_OF_DELAY = 4


class DelayGenerator:
    """The instrument after power-on, with `external_hz` pulses a second at its trigger input, 0: none is wired."""

    def __init__(self, *, external_hz: float = FIELD_HZ) -> None:
        self._external_hz = self._wired_hz = external_hz
        self._memory = SettingsRegister()
        self._saved: dict[int, SettingsRegister] = {}
        self._errors: deque[int] = deque()
        self._event_status, self._instrument_status = StandardEvent.PON, 0
        self._line = b""
        self._terminator = b"\r\n"
        self._armed = False
        self._published: GateOutput | None = None

    # The line

    def receive(self, data: bytes) -> list[tuple[float, bytes]]:
        """Take bytes; return answers, each with the time it takes to make, s. Sets answer nothing."""
        *lines, self._line = (self._line + data.replace(b"\r", b"\n")).split(b"\n")
        if len(self._line) > BUFFER_LENGTH:
            self._line = b""
            self._complain(Dg645Error.OVERRUN)
        answers: list[tuple[float, bytes]] = []
        for line in lines:
            for command in commands_of(line.decode("ascii", "replace")):
                answer = self._obey(command)
                if answer is not None:
                    slow = command is not None and command.mnemonic in ("*TST", "*CAL")
                    answers.append((SELF_TEST_S if slow else COMMAND_S, answer.encode() + self._terminator))
        return answers

    def _obey(self, command: Command | None) -> str | None:
        try:
            if command is None:
                raise RefusedCommand(Dg645Error.ILLEGAL_COMMAND)
            return self._dispatch(command)
        except RefusedCommand as refusal:
            self._complain(refusal.code)
            return None

    def _dispatch(self, command: Command) -> str | None:
        if setting := SETTINGS.get(command.mnemonic):
            return self._setting(command, setting)
        queries, sets = _QUERIES, _SETS
        mine, other, wrong = (
            (queries, sets, Dg645Error.ILLEGAL_QUERY) if command.query else (sets, queries, Dg645Error.ILLEGAL_SET)
        )
        if command.mnemonic not in mine:
            raise RefusedCommand(wrong if command.mnemonic in other else Dg645Error.UNDEFINED_COMMAND)
        kinds, method = mine[command.mnemonic]
        return method(self, *numbers(command.arguments, kinds))

    def _complain(self, code: int) -> None:
        self._event_status |= (
            StandardEvent.CME if 110 <= code < 130 else StandardEvent.DDE if code >= 30 else StandardEvent.EXE
        )
        if len(self._errors) < QUEUE_LENGTH:
            self._errors.append(code)
        else:
            self._errors[-1] = Dg645Error.TOO_MANY_ERRORS

    # Settings of one number

    def _setting(self, command: Command, setting: Dg645Setting) -> str | None:
        indices = (int,) if setting.count else ()
        if command.query:
            (index,) = numbers(command.arguments, indices) or (0,)
            return setting.form.format(setting.kind(self._memory.values[command.mnemonic, _within(index, setting)]))
        *index, value = numbers(command.arguments, (*indices, setting.kind))
        place = _within(index[0], setting) if index else 0
        if not setting.low <= value <= setting.high:
            raise RefusedCommand(Dg645Error.ILLEGAL_DELAY if setting.form == "{:+.12f}" else Dg645Error.ILLEGAL_VALUE)
        rounded = round(value / setting.step) * setting.step if setting.step else value
        self._memory.values[command.mnemonic, place] = rounded
        return None

    def _now(self, mnemonic: str, index: int = 0) -> float:
        return self._memory.values[mnemonic, index]

    # Delays

    def _set_delay(self, edge: int, reference: int, seconds: float) -> None:
        if not abs(seconds) < LONGEST_DELAY_S:
            raise RefusedCommand(Dg645Error.ILLEGAL_DELAY)
        self._move(edge, reference, round(seconds / STEP_S))

    def _set_link(self, edge: int, reference: int) -> None:
        self._move(edge, reference, self._memory.delay_steps[_edge(edge)])

    def _step_delay(self, edge: int, up: int) -> None:
        steps = round(self._now("SSDL", _edge(edge)) / STEP_S)
        self._move(edge, self._memory.reference[edge], self._memory.delay_steps[edge] + (steps if up else -steps))

    def _move(self, edge: int, reference: int, steps: int) -> None:
        if not 2 <= edge < EDGES:
            raise RefusedCommand(Dg645Error.ILLEGAL_VALUE)
        if reference == 1 or not 0 <= reference < EDGES:
            raise RefusedCommand(Dg645Error.ILLEGAL_LINK)
        tried = self._memory.copy()
        tried.reference[edge], tried.delay_steps[edge] = reference, steps
        try:
            times = [tried.absolute_steps(other) for other in range(2, EDGES)]
        except RecursionError:
            raise RefusedCommand(Dg645Error.ILLEGAL_LINK) from None
        if min(times) < 0 or max(times) * STEP_S >= LONGEST_DELAY_S:
            raise RefusedCommand(Dg645Error.ILLEGAL_DELAY)
        self._memory = tried

    def _get_delay(self, edge: int) -> str:
        memory = self._memory
        steps = memory.absolute_steps(1) if edge == 1 else memory.delay_steps[_edge(edge)]
        picoseconds = 5 * abs(steps)
        seconds = f"{picoseconds // 10**12}.{picoseconds % 10**12:012d}"
        return f"{memory.reference[edge]},{'-' if steps < 0 else '+'}{seconds}"

    def _get_link(self, edge: int) -> str:
        return str(self._memory.reference[_edge(edge)])

    # Registers and memory

    def _pop_error(self) -> str:
        return str(self._errors.popleft() if self._errors else 0)

    def _status_byte(self) -> str:
        inside = bool(self._instrument_status & int(self._now("INSE")))
        event = bool(self._event_status & int(self._now("*ESE")))
        byte = inside | event << 5
        return str(byte | bool(byte & int(self._now("*SRE"))) << 6)

    def _take_event_status(self) -> str:
        status, self._event_status = self._event_status, 0
        return str(status)

    def _take_instrument_status(self) -> str:
        status, self._instrument_status = self._instrument_status, 0
        return str(status)

    def _clear(self) -> None:
        self._errors.clear()
        self._event_status = self._instrument_status = 0

    def _reset(self) -> None:
        self._memory = SettingsRegister()

    def _save(self, place: int) -> None:
        if not 1 <= place <= 9:
            raise RefusedCommand(Dg645Error.ILLEGAL_VALUE)
        self._saved[place] = self._memory.copy()

    def _recall(self, place: int) -> None:
        if not 0 <= place <= 9:
            raise RefusedCommand(Dg645Error.ILLEGAL_VALUE)
        if place and place not in self._saved:
            raise RefusedCommand(Dg645Error.RECALL_FAILED)
        self._memory = self._saved[place].copy() if place else SettingsRegister()

    def _set_terminator(self, *codes: int) -> None:
        if any(not 0 <= code <= 255 for code in codes):
            raise RefusedCommand(Dg645Error.ILLEGAL_VALUE)
        self._terminator = bytes(code for code in codes if code)

    def _get_terminator(self) -> str:
        return ",".join(str(code) for code in self._terminator.ljust(3, b"\0"))

    def _operation_complete(self) -> None:
        self._event_status |= StandardEvent.OPC

    def _fire(self) -> None:
        if self._now("TSRC") not in (3, 4, 5):
            raise RefusedCommand(Dg645Error.ILLEGAL_MODE)
        if self._now("TSRC") == 5:
            self._instrument_status |= InstrumentStatus.TRIG | InstrumentStatus.END_OF_DELAY

    # Physics

    def gate(self) -> GateOutput:
        """What the AB output does to a gate unit that opens above its threshold."""
        idle_v, active_v = self._now("LOFF", 1), self._now("LOFF", 1) + self._now("LAMP", 1)
        if not self._now("LPOL", 1):
            idle_v, active_v = active_v, idle_v
        if idle_v > GATE_UNIT_THRESHOLD_V:
            return GateOutput(gate_open=True, gate_ns=math.inf, gate_hz=0.0)
        width_ns = abs(self._memory.absolute_steps(3) - self._memory.absolute_steps(2)) * STEP_S * 1e9
        rate_hz = self._pulse_hz()
        if active_v <= GATE_UNIT_THRESHOLD_V or not width_ns or not rate_hz:
            return GateOutput()
        trigger: Trigger = _TRIGGERS.get(int(self._now("TSRC")), "clock")
        delay_ns = self._memory.absolute_steps(2) * STEP_S * 1e9
        return GateOutput(
            gate_open=True, gate_ns=width_ns, gate_hz=rate_hz, gate_trigger=trigger, gate_delay_ns=delay_ns
        )

    def _trigger_hz(self) -> float:
        """Triggers a second; the trigger button is never pressed."""
        sources = {0: self._now("TRAT"), 1: self._external_hz, 2: self._external_hz, 6: LINE_HZ}
        return sources.get(int(self._now("TSRC")), 0.0)

    def _cycle_s(self) -> float:
        """Time after a trigger in which the instrument is busy and another is lost, s."""
        cycle_s = self._memory.absolute_steps(1) * STEP_S + INSERTION_DEAD_S
        if self._now("BURM"):
            cycle_s += self._now("BURD") + (self._now("BURC") - 1) * max(self._now("BURP"), cycle_s)
        return cycle_s

    def _busy_s(self) -> float:
        """Time after a trigger in which none is taken, s: lost, or held off, which is no error (recalled)."""
        return max(self._cycle_s(), self._now("HOLD") if self._now("ADVT") else 0.0)

    def _pulse_hz(self) -> float:
        triggers_hz = self._trigger_hz()
        if not triggers_hz:
            return 0.0
        used_hz = triggers_hz / math.ceil(triggers_hz * self._busy_s() - 1e-12)
        prescale = self._now("PRES", 0) * self._now("PRES", 1) if self._now("ADVT") else 1.0
        return used_hz * (self._now("BURC") if self._now("BURM") else 1.0) / prescale

    def advance(self, now_s: float, faults: Faults) -> None:
        """Update the status of triggers used and lost."""
        self._external_hz = 0.0 if faults.untriggered else self._wired_hz
        if triggers_hz := self._trigger_hz():
            self._instrument_status |= (
                InstrumentStatus.TRIG
                | InstrumentStatus.END_OF_DELAY
                | (InstrumentStatus.RATE if triggers_hz * self._cycle_s() > 1 else 0)
            )

    def power_cycle(self) -> None:
        """Lose power and get it back: settings stay (recalled), the error queue is empty, PON is set."""
        self._clear()
        self._event_status, self._line, self._armed = StandardEvent.PON, b"", False

    def publish(self, folder: Path) -> None:
        """Publish the gate drive if it changed."""
        gate = self.gate()
        if gate != self._published:
            publish_gate(folder, gate)
            self._published = gate


def _edge(edge: int) -> int:
    if not 0 <= edge < EDGES:
        raise RefusedCommand(Dg645Error.ILLEGAL_VALUE)
    return edge


def _within(index: int, setting: Dg645Setting) -> int:
    if not 0 <= index < max(1, setting.count):
        raise RefusedCommand(Dg645Error.ILLEGAL_VALUE)
    return index


_QUERIES = {
    "*IDN": ((), lambda _: IDENTITY),
    "*OPC": ((), lambda _: "1"),
    "*TST": ((), lambda _: "0"),
    "*CAL": ((), lambda _: "0"),
    "*STB": ((), DelayGenerator._status_byte),
    "*ESR": ((), DelayGenerator._take_event_status),
    "INSR": ((), DelayGenerator._take_instrument_status),
    "LERR": ((), DelayGenerator._pop_error),
    "DLAY": ((int,), DelayGenerator._get_delay),
    "LINK": ((int,), DelayGenerator._get_link),
    "XTRM": ((), DelayGenerator._get_terminator),
}

_SETS = {
    "*RST": ((), DelayGenerator._reset),
    "*CLS": ((), DelayGenerator._clear),
    "*OPC": ((), DelayGenerator._operation_complete),
    "*WAI": ((), lambda _: None),
    "*TRG": ((), DelayGenerator._fire),
    "*SAV": ((int,), DelayGenerator._save),
    "*RCL": ((int,), DelayGenerator._recall),
    "DLAY": ((int, int, float), DelayGenerator._set_delay),
    "LINK": ((int, int), DelayGenerator._set_link),
    "SPDL": ((int, int), DelayGenerator._step_delay),
    "XTRM": ((int, int, int), DelayGenerator._set_terminator),
}
