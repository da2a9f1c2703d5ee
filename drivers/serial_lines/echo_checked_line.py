"""Lines to instruments that echo: each exchange is compared with its echo, or begun anew."""

from abc import abstractmethod

from drivers.serial_lines.line import InstrumentLine
from drivers.serial_lines.replies import rejected_error


class EchoCheckedLine(InstrumentLine):
    """Commands and answers over a line that echoes; its parameters are those of `InstrumentLine`."""

    def write(self, command: str) -> None:
        """Send a setting, which has no answer beyond its echo; one that comes is InstrumentRejected."""
        if answer := self.ask(command):
            raise rejected_error(self, f"accept {command!r} in silence", repr(answer))

    def ask(self, question: str) -> str:
        """Send a question and return its answer; one that is an error of the unit is InstrumentRejected.

        An echo of another command is InstrumentReplyError; for the other errors see `InstrumentLine.ask`.
        """
        answer = super().ask(question)
        if meaning := self._refusal(answer):
            raise rejected_error(self, f"accept {question!r}", meaning)
        return answer

    @abstractmethod
    def _refusal(self, answer: str) -> str | None:
        """Return what an answer says is wrong; None where it is no error."""
