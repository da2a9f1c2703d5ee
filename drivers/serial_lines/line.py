"""Lines to instruments: one command out, one whole answer back, each wait bounded."""

import re
import threading
import time
from dataclasses import dataclass
from typing import Protocol

from drivers.errors import BenchError, InstrumentTimeout
from drivers.serial_lines.port import ANSWER_S, Port
from drivers.serial_lines.receive_buffer import Incoming


class InstrumentLine(Protocol):
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

    def order(self, command: str) -> None:
        """Send a command that must go out, whatever became of the exchange before; its answer is not waited for."""
        ...

    def close(self) -> None:
        """Let go of the port."""
        ...


class LocalLine(InstrumentLine, Protocol):
    """A line on a port of this process."""

    @property
    def hurry(self) -> threading.Event:
        """Set: every wait on the line gives up at once."""
        ...


@dataclass(frozen=True, kw_only=True)
class KnownAnswer:
    """A question without side effect whose answer no other answer resembles: the way back into step."""

    question: str
    form: str


IDENTITY_ANSWER = KnownAnswer(question="*IDN?", form=r"[^,]+,[^,]+,[^,]+,[^,]+")
ADAPTER_ANSWER = KnownAnswer(question="++ver", form=r"(?i).*ver.*")


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
    command_end
        Terminator of commands.
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
        command_end: bytes = b"\n",
        answer_s: float = ANSWER_S,
        known: KnownAnswer = IDENTITY_ANSWER,
    ) -> None:
        self.name = name
        self.hurry = threading.Event()
        """Set: give up waiting at once, because the bench is being made safe."""
        self._port, self._end, self._command_end = port, answer_end, command_end
        self._answer_s, self._known = answer_s, known
        self._incoming = Incoming(port, name=name, hurry=self.hurry, answer_s=answer_s)
        self._out_of_step = True  # whoever held the port before may have left an answer due
        self._owner = threading.RLock()

    def write(self, command: str) -> None:
        """Send a command that has no answer."""
        with self._owner:
            self._port.send(command.encode("ascii") + self._command_end)

    def order(self, command: str) -> None:
        """Send a command that must go out, and mistrust what came before: the next question gets into step first."""
        with self._owner:
            self._out_of_step = True
            self.write(command)

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
        InstrumentTimeout
            If no whole answer came in time. The line is then out of step: before the next question, late answers
            are thrown away and a question whose answer has a known form is put.
        InstrumentDisconnected
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
        try:
            return self._incoming.until(self._end, question).strip()
        except BenchError:
            self._out_of_step = True
            raise

    def _get_into_step(self) -> None:
        self._incoming.drain()
        self._out_of_step = False
        self.write(self._known.question)
        deadline_s = time.monotonic() + self._answer_s
        while not re.fullmatch(self._known.form, answer := self._answer(self._known.question)):
            if time.monotonic() > deadline_s:
                self._out_of_step = True
                raise InstrumentTimeout(
                    f"the {self.name} must answer {self._known.question} in a known form, got {answer[:80]!r}",
                    instrument=self.name,
                )
