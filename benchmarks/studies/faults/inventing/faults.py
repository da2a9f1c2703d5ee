"""Programs of faults: what each kind does, and what it keeps from being heard meanwhile."""

import errno
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.studies.faults.inventing.emulator import GATE, SUPPLY

INSTRUMENTS, PROCESSES = (GATE, SUPPLY), ("client", "server")
READ, WRITE, SEND, RECVMSG, FSYNC, OPEN = range(6)
PORT, SOCKET, FILE = 1, 2, 3
RULES, RULE = 8, struct.Struct("=6i")
HINDRANCE_S = 0.1  # Delay of its system calls that keeps a process from acting in time, s
LONGEST_S, EARLIEST_S, LATEST_S = 3.0, -1.0, 2.5

# What each kind strikes, and its values
INSTRUMENT_KINDS: dict[str, tuple[Any, ...]] = {
    "silent": (1,),
    "mute": (1,),
    "garbled orders": (1,),
    "garbled answers": (1,),
    "short answers": (1,),
    "answers twice": (1,),
    "late answers": (0.1, 0.3, 0.6, 2.0),
    "lost orders": (0.1, 0.5),
    "lost answers": (0.1, 0.5),
    "unplugged": (1,),
    "swapped": (1,),
    "power": (1,),
}
DEAF = {"silent", "garbled orders", "lost orders", "unplugged", "power"}
PANEL = {
    GATE: ("LOFF 1,2", "LPOL 1,0", "BURM 1", "PRES 1,2", "TRAT 4000", "LOFF 1,2;TSRC 5"),
    SUPPLY: ("VLIM 900;VSET 850", "VSET 60"),
}
PROCESS_KINDS = ("killed", "stopped", "terminated")
CAMERA_KINDS = ("room light", "stalled", "hangs", "repeats", "broken")
CALLS = (
    ("read", READ, PORT, (errno.EIO,)),
    ("write", WRITE, PORT, (errno.EIO, errno.EAGAIN)),
    ("open", OPEN, PORT, (errno.EBUSY, errno.EACCES)),
    ("send", SEND, SOCKET, (errno.ENOBUFS,)),
    ("recvmsg", RECVMSG, SOCKET, (errno.ENOMEM,)),
    ("write", WRITE, FILE, (errno.ENOSPC, errno.EIO)),
    ("fsync", FSYNC, FILE, (errno.EIO,)),
    ("open", OPEN, FILE, (errno.EMFILE, errno.EIO)),
)


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One fault: what happens to whom, when after the first step begins, and for how long, s."""

    kind: str
    who: str
    at_s: float
    for_s: float
    value: Any = None

    @property
    def over_s(self) -> float:
        """When it is over, s; a panel and a dead process stay as they are."""
        return self.at_s + self.for_s

    def deafens(self, who: str) -> bool:
        """Whether an instrument hears nothing, or nobody can speak to it."""
        if self.kind == "call":
            return self.value[1] == PORT and self.value[0] in (WRITE, OPEN, READ)
        return self.kind in DEAF and self.who == who

    @property
    def is_away(self) -> bool:
        """Whether an instrument hears nothing, or is to be found at another port."""
        return self.kind == "swapped" or any(map(self.deafens, INSTRUMENTS))

    @property
    def delay_s(self) -> float:
        """By how much each system call is late, s."""
        return self.value[3] * 1e-6 if self.kind == "call" else 0.0

    @property
    def hinders(self) -> bool:
        """Whether the process that it strikes cannot act meanwhile."""
        return self.kind == "stopped" or self.delay_s > HINDRANCE_S


def draw_program(rng: np.random.Generator, *, calls: bool) -> tuple[Fault, ...]:
    """Draw one to three faults, in the order of their times."""
    faults = [_draw(rng, calls=calls) for _ in range(rng.integers(1, 4))]
    return tuple(sorted(faults, key=lambda fault: fault.at_s))


def _draw(rng: np.random.Generator, *, calls: bool) -> Fault:
    at_s = float(rng.uniform(EARLIEST_S, LATEST_S))
    for_s = float(np.exp(rng.uniform(np.log(0.05), np.log(LONGEST_S))))
    family = rng.choice(["line", "line", "panel", "process", "camera", *["call"] * 2 * calls])
    if family == "line":
        kind = _of(rng, tuple(INSTRUMENT_KINDS))
        value, who = _of(rng, INSTRUMENT_KINDS[kind]), _of(rng, INSTRUMENTS)
    elif family == "panel":
        kind, who = "panel", _of(rng, INSTRUMENTS)
        value = _of(rng, PANEL[who])
    elif family == "process":
        kind, who, value = _of(rng, PROCESS_KINDS), _of(rng, PROCESSES), None
    elif family == "camera":
        kind, who, value = _of(rng, CAMERA_KINDS), "camera", None
    else:
        kind, who = "call", _of(rng, PROCESSES)
        _, call, where, errors = _of(rng, CALLS)
        error, delay_s, is_short = _of(
            rng, ((_of(rng, errors), 0.0, 0), (0, float(rng.uniform(0.01, 1.0)), 0), (0, 0.0, 1))
        )
        value = (call, where, error, round(1e6 * delay_s), is_short)
    return Fault(kind=kind, who=who, at_s=round(at_s, 3), for_s=round(for_s, 3), value=value)


def _of(rng: np.random.Generator, choices: Any) -> Any:
    return choices[int(rng.integers(len(choices)))]


Drawn = Callable[[float, float], tuple[Fault, ...]]


def _all(*faults: tuple[str, str, float, Any]) -> Drawn:
    """Faults that begin together, by kind, whom, for how long and value; an infinite time is drawn
    from 0.3 to 1 s.
    """

    def draw(at_s: float, short_s: float) -> tuple[Fault, ...]:
        return tuple(
            Fault(kind=kind, who=who, at_s=at_s, for_s=min(for_s, short_s), value=value)
            if math.isinf(for_s)
            else Fault(kind=kind, who=who, at_s=at_s, for_s=for_s, value=value)
            for kind, who, for_s, value in faults
        )

    return draw


_WRITES_FAIL = (WRITE, PORT, errno.EIO, 0, 0)
_KILLED = ("killed", "client", 0.1, None)
TABLE: dict[str, Drawn] = {
    "port writes return EIO": _all(("call", "server", math.inf, _WRITES_FAIL)),
    "port writes return EIO, client killed": _all(
        ("call", "server", math.inf, _WRITES_FAIL), _KILLED
    ),
    "both instruments silent for 20 s": _all(*(("silent", who, 20.0, 1) for who in INSTRUMENTS)),
    "both instruments silent for 5 s, client killed": _all(
        *(("silent", who, 5.0, 1) for who in INSTRUMENTS), _KILLED
    ),
    "generator without power for 4 s": _all(("power", GATE, 4.0, 1)),
    "generator without power for 4 s, client killed": _all(("power", GATE, 4.0, 1), _KILLED),
    "first orders to the supply lost, client killed": _all(
        ("lost orders", SUPPLY, 0.15, 1.0), _KILLED
    ),
    "ports come back swapped": _all(("swapped", GATE, math.inf, 1)),
    "ports come back swapped, client killed": _all(("swapped", GATE, math.inf, 1), _KILLED),
    "every frame broken": _all(("broken", "camera", 2.0, None)),
    "one picture again and again": _all(("repeats", "camera", 2.0, None)),
    "room light": _all(("room light", "camera", 2.0, None)),
    **{f"panel: {orders}": _all(("panel", GATE, 0.1, orders)) for orders in PANEL[GATE]},
}
"""Kinds that once left the tube hot where software could know."""


def draw_of_table(kind: str, rng: np.random.Generator) -> tuple[Fault, ...]:
    """Draw a program of a kind of the table, at a random moment while the tube is hot."""
    return TABLE[kind](float(rng.uniform(0.1, LATEST_S)), float(rng.uniform(0.3, 1.0)))


def smaller(program: tuple[Fault, ...]) -> list[tuple[Fault, ...]]:
    """Return the programs that are one step smaller: without a fault, or with a shorter one."""
    without = [program[:at] + program[at + 1 :] for at in range(len(program)) if len(program) > 1]
    shorter = [
        (*program[:at], replace(fault, for_s=round(fault.for_s / 2, 3)), *program[at + 1 :])
        for at, fault in enumerate(program)
        if fault.for_s > 0.1 and fault.kind not in ("panel", "killed", "terminated")
    ]
    return without + shorter
