"""A virtual Stanford DG645 delay generator: commands, error queue and registers, and the effect of
its AB output.
"""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum, IntFlag

from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.instrument import (
    LINE_HZ,
    STEP_S,
    Command,
    EdgeDelays,
    GateGenerator,
    LineInstrument,
    RefusedCommand,
    StandardEvent,
    VirtualModel,
    commands_of,
    parse_number,
)
from simulate.virtual_bench.outputs import Trigger

IDENTITY = "Stanford Research Systems,DG645,s/n001234,ver1.00.00E"
LONGEST_DELAY_S = 2000.0
FIELD_HZ = 60.0 / 1.001
OUTPUTS, EDGES = 5, 10  # T0 AB CD EF GH; T0 T1 A B C D E F G H
_REFERENCES: dict[int, int] = dict(enumerate((0, 0, 0, 2, 0, 4, 0, 6, 0, 8)))
_TRIGGERS: dict[int, Trigger] = {1: "camera", 2: "camera", 6: "mains"}


class Dg645Error(IntEnum):
    """Codes of the error queue."""

    ILLEGAL_VALUE = 10
    ILLEGAL_MODE = 11
    ILLEGAL_DELAY = 12
    ILLEGAL_LINK = 13
    ILLEGAL_COMMAND = 110
    UNDEFINED_COMMAND = 111
    ILLEGAL_QUERY = 112
    ILLEGAL_SET = 113
    NULL_PARAMETER = 114
    EXTRA_PARAMETERS = 115
    MISSING_PARAMETERS = 116
    BAD_FLOAT = 118
    BAD_INTEGER = 120
    OVERRUN = 171
    TOO_MANY_ERRORS = 254


class InstrumentStatus(IntFlag):
    """Instrument status register."""

    TRIG = 1
    RATE = 2
    END_OF_DELAY = 4


@dataclass(frozen=True)
class Setting:
    """One setting, or one per output or edge; beyond its range the instrument refuses."""

    low: float
    high: float
    factory: float = 0  #: Value after `*RST`
    count: int = 0  #: Number of indices; 0: none
    form: str = "{:d}"  #: How the value is answered
    step: float = 0.0  #: Resolution to which values are rounded; 0: none
    refusal_code: int = Dg645Error.ILLEGAL_VALUE

    @property
    def kind(self) -> type:
        """int or float."""
        return int if self.form == "{:d}" else float


def _volts(low: float, high: float, factory: float, count: int = 0) -> Setting:
    return Setting(low, high, factory, count, "{:+.2f}", 0.01)


def _seconds(low: float, high: float, factory: float = 0.0, step: float = STEP_S) -> Setting:
    return Setting(low, high, factory, 0, "{:+.12f}", step, Dg645Error.ILLEGAL_DELAY)


# Ranges as the maker's manual gives them; those of BURP, LOFF, TRAT and PRES are recalled, not
# looked up
SETTINGS: dict[str, Setting] = {
    "TSRC": Setting(0, 6, 5),
    "TRAT": Setting(1e-4, 1e7, 1000.0, 0, "{:+.6f}", 1e-6),
    "TLVL": _volts(-3.5, 3.5, 1.0),
    "INHB": Setting(0, 5),
    "HOLD": _seconds(0.0, 2000.0),
    "BURC": Setting(1, 2**32 - 1, 5),
    "BURP": _seconds(100e-9, 42.9, 100e-6, step=10e-9),
    "BURD": _seconds(0.0, 2000.0),
    "LAMP": _volts(0.5, 5.0, 2.5, OUTPUTS),
    "LOFF": _volts(-2.0, 2.0, 0.0, OUTPUTS),
    "LPOL": Setting(0, 1, 1, OUTPUTS),
    "PRES": Setting(1, 2**15 - 1, 1, OUTPUTS),
    "SHDP": Setting(0, 1, 1),
    **dict.fromkeys(("ADVT", "BURM", "BURT"), Setting(0, 1)),
    **dict.fromkeys(("*ESE", "*SRE", "INSE"), Setting(0, 255)),
}


