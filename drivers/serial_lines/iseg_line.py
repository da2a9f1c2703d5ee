"""The line to an iseg supply: it echoes what it hears, and each exchange is two lines, the echo and then the answer."""

import re
import time

from drivers.errors import InstrumentTimeout
from drivers.serial_lines.echo_checked_line import EchoCheckedLine
from drivers.serial_lines.replies import reply_error

END = b"\r\n"
IDENTITY = r"\d+;[\w.]+;\d+V;\d+(\.\d+)?[um]A"

# Until it is told otherwise, the unit waits about 255 ms after each character that it sends.
SLOWEST_CHARACTER_S = 0.5
QUICK = "W=1"
SLOW_START_S = 6.0  # the echo and answer of one question and the echo of QUICK: 22 characters

REFUSALS = (
    (r"\?\?\?\?", "it does not understand"),
    (r"\?WCN", "it has no such channel"),
    (r"\?TOT", "the command was not over in time, and it starts anew"),
    (r"\? ?UMAX=.*", "beyond its limit"),
)


class IsegLine(EchoCheckedLine):
    """Commands and answers of an iseg supply, two lines an exchange; its parameters are those of `InstrumentLine`.

    Whoever takes the echo for the answer is one exchange behind for ever, so the echo is compared every time.
    """

    def _order(self, command: str) -> None:
        # The empty line before it ends what another program may have left half said.
        self._send(END + command.encode("ascii") + END)
        self._drain()  # it takes the next command when it has echoed this one

    def _get_into_step(self) -> None:
        """Have the unit answer quickly, throw away what is late, and wait until it says who it is."""
        self._send(END + QUICK.encode() + END)
        self._drain(quiet_s=SLOWEST_CHARACTER_S, within_s=SLOW_START_S)
        self._send(b"#" + END)
        deadline_s = time.monotonic() + self._answer_s
        while not re.fullmatch(IDENTITY, answer := self._until(END, "#")):
            if time.monotonic() > deadline_s:
                raise InstrumentTimeout(
                    f"the {self.name} must answer # in a known form, got {answer[:80]!r}", instrument=self.name
                )

    def _exchange(self, question: str) -> str:
        self._send(question.encode("ascii") + END)
        echo = self._until(END, f"the echo of {question}")
        if echo != question:
            raise reply_error(self, f"echo {question!r}", repr(echo[:80]))
        return self._until(END, question).strip()

    def _refusal(self, answer: str) -> str | None:
        meanings = (meaning for form, meaning in REFUSALS if re.fullmatch(form, answer))
        return next((f"{answer}: {meaning}" for meaning in meanings), None)
