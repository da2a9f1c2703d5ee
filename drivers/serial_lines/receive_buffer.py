"""What comes in over a port: pieces cut at terminators, each waited for no longer than allowed."""

import threading
import time

from drivers.errors import InstrumentReplyError, InstrumentTimeout
from drivers.serial_lines.port import ANSWER_S, SLICE_S, Port

LONGEST_ANSWER = 4096
"""Bytes after which an answer without an end is no answer."""

QUIET_S = 0.05


class Incoming:
    """Bytes of one port, kept until they are taken.

    Parameters
    ----------
    port
        The port.
    name
        Name of the instrument, for sentences.
    hurry
        Set: every wait gives up at once.
    answer_s
        Time that an answer may take, s.
    """

    def __init__(self, port: Port, *, name: str, hurry: threading.Event, answer_s: float = ANSWER_S) -> None:
        self._port, self._name, self._hurry, self._answer_s = port, name, hurry, answer_s
        self._kept = b""

    def until(self, end: bytes, question: str, *, within_s: float | None = None) -> str:
        """Return the text up to a terminator, which is taken off.

        Parameters
        ----------
        end
            The terminator.
        question
            What was asked, for sentences.
        within_s
            Time allowed, s; by default the answer time.

        Raises
        ------
        InstrumentTimeout
            If it does not come in time.
        InstrumentReplyError
            If far more comes than any answer has.
        """
        within_s = self._answer_s if within_s is None else within_s
        deadline_s = time.monotonic() + within_s
        while end not in self._kept:
            left_s = deadline_s - time.monotonic()
            if left_s <= 0 or self._hurry.is_set():
                partial = f"only {self._kept[:80]!r}" if self._kept else "nothing"
                raise InstrumentTimeout(
                    f"the {self._name} must answer {question} within {within_s:g} s, got {partial}",
                    instrument=self._name,
                )
            self._kept += self._port.receive(min(left_s, SLICE_S))
            if len(self._kept) > LONGEST_ANSWER and end not in self._kept:
                began, self._kept = self._kept[:40], b""
                raise InstrumentReplyError(
                    f"the {self._name} must end its answer to {question} within {LONGEST_ANSWER} bytes, "
                    f"got more that begin {began!r}",
                    instrument=self._name,
                )
        piece, self._kept = self._kept.split(end, 1)
        return piece.decode("ascii", "replace")

    def drain(self, *, quiet_s: float = QUIET_S, within_s: float | None = None) -> None:
        """Throw away what came, until the line is quiet for a time or the time allowed is over."""
        deadline_s = time.monotonic() + (self._answer_s if within_s is None else within_s)
        self._kept = b""
        while time.monotonic() < deadline_s and not self._hurry.is_set() and self._port.receive(quiet_s):
            pass
