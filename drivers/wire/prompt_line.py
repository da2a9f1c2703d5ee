"""The line to a Thorlabs filter wheel: it echoes what it hears, answers, and then prompts without a line end."""

import threading
import time

from drivers.errors import BenchError
from drivers.wire.answers import confused, refused
from drivers.wire.incoming import Incoming
from drivers.wire.port import ANSWER_S, Port

PROMPT = b"> "
END = "\r"
KNOWN = "*idn?"

# The prompt after a command that turns the wheel comes when the wheel stands (recalled).
TURNING, TURN_S = "pos=", 4.0


class PromptLine:
    """Commands and answers over a line that echoes and prompts.

    Parameters
    ----------
    port
        The port.
    name
        Name of the instrument.
    answer_s
        Time until the prompt, s, where the wheel need not turn.
    """

    def __init__(self, port: Port, *, name: str, answer_s: float = ANSWER_S) -> None:
        self.name = name
        self.hurry = threading.Event()
        self._port, self._answer_s = port, answer_s
        self._incoming = Incoming(port, name=name, hurry=self.hurry, answer_s=answer_s)
        self._out_of_step = True
        self._owner = threading.RLock()

    def write(self, command: str) -> None:
        """Send a setting and wait for the prompt; an answer before it is InstrumentRefused."""
        if answer := self.ask(command):
            raise refused(self, f"accept {command!r} in silence", repr(answer[:80]))

    def ask(self, question: str) -> str:
        """Send a question and return what stands between its echo and the prompt.

        Raises
        ------
        InstrumentSilent
            If the prompt does not come in time; the next exchange gets into step first.
        InstrumentConfused
            If the echo is of another command.
        InstrumentRefused
            If the unit answers with an error.
        """
        with self._owner:
            try:
                if self._out_of_step:
                    self._get_into_step()
                answer = self._exchange(question)
            except BenchError:
                self._out_of_step = True
                raise
        if answer.startswith("Command error"):
            raise refused(self, f"accept {question!r}", answer[:80])
        return answer

    def order(self, command: str) -> None:
        """Send a command that must go out, whatever became of the exchange before."""
        with self._owner:
            self._out_of_step = True
            self._port.send((END + command + END).encode("ascii"))

    def close(self) -> None:
        """Let go of the port."""
        self._port.close()

    def _get_into_step(self) -> None:
        """End what may be half said and throw away what is late, until the unit echoes a known question."""
        self._port.send(END.encode())
        self._incoming.drain()
        self._port.send((KNOWN + END).encode("ascii"))
        deadline_s = time.monotonic() + self._answer_s
        while not (said := self._incoming.until(PROMPT, KNOWN)).startswith(KNOWN + END):
            if time.monotonic() > deadline_s:
                raise confused(self, f"echo {KNOWN!r}", repr(said[:80]))
        self._out_of_step = False

    def _exchange(self, command: str) -> str:
        self._port.send((command + END).encode("ascii"))
        within_s = TURN_S if command.startswith(TURNING) else None
        said = self._incoming.until(PROMPT, command, within_s=within_s)
        echo, mark, answer = said.partition(END)
        if echo != command or not mark:
            raise confused(self, f"echo {command!r}", repr(said[:80]))
        return answer.strip()
