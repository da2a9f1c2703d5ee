"""A virtual Stanford CTC100 temperature controller, as far as it is a thermometer: identity, units, values."""

import json
from pathlib import Path

from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.outputs import replace_file

IDENTITY = "CTC100 Cryogenic Temperature Controller, version 3.304, S/N 90001"
TEMPERATURE_C = 23.4
INPUTS = ("in1", "in2", "in3", "in4")
COMMAND_S = 5e-3
BUFFER_LENGTH = 256
OUTPUT = "thermometer.output.json"


class Thermometer:
    """Temperature controller with a sensor at its first input; the others are open."""

    def __init__(self) -> None:
        self._line, self._published = b"", False

    def power_cycle(self) -> None:
        """Power cycle."""
        self._line = b""

    def receive(self, data: bytes) -> list[tuple[float, bytes]]:
        """Take bytes; return answers, each with the time it takes, s."""
        *lines, self._line = (self._line + data.replace(b"\r", b"\n")).split(b"\n")
        self._line = self._line[-BUFFER_LENGTH:]
        said = (self._answer(line.decode("ascii", "replace").strip().lower()) for line in lines if line.strip())
        return [(COMMAND_S, answer + b"\r\n") for answer in said]

    def _answer(self, line: str) -> bytes:
        if line == "*idn?":
            return IDENTITY.encode()
        name, _, what = line.partition(".")
        if name in INPUTS and what == "units?":
            return b"\xb0C"
        if name in INPUTS and what == "value?":
            return f"{TEMPERATURE_C:.3f}".encode() if name == INPUTS[0] else b"NaN"
        return b"Error: unknown command"

    def advance(self, now_s: float, faults: Faults) -> None:
        """Do nothing: the temperature is constant."""

    def publish(self, folder: Path) -> None:
        """Publish the temperature of the tube."""
        if not self._published:
            replace_file(folder / OUTPUT, json.dumps({"temperature_c": TEMPERATURE_C}))
            self._published = True
