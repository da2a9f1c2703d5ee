"""The line to a GPIB instrument behind a Prologix GPIB-USB adapter."""

from drivers.errors import InstrumentReplyError
from drivers.serial_lines.line import FramedLine

READ_TIMEOUT_MS = 200
_ESCAPED = "\x1b+\r\n"


class PrologixLine:
    """Commands to one address on the bus; answers are asked for, never taken by themselves.

    Parameters
    ----------
    line
        Framed line to the adapter; answers end as the instrument ends them (line feed).
    address
        GPIB address of the instrument, 0 to 30.

    Raises
    ------
    InstrumentReplyError
        If what answers is no such adapter.
    """

    def __init__(self, line: FramedLine, *, address: int) -> None:
        self.name = line.name
        self.hurry = line.hurry
        self._line = line
        for setting in ("savecfg 0", "auto 0", "mode 1", "eoi 1", "eos 2", f"read_tmo_ms {READ_TIMEOUT_MS}"):
            line.write(f"++{setting}")
        line.write(f"++addr {address}")
        if (kept := line.ask("++addr")) != str(address):
            raise InstrumentReplyError(
                f"the adapter of the {self.name} must keep the address {address}, got {kept[:80]!r}",
                instrument=self.name,
            )

    def write(self, command: str) -> None:
        """Send a command that has no answer."""
        self._line.write(_escape(command))

    def order(self, command: str) -> None:
        """Send a command that must go out."""
        self._line.order(_escape(command))

    def ask(self, question: str) -> str:
        """Send a question, have the instrument talk, and return its answer without terminator."""
        self._line.write(_escape(question))
        return self._line.ask("++read eoi", about=question)

    def close(self) -> None:
        """Let go of the port."""
        self._line.close()


def _escape(command: str) -> str:
    return "".join(f"\x1b{character}" if character in _ESCAPED else character for character in command)