class DelayGenerator(LineInstrument, GateGenerator):
    """The instrument after power-on, with `external_hz` pulses a second at its trigger input, 0:
    none is wired.
    """

    edges = (2, 3)

    def __init__(self, *, external_hz: float = FIELD_HZ) -> None:
        self._external_hz = self._wired_hz = external_hz
        self._errors: deque[int] = deque()
        self._reset()
        self.power_cycle()

    def power_cycle(self) -> None:
        """Lose power and get it back: settings stay (recalled), the error queue is empty, PON is
        set.
        """
        self._clear()
        self._event_status, self._line = StandardEvent.PON, b""

    # The line

    def _overrun(self, line: bytes) -> bytes:
        self._complain(Dg645Error.OVERRUN)
        return b""

    def _replies(self, line: str) -> Iterable[tuple[float, str]]:
        for command in commands_of(line):
            try:
                if command is None:
                    raise RefusedCommand(Dg645Error.ILLEGAL_COMMAND)
                answer = self._dispatch(command)
            except RefusedCommand as refusal:
                self._complain(refusal.code)
                continue
            if answer is not None:
                yield self.command_s, answer

    def _dispatch(self, command: Command) -> str | None:
        name = command.mnemonic
        if name in SETTINGS:
            return self._setting(command, SETTINGS[name])
        mine, other, code = (
            (_QUERIES, _SETS, Dg645Error.ILLEGAL_QUERY)
            if command.query
            else (_SETS, _QUERIES, Dg645Error.ILLEGAL_SET)
        )
        if name not in mine:
            raise RefusedCommand(code if name in other else Dg645Error.UNDEFINED_COMMAND)
        kinds, method = mine[name]
        return method(self, *_numbers(command.arguments, kinds))

    def _complain(self, code: int) -> None:
        self._event_status |= (
            StandardEvent.CME
            if 110 <= code < 130
            else StandardEvent.DDE
            if code >= 30
            else StandardEvent.EXE
        )
        if len(self._errors) < 20:
            self._errors.append(code)
        else:
            self._errors[-1] = Dg645Error.TOO_MANY_ERRORS

    def _setting(self, command: Command, setting: Setting) -> str | None:
        indices = (int,) if setting.count else ()
        numbers = _numbers(
            command.arguments, indices if command.query else (*indices, setting.kind)
        )
        key = command.mnemonic, _within(numbers[0] if indices else 0, max(1, setting.count))
        if command.query:
            return setting.form.format(setting.kind(self._values[key]))
        if not setting.low <= numbers[-1] <= setting.high:
            raise RefusedCommand(setting.refusal_code)
        self._values[key] = (
            round(numbers[-1] / setting.step) * setting.step if setting.step else numbers[-1]
        )
        return None

    def _now(self, mnemonic: str, index: int = 0) -> float:
        return self._values[mnemonic, index]

    # Delays

    def _set_delay(self, edge: int, reference: int, seconds: float) -> None:
        if not abs(seconds) < LONGEST_DELAY_S:
            raise RefusedCommand(Dg645Error.ILLEGAL_DELAY)
        self._move(edge, reference, round(seconds / STEP_S))

    def _move(self, edge: int, reference: int, steps: int) -> None:
        if not 2 <= edge < EDGES:
            raise RefusedCommand(Dg645Error.ILLEGAL_VALUE)
        if reference == 1 or not 0 <= reference < EDGES:
            raise RefusedCommand(Dg645Error.ILLEGAL_LINK)
        tried = self._delays.with_edge(edge, reference, steps)
        try:
            times = [tried.total(other) for other in range(2, EDGES)]
        except RecursionError:
            raise RefusedCommand(Dg645Error.ILLEGAL_LINK) from None
        if min(times) < 0 or max(times) * STEP_S >= LONGEST_DELAY_S:
            raise RefusedCommand(Dg645Error.ILLEGAL_DELAY)
        self._delays = tried

    def _get_delay(self, edge: int) -> str:
        return self._delays.text(_within(edge, EDGES), self._longest() if edge == 1 else None)

    def _longest(self) -> int:
        """Steps from the trigger to T1, the last edge."""
        return max(self._delays.total(edge) for edge in range(2, EDGES))

    # Registers and memory

    def _status_byte(self) -> str:
        has_instrument_event = bool(self._instrument_status & int(self._now("INSE")))
        byte = has_instrument_event | bool(self._event_status & int(self._now("*ESE"))) << 5
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
        """Set what the maker sets: values by mnemonic and index, 0 where there is none."""
        self._values = {
            (name, index): setting.factory
            for name, setting in SETTINGS.items()
            for index in range(max(1, setting.count))
        }
        self._delays = EdgeDelays(_REFERENCES, start=0)

    def _operation_complete(self) -> None:
        self._event_status |= StandardEvent.OPC

    def _fire(self) -> None:
        if self._now("TSRC") not in (3, 4, 5):
            raise RefusedCommand(Dg645Error.ILLEGAL_MODE)
        if self._now("TSRC") == 5:
            self._instrument_status |= InstrumentStatus.TRIG | InstrumentStatus.END_OF_DELAY

    # Physics

    def _levels_v(self) -> tuple[float, float]:
        low_v, high_v = self._now("LOFF", 1), self._now("LOFF", 1) + self._now("LAMP", 1)
        return (low_v, high_v) if self._now("LPOL", 1) else (high_v, low_v)

    def _trigger(self) -> Trigger:
        return _TRIGGERS.get(int(self._now("TSRC")), "clock")

    def _trigger_hz(self) -> float:
        sources = {0: self._now("TRAT"), 1: self._external_hz, 2: self._external_hz, 6: LINE_HZ}
        return sources.get(int(self._now("TSRC")), 0.0)

    def _cycle_s(self) -> float:
        """Time after a trigger in which the instrument is busy and another is lost, s."""
        # the next trigger must come this much after the longest delay
        cycle_s = self._longest() * STEP_S + 100e-9
        if self._now("BURM"):
            cycle_s += self._now("BURD") + (self._now("BURC") - 1) * max(self._now("BURP"), cycle_s)
        return cycle_s

    def _busy_s(self) -> float:
        # A trigger that is held off is no error (recalled).
        return max(self._cycle_s(), self._now("HOLD") if self._now("ADVT") else 0.0)

    def _pulse_hz(self) -> float:
        prescale = self._now("PRES", 0) * self._now("PRES", 1) if self._now("ADVT") else 1.0
        return super()._pulse_hz() * (self._now("BURC") if self._now("BURM") else 1.0) / prescale

    def advance(self, now_s: float, faults: Faults) -> None:
        """Update the status of triggers used and lost."""
        self._external_hz = 0.0 if faults.untriggered else self._wired_hz
        if triggers_hz := self._trigger_hz():
            lost = InstrumentStatus.RATE if triggers_hz * self._cycle_s() > 1 else 0
            self._instrument_status |= InstrumentStatus.TRIG | InstrumentStatus.END_OF_DELAY | lost


