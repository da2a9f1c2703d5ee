"""What lines to instruments that echo have in common: each exchange is compared with its echo, or begun anew."""

import threading
from abc import ABC, abstractmethod

from drivers.errors import BenchError
from drivers.serial_lines.port import ANSWER_S, Port
from drivers.serial_lines.receive_buffer import Incoming
from drivers.serial_lines.replies import rejected_error


class EchoCheckedLine(ABC):
    """Commands and answers over a line that echoes.

    Parameters
    ----------
    port
        The port.
    name
        Name of the instrument.
    answer_s
        Time that an answer may take, s, where nothing has to move first.
    """

    def __init__(self, port: Port, *, name: str, answer_s: float = ANSWER_S) -> None:
        self.name = name
        self.hurry = threading.Event()
        self._port, self._answer_s = port, answer_s
        self._incoming = Incoming(port, name=name, hurry=self.hurry, answer_s=answer_s)
        self._out_of_step = True
        self._owner = threading.RLock()

    def write(self, command: str) -> None:
        """Send a setting, which has no answer beside its echo; one that comes is InstrumentRejected."""
        if answer := self.ask(command):
            raise rejected_error(self, f"accept {command!r} in silence", repr(answer))

    def ask(self, question: str) -> str:
        """Send a question and return its answer.

        Raises
        ------
        InstrumentTimeout
            If echo or answer do not come in time; the next exchange gets into step first.
        InstrumentReplyError
            If the echo is of another command.
        InstrumentRejected
            If the unit answers with one of its errors.
        """
        with self._owner:
            try:
                if self._out_of_step:
                    self.get_into_step()
                answer = self._exchange(question)
            except BenchError:
                self._out_of_step = True
                raise
        if meaning := self._refusal(answer):
            raise rejected_error(self, f"accept {question!r}", meaning)
        return answer

    def close(self) -> None:
        """Let go of the port."""
        self._port.close()

    @abstractmethod
    def order(self, command: str) -> None:
        """Send a command that must go out, whatever became of the exchange before."""

    @abstractmethod
    def get_into_step(self) -> None:
        """Throw away what is late, until the unit answers a known question."""

    @abstractmethod
    def _exchange(self, command: str) -> str:
        """Send one command, compare its echo, and return what else comes."""

    @abstractmethod
    def _refusal(self, answer: str) -> str | None:
        """Return what an answer says is wrong; None where it is no error."""
