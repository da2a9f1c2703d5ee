"""The line to a Thorlabs filter wheel: it echoes what it hears, answers, and then prompts without a line end."""

import threading

from drivers.answers import confused, refused
from drivers.errors import BenchError
from drivers.incoming import Incoming
from drivers.port import Port

PROMPT = b"> "
END = "\r"

# The prompt after a command that turns the wheel comes when the wheel stands (recalled).
TURN_S = 4.0


class PromptLine:
    """Commands and answers over a line that echoes and prompts.

    Parameters
    ----------
    port
        The port.
    name
        Name of the instrument.
    answer_s
        Time until the prompt, s.
    """

    def __init__(self, port: Port, *, name: str, answer_s: float = TURN_S) -> None:
        self.name = name
        self.hurry = threading.Event()
        self._port = port
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
        """End what may be half said and throw away what comes, then have one known exchange."""
        self._port.send(END.encode())
        self._incoming.drain()
        self._out_of_step = False
        self._exchange("*idn?")

    def _exchange(self, command: str) -> str:
        self._port.send((command + END).encode("ascii"))
        said = self._incoming.until(PROMPT, command)
        echo, mark, answer = said.partition(END)
        if echo != command or not mark:
            raise confused(self, f"echo {command!r}", repr(said[:80]))
        return answer.strip()
