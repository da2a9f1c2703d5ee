"""The line to a Thorlabs filter wheel: it echoes what it hears, answers, and then prompts without a line end."""

import time

from drivers.serial_lines.echo_checked_line import EchoCheckedLine
from drivers.serial_lines.replies import reply_error

PROMPT = b"> "
END = "\r"
KNOWN = "*idn?"

# The prompt after a command that turns the wheel comes when the wheel stands (recalled).
TURNING, TURN_S = "pos=", 4.0


class PromptLine(EchoCheckedLine):
    """Commands and answers of a filter wheel, each ended by a prompt; its parameters are those of `InstrumentLine`."""

    def _order(self, command: str) -> None:
        self._send((END + command + END).encode("ascii"))

    def _get_into_step(self) -> None:
        """End what may be half said and throw away what is late, until the unit echoes a known question."""
        self._send(END.encode())
        self._drain()
        self._send((KNOWN + END).encode("ascii"))
        deadline_s = time.monotonic() + self._answer_s
        while not (said := self._until(PROMPT, KNOWN)).startswith(KNOWN + END):
            if time.monotonic() > deadline_s:
                raise reply_error(self, f"echo {KNOWN!r}", repr(said[:80]))

    def _exchange(self, question: str) -> str:
        self._send((question + END).encode("ascii"))
        said = self._until(PROMPT, question, within_s=TURN_S if question.startswith(TURNING) else None)
        echo, mark, answer = said.partition(END)
        if echo != question or not mark:
            raise reply_error(self, f"echo {question!r}", repr(said[:80]))
        return answer.strip()

    def _refusal(self, answer: str) -> str | None:
        return answer[:80] if answer.startswith("Command error") else None
