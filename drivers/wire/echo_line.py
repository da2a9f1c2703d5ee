"""The line to an iseg supply: it echoes what it hears, and each exchange is two lines, the echo and then the answer."""

import re
import threading
import time

from drivers.errors import BenchError, InstrumentSilent
from drivers.wire.answers import confused, refused
from drivers.wire.incoming import Incoming
from drivers.wire.port import ANSWER_S, Port

END = b"\r\n"
IDENTITY = r"\d+;[\w.]+;\d+V;\d+(\.\d+)?[um]A"

# Until it is told otherwise, the unit waits about 255 ms after each character that it sends.
SLOWEST_CHARACTER_S = 0.5
QUICK = "W=1"
SLOW_START_S = 4.0

REFUSALS = (
    (r"\?\?\?\?", "it does not understand"),
    (r"\?WCN", "it has no such channel"),
    (r"\?TOT", "the command was not over in time, and it starts anew"),
    (r"\? ?UMAX=.*", "beyond its limit"),
)


class EchoLine:
    """Commands and answers over a line that echoes.

    Whoever takes the echo for the answer is one exchange behind for ever, so the echo is compared every time.

    Parameters
    ----------
    port
        The port.
    name
        Name of the instrument.
    answer_s
        Time that echo and answer may each take, s.

    Raises
    ------
    InstrumentSilent
        If nothing on the port gets into step.
    """

    def __init__(self, port: Port, *, name: str, answer_s: float = ANSWER_S) -> None:
        self.name = name
        self.hurry = threading.Event()
        self._port, self._answer_s = port, answer_s
        self._incoming = Incoming(port, name=name, hurry=self.hurry, answer_s=answer_s)
        self._out_of_step = True
        self._owner = threading.RLock()

    def write(self, command: str) -> None:
        """Send a setting, which is answered by an empty line; another answer is InstrumentRefused."""
        if answer := self.ask(command):
            raise refused(self, f"accept {command!r} in silence", repr(answer))

    def ask(self, question: str) -> str:
        """Send a question and return the line after its echo.

        Raises
        ------
        InstrumentSilent
            If echo or answer do not come in time; the next exchange gets into step first.
        InstrumentConfused
            If the echo is of another command.
        InstrumentRefused
            If the unit answers with one of its errors.
        """
        with self._owner:
            if self._out_of_step:
                self.get_into_step()
            try:
                answer = self._exchange(question)
            except BenchError:
                self._out_of_step = True
                raise
        for form, meaning in REFUSALS:
            if re.fullmatch(form, answer):
                raise refused(self, f"accept {question!r}", f"{answer}: {meaning}")
        return answer

    def order(self, command: str) -> None:
        """Send a command that must go out; an empty line before it ends what another may have left half said."""
        with self._owner:
            self._out_of_step = True
            self._port.send(END + command.encode("ascii") + END)
            self._incoming.drain()  # it takes the next command when it has echoed this one

    def close(self) -> None:
        """Let go of the port."""
        self._port.close()

    def get_into_step(self) -> None:
        """Have the unit answer quickly, throw away what is late, and wait until it says who it is."""
        self._port.send(END + QUICK.encode() + END)
        self._incoming.drain(quiet_s=SLOWEST_CHARACTER_S, within_s=SLOW_START_S)
        self._port.send(b"#" + END)
        deadline_s = time.monotonic() + self._answer_s
        while not re.fullmatch(IDENTITY, answer := self._incoming.until(END, "#")):
            if time.monotonic() > deadline_s:
                raise InstrumentSilent(
                    f"the {self.name} must answer # in a known form, got {answer[:80]!r}", instrument=self.name
                )
        self._out_of_step = False

    def _exchange(self, command: str) -> str:
        self._port.send(command.encode("ascii") + END)
        echo = self._incoming.until(END, f"the echo of {command}")
        if echo != command:
            raise confused(self, f"echo {command!r}", repr(echo[:80]))
        return self._incoming.until(END, command).strip()
