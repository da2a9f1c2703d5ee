"""The line to a GPIB instrument behind a Prologix GPIB-USB adapter."""

from drivers.serial_lines.line import FramedLine, KnownAnswer
from drivers.serial_lines.port import ANSWER_S, Port

READ_TIMEOUT_MS = 200
SETTINGS = ("savecfg 0", "auto 0", "mode 1", "eoi 1", "eos 2", f"read_tmo_ms {READ_TIMEOUT_MS}")
ADAPTER_ANSWER = KnownAnswer(question="++ver", form=r"(?i).*ver.*")
_ESCAPED = "\x1b+\r\n"


class PrologixLine(FramedLine):
    """Commands to one address on the bus; answers are asked for, never taken by themselves.

    Parameters
    ----------
    port, name, answer_s
        See `InstrumentLine`.
    address
        GPIB address of the instrument, 0 to 30.
    """

    def __init__(self, port: Port, *, name: str, address: int, answer_s: float = ANSWER_S) -> None:
        super().__init__(port, name=name, answer_end=b"\n", answer_s=answer_s, known=ADAPTER_ANSWER)
        self._address = f"++addr {address}"
        self._is_set_up = False

    def write(self, command: str) -> None:
        with self._turn:
            self._set_up()
            self._say(_escape(command))

    def reopen(self) -> None:
        with self._turn:
            self._is_set_up = False
            super().reopen()

    def _order(self, command: str) -> None:
        # No set-up first: after a crash another process has the adapter set up, and the order must not wait.
        self._say(self._address, _escape(command))

    def _exchange(self, question: str) -> str:
        self._say(_escape(question), "++read eoi")
        return self._until(self._end, question).strip()

    def _get_into_step(self) -> None:
        """Have the adapter answer, set it up, and read its address back; another adapter is InstrumentReplyError."""
        super()._get_into_step()
        self._is_set_up = False
        self._set_up()
        self._say("++addr")
        if (address := self._until(self._end, "++addr").strip()) != self._address.split()[1]:
            raise self.reply_error(f"keep the address {self._address.split()[1]}", repr(address))

    def _set_up(self) -> None:
        if not self._is_set_up:
            self._say(*(f"++{setting}" for setting in SETTINGS), self._address)
            self._is_set_up = True


def _escape(command: str) -> str:
    return "".join(f"\x1b{character}" if character in _ESCAPED else character for character in command)
