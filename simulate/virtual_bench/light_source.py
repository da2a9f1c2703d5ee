"""A virtual Thorlabs DC2100 driver of a light-emitting diode: constant current, limits, an error for each refusal."""

import json
import re
from collections import deque
from pathlib import Path

from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.outputs import replace_file

IDENTITY = "DC2100"
MAXIMUM_MA = 2000
OUTPUT = "light_source.output.json"
COMMAND_S = 2e-3
BUFFER_LENGTH = 64
NO_DIODE, DIODE_OPEN, AT_LIMIT = 2, 8, 32
UNKNOWN, OUT_OF_RANGE, NOT_NOW = (1, "unknown command"), (2, "value out of range"), (3, "not possible now")
# Codes and words of errors are recalled; their form is looked up.
_COMMAND = re.compile(r"([a-z]+)(\?)?(?: (-?\d{1,9}))?")


class LightSource:
    """LED driver after power-on: dark."""

    def __init__(self) -> None:
        self._limit_ma = MAXIMUM_MA
        self._published: dict | None = None
        self._line = b""
        self.power_cycle()

    def power_cycle(self) -> None:
        """Power cycle: dark, the current limit stays."""
        self._on, self._mode, self._current_ma, self._open = False, 0, 0, False
        self._errors: deque[tuple[int, str]] = deque(maxlen=10)
        self._line = b""

    def receive(self, data: bytes) -> list[tuple[float, bytes]]:
        """Take bytes; return answers, each with the time it takes, s. Sets answer nothing."""
        *lines, self._line = (self._line + data.replace(b"\r", b"\n")).split(b"\n")
        self._line = self._line[-BUFFER_LENGTH:]
        answers = (self._obey(line.decode("ascii", "replace").strip().lower()) for line in lines if line.strip())
        return [(COMMAND_S, answer.encode() + b"\r\n") for answer in answers if answer is not None]

    def _obey(self, line: str) -> str | None:
        match = _COMMAND.fullmatch(line)
        if match is None:
            self._errors.append(UNKNOWN)
            return None
        name, asks, value = match.groups()
        if asks:
            return self._answer_query(name) if value is None else self._complain(UNKNOWN)
        return self._complain(UNKNOWN) if value is None else self._set(name, int(value))

    def _answer_query(self, name: str) -> str | None:
        if name == "e":
            code, meaning = self._errors.popleft() if self._errors else (0, "no error")
            return f"ERROR {code}: {meaning}"
        known = {
            "n": IDENTITY,
            "s": "M00123456",
            "v": "1.3.0",
            "o": str(int(self._on)),
            "m": str(self._mode),
            "l": str(self._limit_ma),
            "ml": str(MAXIMUM_MA),
            "cc": str(self._current_ma),
            "r": str(DIODE_OPEN * self._open | AT_LIMIT * (self._on and self._current_ma >= self._limit_ma > 0)),
        }
        return known[name] if name in known else self._complain(UNKNOWN)

    def _set(self, name: str, value: int) -> None:
        highest = {"o": 1, "m": 2, "l": MAXIMUM_MA, "cc": self._limit_ma}
        if name not in highest:
            return self._complain(UNKNOWN)
        if not 0 <= value <= highest[name]:
            return self._complain(OUT_OF_RANGE)
        if name == "o":
            if value and self._open:
                return self._complain(NOT_NOW)
            self._on = bool(value)
        elif name == "m":
            self._on, self._mode = False, value
        elif name == "l":
            self._limit_ma = value
            self._current_ma = min(self._current_ma, value)
        else:
            self._current_ma = value
        return None

    def _complain(self, error: tuple[int, str]) -> None:
        self._errors.append(error)

    def advance(self, now_s: float, faults: Faults) -> None:
        """Open the diode during a trip."""
        self._open = faults.tripped
        self._on = self._on and not self._open

    @property
    def current_a(self) -> float:
        """Current through the diode, A."""
        return self._current_ma * 1e-3 if self._on and self._mode == 0 else 0.0

    def publish(self, folder: Path) -> None:
        """Publish the current through the diode."""
        now = {"current_a": self.current_a}
        if now != self._published:
            replace_file(folder / OUTPUT, json.dumps(now))
            self._published = now
