"""Light meter: Thorlabs PM100 family with a serial port."""

import re

from drivers.instruments.instrument import Instrument, InstrumentModel
from drivers.serial_lines.line import FramedLine

AVERAGED = 100  # Readings averaged into one, of about 3000 per second

DEFAULT_WAVELENGTH_NM = 550.0
_ERROR = re.compile(r'([-+]?\d{1,9})\s*,\s*"?(.*?)"?')


class PowerMeter(Instrument):
    """Thorlabs PM100 family."""

    def identify(self) -> str:
        """Return the identity, clear old errors, and select watts with automatic range."""
        identity = self._identity("*IDN?", r"(?i).*thorlabs,\s*PM1\d\d.*", "of the PM100 family")
        self.line.write("*CLS")
        for command in ("SENS:POW:UNIT W", "SENS:POW:RANG:AUTO ON", f"SENS:AVER:COUN {AVERAGED}"):
            self._set(command)
        self.tune(DEFAULT_WAVELENGTH_NM)
        return identity

    def look(self) -> None:
        """Query a reading, to verify that it answers."""
        self.power_w()

    def tune(self, wavelength_nm: float) -> None:
        """Set the wavelength of the head's sensitivity correction, nm, and read it back."""
        self._set(f"SENS:CORR:WAV {wavelength_nm:g}")
        self.line.verify_read_back("SENS:CORR:WAV?", wavelength_nm, within=0.5)

    def power_w(self) -> float:
        """Power on the head, W."""
        return self.line.query_float("MEAS:POW?")

    def _set(self, command: str) -> None:
        self.line.write(command)
        answer = self.line.ask("SYST:ERR?")
        match = _ERROR.fullmatch(answer)
        if match is None:
            raise self.line.reply_error("answer SYST:ERR? with a code and its meaning", repr(answer))
        if code := int(match[1]):
            raise self.line.rejection(f"accept {command!r}", f"error {code}: {match[2]}", code=code)


MODEL = InstrumentModel(
    name="pm101",
    role="light-meter",
    title="light meter",
    line=lambda port, address: FramedLine(port, name="light meter", answer_end=b"\n"),
    driver=PowerMeter,
    baud=115200,
)
