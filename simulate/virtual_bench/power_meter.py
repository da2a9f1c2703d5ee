"""A virtual Thorlabs PM101R power meter: SCPI over a serial line, watts on its head, averaging that takes its time."""

import json
from collections import deque
from collections.abc import Callable
from pathlib import Path

import numpy as np

from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.outputs import replace_file

IDENTITY = "Thorlabs,PM101R,M00654321,1.2.0"
LUX_PER_W = 1.6e5  # Illuminance on the photocathode for a watt on the head: 1 cm2 of light of 16 lm/W next to the tube

NOISE_W = 2e-12
READINGS_PER_S = 3000.0
COMMAND_S = 2e-3
BUFFER_LENGTH = 256
OUTPUT = "light_meter.output.json"
NO_ERROR, UNDEFINED, OUT_OF_RANGE = '+0,"No error"', '-113,"Undefined header"', '-222,"Data out of range"'
_UNITS, _SWITCHES = ("W", "DBM"), {"ON": 1, "OFF": 0, "1": 1, "0": 0}


class PowerMeter:
    """Power meter after power-on."""

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0x9A)
        self._errors: deque[str] = deque(maxlen=30)
        self._published = False
        self._light: Callable[[], float] = lambda: 0.0
        self.power_cycle()

    def power_cycle(self) -> None:
        """Power cycle: factory settings."""
        self._wavelength_nm, self._averaged, self._unit, self._automatic = 635.0, 1, "W", 1
        self._line = b""
        self._errors.clear()

    def receive(self, data: bytes) -> list[tuple[float, bytes]]:
        """Take bytes; return answers, each with the time it takes, s. Sets answer nothing."""
        *lines, self._line = (self._line + data.replace(b"\r", b"\n")).split(b"\n")
        self._line = self._line[-BUFFER_LENGTH:]
        said = (self._obey(line.decode("ascii", "replace").strip()) for line in lines if line.strip())
        return [(seconds, answer.encode() + b"\n") for seconds, answer in said if answer is not None]

    def _obey(self, line: str) -> tuple[float, str | None]:
        name, _, value = line.upper().partition(" ")
        if name == "MEAS:POW?":
            return self._averaged / READINGS_PER_S, f"{self._watts():.6E}"
        asked = {
            "*IDN?": lambda: IDENTITY,
            "SYST:ERR?": lambda: self._errors.popleft() if self._errors else NO_ERROR,
            "SENS:CORR:WAV?": lambda: f"{self._wavelength_nm:.6E}",
            "SENS:AVER:COUN?": lambda: str(self._averaged),
            "SENS:POW:UNIT?": lambda: self._unit,
            "SENS:POW:RANG:AUTO?": lambda: str(self._automatic),
        }
        if name in asked:
            return COMMAND_S, asked[name]()
        self._set(name, value.strip())
        return COMMAND_S, None

    def _set(self, name: str, value: str) -> None:
        try:
            if name == "*CLS":
                self._errors.clear()
            elif name == "SENS:CORR:WAV" and 400.0 <= float(value) <= 1100.0:
                self._wavelength_nm = float(value)
            elif name == "SENS:AVER:COUN" and 1 <= int(value) <= 10000:
                self._averaged = int(value)
            elif name == "SENS:POW:UNIT" and value in _UNITS:
                self._unit = value
            elif name == "SENS:POW:RANG:AUTO" and value in _SWITCHES:
                self._automatic = _SWITCHES[value]
            else:
                known = ("SENS:CORR:WAV", "SENS:AVER:COUN", "SENS:POW:UNIT", "SENS:POW:RANG:AUTO")
                self._errors.append(OUT_OF_RANGE if name in known else UNDEFINED)
        except ValueError:
            self._errors.append(OUT_OF_RANGE)

    def _watts(self) -> float:
        return self._light() / LUX_PER_W + NOISE_W * float(self._rng.standard_normal())

    def advance(self, now_s: float, faults: Faults) -> None:
        """Do nothing: the meter has no dynamics."""

    def publish(self, folder: Path) -> None:
        """Publish that the meter is on."""
        if not self._published:
            replace_file(folder / OUTPUT, json.dumps({"meter_on": True}))
            self._published = True

    def connect_light(self, light: Callable[[], float]) -> None:
        """Connect the head to the light of the bench, lux on the photocathode."""
        self._light = light
