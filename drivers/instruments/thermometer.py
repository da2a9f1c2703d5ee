"""Thermometer: Stanford CTC100 or PTC10 temperature controller, read only."""

import re

from drivers.instruments.instrument import Instrument, InstrumentModel
from drivers.serial_lines.line import FramedLine, KnownAnswer

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
        """Temperature of the sensor, degrees Celsius; a sensor that is open or missing is InstrumentReplyError."""
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


MODEL = InstrumentModel(
    name="ctc100",
    role="thermometer",
    title="thermometer",
    line=lambda port, address: FramedLine(port, name="thermometer", command_end=b"\r\n", known=KNOWN),
    driver=Thermometer,
)
