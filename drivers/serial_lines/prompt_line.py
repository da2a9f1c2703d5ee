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
    """Commands and answers of a filter wheel, each ended by a prompt; its parameters are those of `EchoCheckedLine`."""

    def order(self, command: str) -> None:
        """Send a command that must go out, whatever became of the exchange before."""
        with self._owner:
            self._out_of_step = True
            self._port.send((END + command + END).encode("ascii"))

    def get_into_step(self) -> None:
        """End what may be half said and throw away what is late, until the unit echoes a known question."""
        self._port.send(END.encode())
        self._incoming.drain()
        self._port.send((KNOWN + END).encode("ascii"))
        deadline_s = time.monotonic() + self._answer_s
        while not (said := self._incoming.until(PROMPT, KNOWN)).startswith(KNOWN + END):
            if time.monotonic() > deadline_s:
                raise reply_error(self, f"echo {KNOWN!r}", repr(said[:80]))
        self._out_of_step = False

    def _exchange(self, command: str) -> str:
        self._port.send((command + END).encode("ascii"))
        within_s = TURN_S if command.startswith(TURNING) else None
        said = self._incoming.until(PROMPT, command, within_s=within_s)
        echo, mark, answer = said.partition(END)
        if echo != command or not mark:
            raise reply_error(self, f"echo {command!r}", repr(said[:80]))
        return answer.strip()

    def _refusal(self, answer: str) -> str | None:
        return answer[:80] if answer.startswith("Command error") else None
