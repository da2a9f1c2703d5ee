"""Filter wheel: Thorlabs FW102C with six or twelve positions."""

from drivers.instruments.instrument import Instrument, InstrumentModel
from drivers.serial_lines.line import EchoCheckedLine, InstrumentLine, KnownAnswer
from labdata.errors import BadInput

# Switch the lamps of the position sensors off while the wheel rests: they would illuminate the tube
SENSORS_OFF = "sensors=0"

PROMPT = b"> "
END = "\r"
KNOWN = KnownAnswer(question="*idn?", form=r"(?s)\*idn\?\r.*")

# The prompt after a turn command comes when the wheel has stopped (unverified).
TURNING, TURN_S = "pos=", 4.0


class PromptLine(EchoCheckedLine):
    """Line of a filter wheel, whose replies end with a prompt; parameters as for
    `InstrumentLine`.
    """

    def _order(self, command: str) -> None:
        self._send((END + command + END).encode("ascii"))

    def _get_into_step(self) -> None:
        """Resynchronise: end an incomplete command and discard input until a known query is
        echoed.
        """
        self._send(END.encode())
        self._drain()
        self._send((KNOWN.question + END).encode("ascii"))
        self._await_known(PROMPT, KNOWN)

    def _exchange(self, question: str) -> str:
        self._send((question + END).encode("ascii"))
        reply = self._until(
            PROMPT, question, within_s=TURN_S if question.startswith(TURNING) else None
        )
        echo, mark, answer = reply.partition(END)
        if echo != question or not mark:
            raise self.reply_error(f"echo {question!r}", repr(reply[:80]))
        return answer.strip()

    def _refusal(self, answer: str) -> str | None:
        return answer[:80] if answer.startswith("Command error") else None


class FilterWheel(Instrument):
    """Thorlabs FW102C or FW212C."""

    def __init__(self, line: InstrumentLine) -> None:
        super().__init__(line)
        self._seen: int | None = None

    def identify(self) -> str:
        """Return the identity, and switch the wheel's sensor lamps off."""
        identity = self._identity(KNOWN.question, r"(?i).*FW(102|212).*", "an FW102C or FW212C")
        self.line.write(SENSORS_OFF)
        self.line.verify_read_back("sensors?", 0)
        return identity

    def look(self) -> None:
        """Read the position; a turn by hand since the first reading is InstrumentRejected."""
        now = self.position()
        if self._seen not in (None, now):
            raise self.line.rejection(f"stay at {self._seen}", f"{now}: somebody turned it")
        self._seen = now

    @property
    def positions(self) -> int:
        """Number of positions of the wheel."""
        return self.line.query_int("pcount?")

    def position(self) -> int:
        """Return the position of the wheel, counted from 1."""
        return self.line.query_int("pos?")

    def turn_to(self, position: int) -> int:
        """Turn the wheel, wait for it, and return the read-back position; an invalid one is
        BadInput.
        """
        count = self.positions
        if not 1 <= position <= count:
            raise BadInput(f"the filter must be one of 1 to {count}, got {position}")
        self.line.write(f"pos={position}")
        if (reached := self.position()) != position:
            raise self.line.rejection(f"turn to {position}", f"{reached}")
        self._seen = reached
        return reached


MODEL = InstrumentModel(
    name="fw102c",
    role="filter-wheel",
    title="filter wheel",
    line=lambda port, address: PromptLine(port, name="filter wheel"),
    driver=FilterWheel,
    baud=115200,
)
