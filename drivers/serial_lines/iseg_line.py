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
SLOW_START_S = 4.0

REFUSALS = (
    (r"\?\?\?\?", "it does not understand"),
    (r"\?WCN", "it has no such channel"),
    (r"\?TOT", "the command was not over in time, and it starts anew"),
    (r"\? ?UMAX=.*", "beyond its limit"),
)


class IsegLine(EchoCheckedLine):
    """Commands and answers of an iseg supply, two lines an exchange; its parameters are those of `EchoCheckedLine`.

    Whoever takes the echo for the answer is one exchange behind for ever, so the echo is compared every time.
    """

    def order(self, command: str) -> None:
        """Send a command that must go out; an empty line before it ends what another may have left half said."""
        with self._owner:
            self._out_of_step = True
            self._port.send(END + command.encode("ascii") + END)
            self._incoming.drain()  # it takes the next command when it has echoed this one

    def get_into_step(self) -> None:
        """Have the unit answer quickly, throw away what is late, and wait until it says who it is."""
        self._port.send(END + QUICK.encode() + END)
        self._incoming.drain(quiet_s=SLOWEST_CHARACTER_S, within_s=SLOW_START_S)
        self._port.send(b"#" + END)
        deadline_s = time.monotonic() + self._answer_s
        while not re.fullmatch(IDENTITY, answer := self._incoming.until(END, "#")):
            if time.monotonic() > deadline_s:
                raise InstrumentTimeout(
                    f"the {self.name} must answer # in a known form, got {answer[:80]!r}", instrument=self.name
                )
        self._out_of_step = False

    def _exchange(self, command: str) -> str:
        self._port.send(command.encode("ascii") + END)
        echo = self._incoming.until(END, f"the echo of {command}")
        if echo != command:
            raise reply_error(self, f"echo {command!r}", repr(echo[:80]))
        return self._incoming.until(END, command).strip()

    def _refusal(self, answer: str) -> str | None:
        meanings = (meaning for form, meaning in REFUSALS if re.fullmatch(form, answer))
        return next((f"{answer}: {meaning}" for meaning in meanings), None)
