"""Meters: Thorlabs PM100 light meter, and Stanford CTC100 or PTC10 as a thermometer, read only."""

import re

from drivers.instruments.instrument import Instrument, InstrumentModel
from drivers.serial_lines.line import FramedLine, KnownAnswer

AVERAGED = 100  # Readings averaged into one, of about 3000 per second

_ERROR = re.compile(r'([-+]?\d{1,9})\s*,\s*"?(.*?)"?')


class PowerMeter(Instrument):
    """Thorlabs PM100 family."""

    def identify(self) -> str:
        """Return the identity, clear old errors, and select watts with automatic range."""
        identity = self._identity("*IDN?", r"(?i).*thorlabs,\s*PM1\d\d.*", "of the PM100 family")
        self.line.write("*CLS")
        for command in ("SENS:POW:UNIT W", "SENS:POW:RANG:AUTO ON", f"SENS:AVER:COUN {AVERAGED}"):
            self._set(command)
        self.tune(550.0)
        return identity

    def look(self) -> None:
        """Query a reading, to verify that it answers."""
        self.power_w()

    def tune(self, wavelength_nm: float) -> None:
        """Set the wavelength of the head's sensitivity correction, nm, and read it back."""
        self._set(f"SENS:CORR:WAV {wavelength_nm:g}")
        self.line.verify_read_back("SENS:CORR:WAV?", wavelength_nm, tolerance=0.5)

    def power_w(self) -> float:
        """Power on the head, W."""
        return self.line.query_float("MEAS:POW?")

    def _error(self) -> tuple[int, str]:
        answer = self.line.ask("SYST:ERR?")
        match = _ERROR.fullmatch(answer)
        if match is None:
            raise self.line.reply_error(
                "answer SYST:ERR? with a code and its meaning", repr(answer)
            )
        return int(match[1]), f"error {int(match[1])}: {match[2]}"


LIGHT_METER = InstrumentModel(
    name="pm101",
    role="light-meter",
    title="light meter",
    line=lambda port, address: FramedLine(port, name="light meter", answer_end=b"\n"),
    driver=PowerMeter,
    baud=115200,
)


CHANNEL = "In1"
KNOWN = KnownAnswer(question="*IDN?", form=r"(?i).*(CTC100|PTC10).*")
# In verbose mode the name of the variable precedes its value.
_SAID = re.compile(r"(?:[^=]*=)?\s*(\S+)\s*")


class Thermometer(Instrument):
    """Stanford CTC100 or PTC10, first input."""

    def identify(self) -> str:
        """Return the identity; another instrument is InstrumentReplyError."""
        return self._identity(KNOWN.question, KNOWN.form, "a CTC100 or PTC10")

    def look(self) -> None:
        """Query a reading, to verify that it answers."""
        self.temperature_c()

    def temperature_c(self) -> float:
        """Temperature of the sensor, degrees Celsius; a sensor that is open or missing is
        InstrumentReplyError.
        """
        unit = self._query_value(f"{CHANNEL}.units?")
        value = self.line.parse_float(self._query_value(f"{CHANNEL}.value?"), f"{CHANNEL}.value?")
        if unit.endswith("C"):
            return value
        if unit == "K":
            return value - 273.15  # K
        raise self.line.reply_error("measure in degrees Celsius or kelvin", repr(unit))

    def _query_value(self, question: str) -> str:
        answer = self.line.ask(question)
        match = _SAID.fullmatch(answer)
        if match is None:
            raise self.line.reply_error(f"answer {question} with a value", repr(answer))
        return match[1]


THERMOMETER = InstrumentModel(
    name="ctc100",
    role="thermometer",
    title="thermometer",
    line=lambda port, address: FramedLine(
        port, name="thermometer", command_end=b"\r\n", known=KNOWN
    ),
    driver=Thermometer,
)
