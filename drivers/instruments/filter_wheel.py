"""The filters: a Thorlabs FW102C wheel with six or twelve positions."""

from drivers.instruments.instrument import Instrument, InstrumentModel
from drivers.serial_lines.line import EchoCheckedLine, InstrumentLine, KnownAnswer
from labdata.errors import BadInput

SENSORS_OFF = "sensors=0"
"""The lamps of its own position sensors out while it stands: they would light the tube."""

PROMPT = b"> "
END = "\r"
KNOWN = KnownAnswer(question="*idn?", form=r"(?s)\*idn\?\r.*")

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
        self._send((KNOWN.question + END).encode("ascii"))
        self._await_known(PROMPT, KNOWN)

    def _exchange(self, question: str) -> str:
        self._send((question + END).encode("ascii"))
        said = self._until(PROMPT, question, within_s=TURN_S if question.startswith(TURNING) else None)
        echo, mark, answer = said.partition(END)
        if echo != question or not mark:
            raise self.reply_error(f"echo {question!r}", repr(said[:80]))
        return answer.strip()

    def _refusal(self, answer: str) -> str | None:
        return answer[:80] if answer.startswith("Command error") else None


class FilterWheel(Instrument):
    """The wheel."""

    def __init__(self, line: InstrumentLine) -> None:
        super().__init__(line)
        self._seen: int | None = None

    def identify(self) -> str:
        """Identify it, and have the wheel's own lamps out."""
        identity = self._identity(KNOWN.question, r"(?i).*FW(102|212).*", "an FW102C or FW212C")
        self.line.write(SENSORS_OFF)
        self.line.verify_read_back("sensors?", 0)
        return identity

    def look(self) -> None:
        """Ask where the wheel stands; if somebody has turned it since the first look, that is InstrumentRejected."""
        now = self.position()
        if self._seen not in (None, now):
            raise self.line.rejection(f"stay at {self._seen}", f"{now}: somebody turned it")
        self._seen = now

    @property
    def positions(self) -> int:
        """How many positions the wheel has."""
        return self.line.query_int("pcount?")

    def position(self) -> int:
        """Where the wheel stands, counted from 1; somebody may have turned it at its buttons."""
        return self.line.query_int("pos?")

    def turn_to(self, position: int) -> int:
        """Turn the wheel, wait until it stands, and return the position read back; one that it lacks is BadInput."""
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
