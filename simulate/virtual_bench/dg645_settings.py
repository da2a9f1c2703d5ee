"""Command language of Stanford Research instruments, and the errors and settings of the DG645."""

import math
import re
from dataclasses import dataclass, field
from enum import IntEnum, IntFlag


class Dg645Error(IntEnum):
    """Codes of the DG645's error queue."""

    ILLEGAL_VALUE = 10
    ILLEGAL_MODE = 11
    ILLEGAL_DELAY = 12
    ILLEGAL_LINK = 13
    RECALL_FAILED = 14
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


class StandardEvent(IntFlag):
    """Event status register of IEEE 488.2."""

    OPC = 1
    QYE = 4
    DDE = 8
    EXE = 16
    CME = 32
    PON = 128


class RefusedCommand(Exception):
    """The instrument refuses a command; `code` is its error code or the bit of its status register."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


def numbers(arguments: tuple[str, ...], kinds: tuple[type, ...]) -> list:
    """Parse arguments as numbers of the given kinds; a wrong count or form raises its own code."""
    if len(arguments) != len(kinds):
        raise RefusedCommand(
            Dg645Error.MISSING_PARAMETERS if len(arguments) < len(kinds) else Dg645Error.EXTRA_PARAMETERS
        )
    return [_number(text, kind) for text, kind in zip(arguments, kinds, strict=True)]


def _number(text: str, kind: type) -> float:
    if not text:
        raise RefusedCommand(Dg645Error.NULL_PARAMETER)
    try:
        value = kind(text)
    except ValueError:
        raise RefusedCommand(Dg645Error.BAD_FLOAT if kind is float else Dg645Error.BAD_INTEGER) from None
    if not math.isfinite(value):
        raise RefusedCommand(Dg645Error.BAD_FLOAT)
    return value


_COMMAND = re.compile(r"^(\*[A-Z]{3}|[A-Z]{4})(\?)?\s*(.*)$", re.DOTALL)


@dataclass(frozen=True, kw_only=True)
class Command:
    """One command of a line."""

    mnemonic: str  # Upper-case mnemonic, such as "DLAY" or "*IDN"
    query: bool  # Whether it asks
    arguments: tuple[str, ...]  # Arguments as they were written, stripped of blanks


def commands_of(line: str) -> list[Command | None]:
    """Split a line into commands; None stands for invalid text."""
    return [_command(part) for part in line.upper().split(";") if part.strip()]


def _command(text: str) -> Command | None:
    match = _COMMAND.match(text.strip())
    if match is None:
        return None
    mnemonic, mark, rest = match.groups()
    arguments = tuple(part.strip() for part in rest.split(",")) if rest.strip() else ()
    return Command(mnemonic=mnemonic, query=bool(mark), arguments=arguments)


@dataclass(frozen=True, kw_only=True)
class Dg645Setting:
    """One setting, or one per output."""

    kind: type = int  # int or float
    low: float  # Range; beyond it the instrument refuses
    high: float  # Range; beyond it the instrument refuses
    factory: float  # Value after `*RST`
    form: str = "{:d}"  # How the value is answered
    count: int = 0  # Number of indices the setting has; 0: none
    step: float = 0.0  # Resolution to which values are rounded; 0: none


def _volts(low: float, high: float, factory: float, count: int = 0) -> Dg645Setting:
    return Dg645Setting(kind=float, low=low, high=high, factory=factory, form="{:+.2f}", count=count, step=0.01)


def _seconds(low: float, high: float, factory: float, step: float = 5e-12, count: int = 0) -> Dg645Setting:
    return Dg645Setting(kind=float, low=low, high=high, factory=factory, form="{:+.12f}", step=step, count=count)


def _switch(factory: int = 0) -> Dg645Setting:
    return Dg645Setting(low=0, high=1, factory=factory)


OUTPUTS = 5  # T0 AB CD EF GH
EDGES = 10  # T0 T1 A B C D E F G H

# Ranges as the maker's manual gives them; those of BURP, LOFF, TRAT and PRES are recalled, not looked up
SETTINGS: dict[str, Dg645Setting] = {
    "TSRC": Dg645Setting(low=0, high=6, factory=5),
    "TRAT": Dg645Setting(kind=float, low=1e-4, high=1e7, factory=1000.0, form="{:+.6f}", step=1e-6),
    "TLVL": _volts(-3.5, 3.5, 1.0),
    "INHB": Dg645Setting(low=0, high=5, factory=0),
    "HOLD": _seconds(0.0, 2000.0, 0.0),
    "ADVT": _switch(),
    "BURM": _switch(),
    "BURC": Dg645Setting(low=1, high=2**32 - 1, factory=5),
    "BURP": _seconds(100e-9, 42.9, 100e-6, step=10e-9),
    "BURD": _seconds(0.0, 2000.0, 0.0),
    "BURT": _switch(),
    "LAMP": _volts(0.5, 5.0, 2.5, count=OUTPUTS),
    "LOFF": _volts(-2.0, 2.0, 0.0, count=OUTPUTS),
    "LPOL": Dg645Setting(low=0, high=1, factory=1, count=OUTPUTS),
    "PRES": Dg645Setting(low=1, high=2**15 - 1, factory=1, count=OUTPUTS),
    "SSDL": _seconds(5e-12, 1000.0, 1e-9, count=EDGES),
    "*ESE": Dg645Setting(low=0, high=255, factory=0),
    "*SRE": Dg645Setting(low=0, high=255, factory=0),
    "INSE": Dg645Setting(low=0, high=255, factory=0),
    "SHDP": _switch(1),
}


@dataclass(kw_only=True)
class SettingsRegister:
    """Values of all settings, by mnemonic and index (0 where there is none), and the edges' delays."""

    values: dict[tuple[str, int], float] = field(
        default_factory=lambda: {
            (name, index): setting.factory
            for name, setting in SETTINGS.items()
            for index in range(max(1, setting.count))
        }
    )
    reference: list[int] = field(default_factory=lambda: [0, 0, 0, 2, 0, 4, 0, 6, 0, 8])
    delay_steps: list[int] = field(default_factory=lambda: [0] * EDGES)  # of 5 ps

    def copy(self) -> "SettingsRegister":
        """Return an independent copy."""
        return SettingsRegister(
            values=dict(self.values), reference=list(self.reference), delay_steps=list(self.delay_steps)
        )

    def absolute_steps(self, edge: int) -> int:
        """Time of an edge after T0, steps of 5 ps; edges that refer to each other in a ring are a RecursionError."""
        if edge == 1:
            return max(self.absolute_steps(other) for other in range(2, EDGES))
        steps, seen = 0, set()
        while edge != 0:
            if edge in seen:
                raise RecursionError
            seen.add(edge)
            steps, edge = steps + self.delay_steps[edge], self.reference[edge]
        return steps
