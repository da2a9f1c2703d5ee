"""Virtual Thorlabs FW102C filter wheel: echo, prompt and turning time."""

import time
from typing import Any

from simulate.virtual_bench.instrument import VirtualInstrument, VirtualModel
from simulate.virtual_bench.outputs import WHEEL_FILE

IDENTITY = "THORLABS FW102C/FW212C Filter Wheel version 1.07"
PROMPT = b"> "
STEP_S = (0.45, 0.25)  # from one position to the next, slow and fast; recalled
COMMAND_S = 2e-3
BUFFER_LENGTH = 64
# the second is recalled
UNKNOWN, BAD_ARGUMENT = "Command error CMD_NOT_DEFINED", "Command error CMD_ARG_INVALID"
_NEW = {"pcount": 6, "trig": 0, "speed": 1, "sensors": 1, "baud": 1}
_ALLOWED = {"pcount": (6, 12), "trig": (0, 1), "speed": (0, 1), "sensors": (0, 1), "baud": (0, 1)}


class FilterWheel(VirtualInstrument):
    """Filter wheel after power-on, at its first position; it turns `time_scale` times faster than
    life.
    """

    output_file = WHEEL_FILE

    def __init__(self, *, time_scale: float = 1.0) -> None:
        self._time_scale = time_scale
        self._saved = dict(_NEW)
        self._settings = dict(_NEW)
        self._position, self._line = 1, b""
        self._turns_until_s = 0.0

    def power_cycle(self) -> None:
        """Lose power and get it back: what was not saved is lost, and the wheel stands where it
        stood.
        """
        self._settings, self._line = dict(self._saved), b""

    def receive(self, data: bytes) -> list[tuple[float, bytes]]:
        """Take bytes; return echo, answers and prompts, each with the time it takes, s."""
        replies: list[tuple[float, bytes]] = []
        for value in data:
            byte = bytes([value])
            replies.append((0.0, byte))
            if byte != b"\r":
                self._line = (self._line + byte)[-BUFFER_LENGTH:]
                continue
            line, self._line = self._line.decode("ascii", "replace").strip(), b""
            seconds, answer = self._obey(line) if line else (0.0, "")
            end = b"\n" if answer.startswith("Command error") else b"\r"
            replies.append(
                (COMMAND_S + seconds, (answer.encode() + end if answer else b"") + PROMPT)
            )
        return replies

    def _obey(self, line: str) -> tuple[float, str]:
        """Return the time of the command, s, and its answer."""
        name, mark, value = line.partition("=")
        if line == "*idn?":
            return 0.0, IDENTITY
        if line == "save":
            self._saved = dict(self._settings)
            return 0.0, ""
        if line == "pos?":
            return 0.0, str(self._position)
        if line.endswith("?") and line[:-1] in self._settings:
            return 0.0, str(self._settings[line[:-1]])
        if not mark or name not in ("pos", *self._settings):
            return 0.0, UNKNOWN
        if not value.isdecimal() or not value.isascii():
            return 0.0, BAD_ARGUMENT
        return self._set(name, int(value))

    def _set(self, name: str, value: int) -> tuple[float, str]:
        allowed = range(1, self._settings["pcount"] + 1) if name == "pos" else _ALLOWED[name]
        if value not in allowed:
            return 0.0, BAD_ARGUMENT
        if name != "pos":
            self._settings[name] = value
            return 0.0, ""
        around = abs(value - self._position)
        steps = min(around, self._settings["pcount"] - around)
        self._position = value
        turning_s = steps * STEP_S[self._settings["speed"]] / self._time_scale
        self._turns_until_s = time.monotonic() + turning_s
        return turning_s, ""

    @property
    def position(self) -> int | None:
        """Position of the wheel, from 1; None while it turns and blocks the light."""
        return self._position if time.monotonic() >= self._turns_until_s else None

    def outputs(self) -> dict[str, Any]:
        return {"position": self.position, "sensors_lit": bool(self._settings["sensors"])}


MODEL = VirtualModel(
    name="fw102c",
    bench_name="filter_wheel",
    make=lambda address, scale: FilterWheel(time_scale=scale),
    baud=115200,
)
