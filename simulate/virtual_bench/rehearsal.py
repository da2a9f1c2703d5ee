"""Injection of scripted faults."""

import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

from labdata import BadInput, EventLog, read_events
from simulate.virtual_bench.faults import Faults

Place = Literal[
    "delay_generator",
    "high_voltage",
    "filter_wheel",
    "light_source",
    "light_meter",
    "thermometer",
    "camera",
    "surroundings",
]
Kind = Literal[
    "garbage",
    "half lines",
    "silence",
    "no answers",
    "late answers",
    "unplugged",
    "power cycle",
    "trip",
    "packet loss",
    "stalled camera",
    "clock jump",
    "front panel",
    "disobedience",
    "no triggers",
    "port renamed",
    "room light",
]

# Field of `Faults` by kind
_FIELDS: dict[Kind, str] = {
    "garbage": "garbage",
    "half lines": "half_lines",
    "silence": "silent",
    "no answers": "mute",
    "late answers": "late_s",
    "unplugged": "unplugged",
    "power cycle": "power_cycles",
    "trip": "tripped",
    "packet loss": "lost_packet_share",
    "stalled camera": "stalled",
    "clock jump": "clock_jump_s",
    "front panel": "panel",
    "disobedience": "disobedient",
    "no triggers": "untriggered",
    "port renamed": "port_name",
    "room light": "room_light_lux",
}

# Kinds that need a number, and what it counts; those that only some instruments can suffer.
_COUNTED = {
    "late answers": "s late",
    "packet loss": "share of packets",
    "clock jump": "s off",
    "room light": "lux",
}
_OF_THE_CAMERA = ("packet loss", "stalled camera", "clock jump")
_OF = {
    "trip": ("high_voltage", "light_source"),
    "front panel": ("delay_generator", "high_voltage", "light_source"),
    "disobedience": ("delay_generator", "high_voltage", "light_source"),
    "no triggers": ("delay_generator",),
    "room light": ("surroundings",),
}


@dataclass(frozen=True, kw_only=True)
class ScriptedFault:
    """One fault."""

    instrument: Place  #: Whose
    kind: Kind  #: What is wrong with it
    #: Label of the step whose beginning starts the clock; None: the beginning of the run
    at_step: str | None = None
    at_s: float = 0.0  #: How long after that it strikes, s
    for_s: float = 1.0  #: How long it lasts, s; a power cycle is over at once
    #: For late answers how late, s; for packet loss the fraction lost; for a clock jump how far, s;
    #: for room light the illuminance on the photocathode, lux
    value: float | None = None
    panel: tuple[
        str, ...
    ] = ()  #: For the front panel: what is entered there, in the instrument's own language

    def __post_init__(self) -> None:
        places = _OF.get(self.kind, (self.instrument,))
        rules = (
            (
                self.at_s >= 0.0 and self.for_s > 0.0,
                f"a fault must strike at 0 s or later for some time, got {self.at_s:g} and "
                f"{self.for_s:g} s",
            ),
            (
                (self.kind in _OF_THE_CAMERA) == (self.instrument == "camera"),
                f"a camera must suffer one of {', '.join(_OF_THE_CAMERA)}, and no other, got "
                f"{self.words}",
            ),
            (
                self.instrument in places,
                f"a fault of kind {self.kind!r} must be of {' or '.join(places)}, got {self.words}",
            ),
            (
                self.instrument != "surroundings" or self.kind == "room light",
                f"the surroundings must suffer room light, and nothing else, got {self.words}",
            ),
            (
                (self.kind == "front panel") == bool(self.panel),
                f"panel must hold commands for a front panel, and for no other, got {self.panel}",
            ),
            (
                (self.kind in _COUNTED) == (self.value is not None),
                f"value must be given for {', '.join(_COUNTED)}, and for no other, got "
                f"{self.value} for {self.kind}",
            ),
            (
                self.kind != "packet loss" or 0.0 < (self.value or 0.0) <= 1.0,
                f"the share of packets lost must lie between 0 and 1, got {self.value}",
            ),
        )
        for is_kept, sentence in rules:
            if not is_kept:
                raise BadInput(sentence)

    @property
    def words(self) -> str:
        """Description of the fault."""
        much = "" if self.value is None else f" ({self.value:g} {_COUNTED.get(self.kind, '')})"
        return f"{self.kind} of {self.instrument}{much}"

    @property
    def faults(self) -> Faults:
        """The fault as `Faults`; the caller counts power cycles."""
        uncounted_values = {
            "power cycle": 1,
            "front panel": self.panel,
            "port renamed": f"{self.instrument}.renamed",
        }
        value: Any = self.value if self.kind in _COUNTED else uncounted_values.get(self.kind, True)
        return Faults(**{_FIELDS[self.kind]: value})


