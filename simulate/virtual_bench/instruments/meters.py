"""Virtual meters: a Thorlabs PM101R power meter (SCPI), and a Stanford CTC100 controller as a
thermometer.
"""

from collections import deque
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from simulate.virtual_bench.instrument import LineInstrument, VirtualModel
from simulate.virtual_bench.outputs import THERMOMETER_FILE

# Illuminance on the photocathode for a watt on the head: 1 cm2 of light of 16 lm/W next to the tube
LUX_PER_W = 1.6e5
NOISE_W = 2e-12
TEMPERATURE_C = 23.4
NO_ERROR, UNDEFINED, OUT_OF_RANGE = (
    '+0,"No error"',
    '-113,"Undefined header"',
    '-222,"Data out of range"',
)
_SWITCHES = {"ON": 1, "OFF": 0, "1": 1, "0": 0}
_INPUTS = ("in1", "in2", "in3", "in4")


class PowerMeter(LineInstrument):
    """Power meter after power-on; its averaging takes time."""

    output_file = "light_meter.output.json"
    answer_end = b"\n"

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0x9A)
        self._errors: deque[str] = deque(maxlen=30)
        self._light: Callable[[], float] = lambda: 0.0
        self.power_cycle()

    def power_cycle(self) -> None:
        """Power cycle: factory settings."""
        self._wavelength_nm, self._averaged, self._unit, self._automatic = 635.0, 1, "W", 1
        self._line = b""
        self._errors.clear()

    def _replies(self, line: str) -> Iterable[tuple[float, str]]:
        name, _, value = line.strip().upper().partition(" ")
        if name == "MEAS:POW?":
            return [(self._averaged / 3000.0, f"{self._watts():.6E}")]
        if name == "SYST:ERR?":
            return [(self.command_s, self._errors.popleft() if self._errors else NO_ERROR)]
        asked = {
            "*IDN?": "Thorlabs,PM101R,M00654321,1.2.0",
            "SENS:CORR:WAV?": f"{self._wavelength_nm:.6E}",
            "SENS:AVER:COUN?": str(self._averaged),
            "SENS:POW:UNIT?": self._unit,
            "SENS:POW:RANG:AUTO?": str(self._automatic),
        }
        if name in asked:
            return [(self.command_s, asked[name])]
        self._set(name, value.strip())
        return []

    def _set(self, name: str, value: str) -> None:
        try:
            if name == "*CLS":
                self._errors.clear()
            elif name == "SENS:CORR:WAV" and 400.0 <= float(value) <= 1100.0:
                self._wavelength_nm = float(value)
            elif name == "SENS:AVER:COUN" and 1 <= int(value) <= 10000:
                self._averaged = int(value)
            elif name == "SENS:POW:UNIT" and value in ("W", "DBM"):
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

    def outputs(self) -> dict[str, Any]:
        return {"meter_on": True}

    def connect_light(self, light: Callable[[], float]) -> None:
        """Connect the head to the light of the bench, lux on the photocathode."""
        self._light = light


class Thermometer(LineInstrument):
    """Temperature controller with a sensor at its first input; the others are open."""

    output_file = THERMOMETER_FILE
    command_s = 5e-3

    def power_cycle(self) -> None:
        """Power cycle."""
        self._line = b""

    def _answer(self, line: str) -> str:
        if line.lower() == "*idn?":
            return "CTC100 Cryogenic Temperature Controller, version 3.304, S/N 90001"
        name, _, what = line.lower().partition(".")
        if name in _INPUTS and what == "units?":
            return "°C"
        if name in _INPUTS and what == "value?":
            return f"{TEMPERATURE_C:.3f}" if name == _INPUTS[0] else "NaN"
        return "Error: unknown command"

    def outputs(self) -> dict[str, Any]:
        return {"temperature_c": TEMPERATURE_C}


LIGHT_METER = VirtualModel(
    name="pm101", bench_name="light_meter", make=lambda address, scale: PowerMeter(), baud=115200
)
THERMOMETER = VirtualModel(
    name="ctc100", bench_name="thermometer", make=lambda address, scale: Thermometer(), baud=9600
)
