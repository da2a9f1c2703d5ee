"""The thermometer: a Stanford CTC100 or PTC10 temperature controller, of which one sensor is read and nothing set."""

import re

from drivers.instruments.instrument import Instrument, InstrumentModel
from drivers.serial_lines.line import FramedLine, KnownAnswer

CHANNEL = "In1"
KNOWN = KnownAnswer(question="*IDN?", form=r"(?i).*(CTC100|PTC10).*")
ZERO_C_IN_K = 273.15
# Where the controller is set to say much, the name of what was asked stands before its value.
_SAID = re.compile(r"(?:[^=]*=)?\s*(\S+)\s*")


class Thermometer(Instrument):
    """The controller, read at its first input."""

    def identify(self) -> str:
        """Return the identity; another instrument is InstrumentReplyError."""
        return self._identity(KNOWN.question, KNOWN.form, "a CTC100 or PTC10")

    def look(self) -> None:
        """Ask for a sign of life."""
        self.temperature_c()

    def temperature_c(self) -> float:
        """Temperature of the sensor, degrees Celsius; a sensor that is open or missing is InstrumentReplyError."""
        unit = self._asked(f"{CHANNEL}.units?")
        value = self.line.parse_float(self._asked(f"{CHANNEL}.value?"), f"{CHANNEL}.value?")
        if unit.endswith("C"):
            return value
        if unit == "K":
            return value - ZERO_C_IN_K
        raise self.line.reply_error("measure in degrees Celsius or kelvin", repr(unit))

    def _asked(self, question: str) -> str:
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
