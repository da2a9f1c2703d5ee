"""A virtual Thorlabs DC2100 driver of a light-emitting diode: constant current, limits, an error
for each refusal.
"""

import re
from collections import deque
from typing import Any

from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.instrument import LineInstrument, VirtualModel
from simulate.virtual_bench.outputs import LAMP_FILE

MAXIMUM_MA = 2000
DIODE_OPEN, AT_LIMIT = 8, 32
UNKNOWN, OUT_OF_RANGE, NOT_NOW = (
    (1, "unknown command"),
    (2, "value out of range"),
    (3, "not possible now"),
)
# Codes and words of errors are recalled; their form is looked up.
_COMMAND = re.compile(r"([a-z]+)(\?)?(?: (-?\d{1,9}))?")


class LightSource(LineInstrument):
    """LED driver after power-on: dark."""

    output_file = LAMP_FILE
    longest_line = 64

    def __init__(self) -> None:
        self._limit_ma = MAXIMUM_MA
        self.power_cycle()

    def power_cycle(self) -> None:
        """Power cycle: dark, the current limit stays."""
        self._on, self._mode, self._current_ma, self._open = False, 0, 0, False
        self._errors: deque[tuple[int, str]] = deque(maxlen=10)
        self._line = b""

    def _answer(self, line: str) -> str | None:
        match = _COMMAND.fullmatch(line.lower())
        name, asks, value = match.groups() if match else ("", None, None)
        if asks and value is None:
            return self._answer_query(name)
        return (
            self._set(name, int(value))
            if value is not None and not asks
            else self._complain(UNKNOWN)
        )

    def _answer_query(self, name: str) -> str | None:
        if name == "e":
            code, meaning = self._errors.popleft() if self._errors else (0, "no error")
            return f"ERROR {code}: {meaning}"
        known = {
            "n": "DC2100",
            "s": "M00123456",
            "v": "1.3.0",
            "o": int(self._on),
            "m": self._mode,
            "l": self._limit_ma,
            "ml": MAXIMUM_MA,
            "cc": self._current_ma,
            "r": DIODE_OPEN * self._open
            | AT_LIMIT * (self._on and self._current_ma >= self._limit_ma > 0),
        }
        return str(known[name]) if name in known else self._complain(UNKNOWN)

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
            self._limit_ma, self._current_ma = value, min(self._current_ma, value)
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

    def outputs(self) -> dict[str, Any]:
        return {"current_a": self.current_a}


MODEL = VirtualModel(
    name="dc2100", bench_name="light_source", make=lambda address, scale: LightSource(), baud=115200
)