@dataclass(frozen=True, kw_only=True)
class FaultScript:
    """A file of faults."""

    fault: tuple[ScriptedFault, ...]  #: The faults, in any order

    def __post_init__(self) -> None:
        if not self.fault:
            raise BadInput("a script of faults must hold at least one, got none")


def combine_faults(strikes: list[ScriptedFault], power_cycles: int) -> Faults:
    """Combine the faults of one instrument that hold now; of two that count something, the worse
    one.
    """
    names = vars(Faults())
    given = {name: [getattr(strike.faults, name) for strike in strikes] for name in names}
    combined = {
        name: max((value for value in values if value is not None), default=names[name])
        for name, values in given.items()
    }
    return Faults(**{**combined, "power_cycles": power_cycles})


TICK_S = 0.02
STRUCK = "fault strikes"


class Rehearsal:
    """Injects scripted faults during its `with` block, in a thread of its own, and removes them at
    its end.

    Parameters
    ----------
    provoke
        Gives an instrument its faults, see `VirtualBench.provoke`; an unknown one is BadInput on
        entering.
    steps
        Log of the session with the start of each step.
    log
        File that records the injected faults: a resumed run goes on with the rest of the script.
    """

    def __init__(
        self,
        script: FaultScript,
        *,
        provoke: Callable[[str, Faults], None],
        steps: Path,
        log: Path,
        say: Callable[[str], None] = lambda sentence: None,
    ) -> None:
        self._script, self._provoke, self._say = script, provoke, say
        self._steps, self._log_path = _Steps(steps), log
        self._power_cycles: Counter[str] = Counter()
        self._holding: dict[int, float] = {}
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._strike, daemon=True)

    def __enter__(self) -> Self:
        logged = read_events(self._log_path) if self._log_path.exists() else []
        struck = {event["number"] for event in logged if event["event"] == STRUCK}
        self._left = {
            number: fault for number, fault in enumerate(self._script.fault) if number not in struck
        }
        for instrument in {fault.instrument for fault in self._script.fault}:
            self._provoke(instrument, Faults())
        self._log = EventLog(self._log_path)
        self._began_s = time.monotonic()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        for number in list(self._holding):
            self._end(number)
        self._log.close()

    def _strike(self) -> None:
        while not self._over.wait(TICK_S):
            now_s = time.monotonic()
            self._steps.look(now_s)
            for number, fault in list(self._left.items()):
                if (begins_s := self._begins_s(fault)) is not None and now_s >= begins_s:
                    del self._left[number]
                    self._begin(number, fault, now_s)
            for number, until_s in list(self._holding.items()):
                if now_s >= until_s:
                    self._end(number)

    def _begins_s(self, fault: ScriptedFault) -> float | None:
        """Start time of a fault; None before its step has begun."""
        since_s = self._began_s if fault.at_step is None else self._steps.began_s.get(fault.at_step)
        return None if since_s is None else since_s + fault.at_s

    def _begin(self, number: int, fault: ScriptedFault, now_s: float) -> None:
        self._log(
            STRUCK, number=number, instrument=fault.instrument, kind=fault.kind, for_s=fault.for_s
        )
        self._say(f"Rehearsal: {fault.words} for {fault.for_s:g} s.")
        self._holding[number] = now_s + fault.for_s
        self._power_cycles[fault.instrument] += fault.kind == "power cycle"
        self._tell(fault.instrument)

    def _end(self, number: int) -> None:
        del self._holding[number]
        fault = self._script.fault[number]
        # The latch of a trip is cleared by a person, who switches the instrument off and on.
        self._power_cycles[fault.instrument] += fault.kind == "trip"
        self._tell(fault.instrument)
        self._log("fault ends", number=number)

    def _tell(self, instrument: str) -> None:
        holding = [
            fault
            for number in self._holding
            if (fault := self._script.fault[number]).instrument == instrument
        ]
        self._provoke(instrument, combine_faults(holding, self._power_cycles[instrument]))


class _Steps:
    """Which steps of the running acquisition began, and when; what its log held before belongs to
    an earlier run.
    """

    def __init__(self, log: Path) -> None:
        self._log, self._size = log, -1
        self._events_read = len(self._events())
        self.began_s: dict[str, float] = {}

    def look(self, now_s: float) -> None:
        for event in self._events()[self._events_read :]:
            if event["event"] == "step begins":
                self.began_s.setdefault(event["step"], now_s)

    def _events(self) -> list[dict]:
        """Return the events of the log; none where it has not grown since the last call."""
        size = self._log.stat().st_size if self._log.exists() else 0
        is_same, self._size = size == self._size, size
        return [] if is_same or not size else read_events(self._log)
