"""The only place with serial bytes: one command out, one whole answer back, each wait bounded."""

import contextlib
import re
import termios
import threading
import time
from dataclasses import dataclass
from typing import Protocol

import serial

from drivers.errors import InstrumentLost, InstrumentSilent

ANSWER_S = 0.4
"""Time that an answer may take, s; the bound on everything that must happen within a second."""

QUIET_S = 0.05
SLICE_S = 0.02
_PORT_ERRORS = (serial.SerialException, OSError, termios.error)


class Line(Protocol):
    """A line to one instrument."""

    @property
    def name(self) -> str:
        """Name of the instrument at the other end."""
        ...

    def write(self, command: str) -> None:
        """Send a command that has no answer."""
        ...

    def ask(self, question: str) -> str:
        """Send a question and return its answer without terminators."""
        ...

    def close(self) -> None:
        """Let go of the port."""
        ...


class OwnedLine(Line, Protocol):
    """A line on a port of this process."""

    @property
    def hurry(self) -> threading.Event:
        """Set: every wait on the line gives up at once."""
        ...


class Port(Protocol):
    """Where bytes go out and come in."""

    def send(self, data: bytes) -> None:
        """Send bytes."""
        ...

    def receive(self, timeout_s: float) -> bytes:
        """Bytes that came, waiting at most `timeout_s` for the first; empty if none did."""
        ...

    def close(self) -> None:
        """Let go of the port."""
        ...


class SerialPort:
    """A serial port that nobody else can open meanwhile.

    Parameters
    ----------
    port
        Path of the device.
    name
        Name of the instrument, for sentences.
    baud
        Rate, baud.
    hardware_handshake
        RTS/CTS.

    Raises
    ------
    InstrumentLost
        If the port cannot be opened or goes away; pyserial says so by three kinds of exception.
    """

    def __init__(self, port: str, *, name: str, baud: int = 9600, hardware_handshake: bool = False) -> None:
        self._path, self._name = port, name
        try:
            self._serial = serial.Serial(
                port, baud, timeout=SLICE_S, write_timeout=ANSWER_S, rtscts=hardware_handshake, exclusive=True
            )
        except (*_PORT_ERRORS, ValueError) as error:
            raise InstrumentLost(
                f"the port {port} of the {name} must be free to open, got: {_why_not_open(error)}", instrument=name
            ) from None

    def send(self, data: bytes) -> None:
        """Send bytes; a line that takes none within the answer time is silent."""
        try:
            self._serial.write(data)
        except serial.SerialTimeoutException:
            raise InstrumentSilent(
                f"the {self._name} must take a command within {ANSWER_S:g} s, got no room on {self._path}",
                instrument=self._name,
            ) from None
        except _PORT_ERRORS as error:
            raise self._lost(error) from None

    def receive(self, timeout_s: float) -> bytes:
        """Bytes that came, waiting at most `timeout_s` for the first."""
        try:
            self._serial.timeout = timeout_s
            first = self._serial.read(1)
            return first + self._serial.read(self._serial.in_waiting) if first else b""
        except _PORT_ERRORS as error:
            raise self._lost(error) from None

    def close(self) -> None:
        """Let go of the port, even one that is gone."""
        with contextlib.suppress(*_PORT_ERRORS):
            self._serial.close()

    def _lost(self, error: BaseException) -> InstrumentLost:
        return InstrumentLost(f"the {self._name} must stay on {self._path}, got: {error}", instrument=self._name)


@dataclass(frozen=True, kw_only=True)
class KnownAnswer:
    """A question without side effect whose answer no other answer resembles: the way back into step."""

    question: str
    form: str


IDENTITY_ANSWER = KnownAnswer(question="*IDN?", form=r"[^,]+,[^,]+,[^,]+,[^,]+")
ADAPTER_ANSWER = KnownAnswer(question="++ver", form=r"(?i).*ver.*")


def _why_not_open(error: BaseException) -> str:
    if "exclusively lock" in str(error):
        return (
            "another program holds it (the watchdog of a run that just ended follows the voltage down for some seconds)"
        )
    return str(error)


class FramedLine:
    """Commands and answers as whole lines over a port.

    Parameters
    ----------
    port
        The port.
    name
        Name of the instrument.
    answer_end
        Terminator of answers.
    answer_s
        Time that an answer may take, s.
    known
        How to get into step after an answer that came late.
    """

    def __init__(
        self,
        port: Port,
        *,
        name: str,
        answer_end: bytes = b"\r\n",
        answer_s: float = ANSWER_S,
        known: KnownAnswer = IDENTITY_ANSWER,
    ) -> None:
        self.name = name
        self.hurry = threading.Event()
        """Set: give up waiting at once, because the bench is being made safe."""
        self._port, self._end, self._answer_s, self._known = port, answer_end, answer_s, known
        self._kept, self._out_of_step = b"", False
        self._owner = threading.RLock()

    def write(self, command: str) -> None:
        """Send a command that has no answer."""
        with self._owner:
            self._port.send(command.encode("ascii") + b"\n")

    def ask(self, question: str, *, about: str = "") -> str:
        """Send a question and return its answer without terminator.

        Parameters
        ----------
        question
            The question.
        about
            What to call it in a sentence, where the line sends another text than the user asked.

        Raises
        ------
        InstrumentSilent
            If no whole answer came in time. The line is then out of step: before the next question, late answers
            are thrown away and a question whose answer has a known form is put.
        InstrumentLost
            If the port is gone.
        """
        with self._owner:
            if self._out_of_step:
                self._get_into_step()
            self.write(question)
            return self._answer(about or question)

    def close(self) -> None:
        """Let go of the port."""
        self._port.close()

    def _answer(self, question: str) -> str:
        deadline_s = time.monotonic() + self._answer_s
        while self._end not in self._kept:
            left_s = deadline_s - time.monotonic()
            if left_s <= 0 or self.hurry.is_set():
                self._out_of_step = True
                partial = f"only {self._kept!r}" if self._kept else "nothing"
                raise InstrumentSilent(
                    f"the {self.name} must answer {question} within {self._answer_s:g} s, got {partial}",
                    instrument=self.name,
                )
            self._kept += self._port.receive(min(left_s, SLICE_S))
        answer, self._kept = self._kept.split(self._end, 1)
        return answer.decode("ascii", "replace").strip()

    def _get_into_step(self) -> None:
        self._drain()
        self.write(self._known.question)
        deadline_s = time.monotonic() + self._answer_s
        while not re.fullmatch(self._known.form, answer := self._answer(self._known.question)):
            if time.monotonic() > deadline_s:
                self._out_of_step = True
                raise InstrumentSilent(
                    f"the {self.name} must answer {self._known.question} in a known form, got {answer!r}",
                    instrument=self.name,
                )

    def _drain(self) -> None:
        """Throw away what came late, until the line is quiet or the answer time is over."""
        deadline_s = time.monotonic() + self._answer_s
        self._kept = b""
        while time.monotonic() < deadline_s and self._port.receive(QUIET_S):
            pass
        self._out_of_step = False