def _numbers(arguments: tuple[str, ...], kinds: tuple[type, ...]) -> list:
    """Parse arguments as numbers of the given kinds; a wrong count or form raises its own code."""
    if len(arguments) != len(kinds):
        few = len(arguments) < len(kinds)
        raise RefusedCommand(Dg645Error.MISSING_PARAMETERS if few else Dg645Error.EXTRA_PARAMETERS)
    if not all(arguments):
        raise RefusedCommand(Dg645Error.NULL_PARAMETER)
    wrongs = {float: Dg645Error.BAD_FLOAT, int: Dg645Error.BAD_INTEGER}
    return [
        parse_number(text, kind, wrongs[kind]) for text, kind in zip(arguments, kinds, strict=True)
    ]


def _within(index: int, count: int) -> int:
    if not 0 <= index < count:
        raise RefusedCommand(Dg645Error.ILLEGAL_VALUE)
    return index


_QUERIES = {
    "*IDN": ((), lambda _: IDENTITY),
    "*OPC": ((), lambda _: "1"),
    "*STB": ((), DelayGenerator._status_byte),
    "*ESR": ((), DelayGenerator._take_event_status),
    "INSR": ((), DelayGenerator._take_instrument_status),
    "LERR": ((), lambda generator: str(generator._errors.popleft() if generator._errors else 0)),
    "DLAY": ((int,), DelayGenerator._get_delay),
}

_SETS = {
    "*RST": ((), DelayGenerator._reset),
    "*CLS": ((), DelayGenerator._clear),
    "*OPC": ((), DelayGenerator._operation_complete),
    "*WAI": ((), lambda _: None),
    "*TRG": ((), DelayGenerator._fire),
    "DLAY": ((int, int, float), DelayGenerator._set_delay),
}


MODEL = VirtualModel(
    name="dg645",
    bench_name="delay_generator",
    make=lambda address, scale: DelayGenerator(),
    baud=9600,
    panel={
        "source": ("TSRC 1",),
        "idle level": ("LOFF 1,2",),
        "width": ("DLAY 3,2,0.002",),
        "busy": ("DLAY 4,0,0.02",),
    },
)
