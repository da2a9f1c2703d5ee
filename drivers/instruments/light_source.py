"""The light: a Thorlabs DC2100 or DC2010 driver of a light-emitting diode at constant current.

Commands, status bits and error format follow the maker's Micro-Manager adapter (ThorlabsDCxxxx).
"""

import math
import re

from drivers.instruments.instrument import Instrument, InstrumentModel
from drivers.serial_lines.line import FramedLine, KnownAnswer
from labdata.errors import BadInput

KNOWN = KnownAnswer(question="n?", form=r".*DC2[01]\d\d.*")
STEP_A = 1e-3
CONSTANT_CURRENT = 0
FAULTS = {2: "no diode connected", 8: "its diode open", 32: "its diode at the current limit"}
_ERROR = re.compile(r"\S+ (-?\d{1,9}) ?:(.*)")


class LightSource(Instrument):
    """Thorlabs DC2100 or DC2010."""

    dark_commands = ("o 0",)

    def identify(self) -> str:
        name = self._identity(KNOWN.question, KNOWN.form, "a DC2100 or DC2010")
        self._error()
        return name

    def look(self) -> None:
        """Raise InstrumentRejected for a fault of the diode in the status."""
        status = self.line.query_int("r?")
        for bit, meaning in FAULTS.items():
            if status & bit:
                raise self.line.rejection("light its diode", meaning, code=status)

    def prepare(self, *, limit_a: float) -> None:
        """Switch the light off, and set the current limit of the driver, A."""
        self.darken()
        self._set(f"m {CONSTANT_CURRENT}")
        self._set(f"l {_milliamperes(limit_a)}")
        if (kept_ma := self.line.query_float("l?")) > 1e3 * limit_a + 0.5:
            raise self.line.rejection(
                f"keep a limit of {1e3 * limit_a:g} mA", f"{kept_ma:g} mA back"
            )

    def darken(self) -> None:
        """Switch the light off and read it back."""
        for command in self.dark_commands:
            self._set(command)
        self.line.verify_read_back("o?", 0)

    def shine(self, current_a: float) -> float:
        """Drive the diode with a current, a multiple of 1 mA, and return its read-back, A."""
        milliamperes = _milliamperes(current_a)
        self._set(f"cc {milliamperes}")
        self.line.verify_read_back("cc?", milliamperes)
        self._set("o 1")
        self.line.verify_read_back("o?", 1)
        self.look()
        return self.line.query_float("cc?") * 1e-3

    def _error(self) -> tuple[int, str]:
        answer = self.line.ask("e?")
        if (match := _ERROR.fullmatch(answer)) is None:
            raise self.line.reply_error("answer e? with a code and its meaning", repr(answer))
        return int(match[1]), f"error {match[1]}: {match[2].strip()}"


def _milliamperes(current_a: float) -> int:
    milliamperes = current_a / STEP_A
    if not (
        math.isfinite(milliamperes)
        and milliamperes >= 0
        and abs(milliamperes - round(milliamperes)) < 1e-6
    ):
        raise BadInput(
            f"the current of the light must be a multiple of {STEP_A:g} A, got {current_a:g}"
        )
    return round(milliamperes)


MODEL = InstrumentModel(
    name="dc2100",
    role="light-source",
    title="light source",
    line=lambda port, address: FramedLine(
        port, name="light source", command_end=b"\r\n", known=KNOWN
    ),
    driver=LightSource,
    baud=115200,
)
