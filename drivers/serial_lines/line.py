"""Request-reply lines to instruments, each wait bounded, with priority for the safe action."""

import math
import re
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from drivers.errors import (
    BenchError,
    BenchStopped,
    InstrumentRejected,
    InstrumentReplyError,
    InstrumentTimeout,
)
from drivers.serial_lines.port import ANSWER_S, SLICE_S, Port

LONGEST_ANSWER = 4096  # Largest reply without terminator, bytes
LONGEST_QUOTE = 100  # Largest part of a reply quoted in a message, characters


class _Caller(threading.local):
    """Whether the calling thread belongs to the safe action."""

    is_safing = False


@dataclass(frozen=True, kw_only=True)
class KnownAnswer:
    """A query without side effect and with a unique reply, for resynchronisation."""

    question: str
    form: str


IDENTITY_ANSWER = KnownAnswer(question="*IDN?", form=r"[^,]+,[^,]+,[^,]+,[^,]+")


class InstrumentLine(ABC):
    """A line to one instrument; its construction does no input or output.

    Exchanges of different threads do not overlap. Between `take_over` and `release` only threads
    within `safing` can send or wait; others get `BenchStopped`. `answer_s` is the time limit of a
    reply, s.
    """

    def __init__(self, port: Port, *, name: str, answer_s: float = ANSWER_S) -> None:
        self.name = name
        self._port, self._answer_s = port, answer_s
        self._received = b""
        self._in_step = False  # an earlier program may have left a reply pending
        self._turn = threading.RLock()
        # Returns the time by which an answer may come later on a busy machine, s
        self.slack_s: Callable[[], float] = lambda: 0.0
        self._taken_over = threading.Event()
        self._caller = _Caller()

    @abstractmethod
    def write(self, command: str) -> None:
        """Send a command without reply."""

    def ask(self, question: str) -> str:
        """Send a query and return its reply without terminators.

        After a time-out, which is InstrumentTimeout, the line is resynchronised before the next
        query: it discards late replies and sends a query whose reply has a known form.
        """
        with self._turn:
            try:
                if not self._in_step:
                    self._get_into_step()
                    self._in_step = True
                return self._exchange(question)
            except BenchError:
                self._in_step = False
                raise

    def query_float(self, question: str) -> float:
        """Send a query and return its reply as a finite number, else InstrumentReplyError."""
        return self.parse_float(self.ask(question), question)

    def query_int(self, question: str) -> int:
        """Send a query and return its reply as an integer, else InstrumentReplyError."""
        value = self.query_float(question)
        if value != round(value):
            raise self.reply_error(f"answer {question} with a whole number", f"{value:g}")
        return round(value)

    def parse_float(self, answer: str, question: str) -> float:
        """Return a reply as a finite number, else InstrumentReplyError."""
        try:
            value = float(answer)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.reply_error(f"answer {question} with a number", repr(answer))
        return value

    def verify_read_back(self, question: str, value: float, *, tolerance: float = 0.0) -> str:
        """Query a setting and return the reply; InstrumentRejected if it differs from the set
        value.
        """
        answer = self.ask(question)
        if abs((read := self.parse_float(answer, question)) - value) > tolerance:
            raise self.rejection(f"answer {question} with {value:g} as set", f"{read:g}")
        return answer

    def reply_error(self, rule: str, got: str) -> InstrumentReplyError:
        """Return the error of a reply of unexpected form."""
        return InstrumentReplyError.of(self.name, rule, got[:LONGEST_QUOTE])

    def rejection(self, rule: str, got: str, *, code: int | None = None) -> InstrumentRejected:
        """Return the error of an instrument that did not obey."""
        return InstrumentRejected.of(self.name, rule, got[:LONGEST_QUOTE], code=code)

    def order(self, command: str) -> None:
        """Send a command in any state of the line, without waiting for a reply."""
        with self._turn:
            self._in_step = False
            self._order(command)

    def take_over(self) -> None:
        """Restrict the line to the safe action, and end the waits of other threads at once."""
        self._taken_over.set()

    def release(self) -> None:
        """Open the line to all threads again."""
        self._taken_over.clear()

    @contextmanager
    def safing(self) -> Iterator[None]:
        """Let the calling thread use a line that was taken over."""
        before, self._caller.is_safing = self._caller.is_safing, True
        try:
            yield
        finally:
            self._caller.is_safing = before

    @property
    def path(self) -> str | None:
        """Path of the port; None without one."""
        return getattr(self._port, "path", None)

    def reopen(self, path: str | None = None) -> None:
        """Reopen the port, or another path in its place, and discard pending input;
        InstrumentDisconnected if it is missing.
        """
        with self._turn:
            self._in_step, self._received = False, b""
            self._port.reopen(path)

    def fileno(self) -> int:
        """File descriptor of the open port, passed to the client for the safe action."""
        return self._port.fileno()

    def close(self) -> None:
        """Close the port."""
        with self._turn:
            self._port.close()

    @abstractmethod
    def _get_into_step(self) -> None:
        """Resynchronise: discard late input until a query with a known reply is answered."""

    @abstractmethod
    def _exchange(self, question: str) -> str:
        """Send a query on a synchronised line and return its reply."""

    @abstractmethod
    def _order(self, command: str) -> None:
        """Send a command on a line of unknown state."""

    def _require_turn(self) -> None:
        if self._taken_over.is_set() and not self._caller.is_safing:
            raise BenchStopped.of(
                self.name, "obey the safe action alone", "a command of another thread"
            )

    def _send(self, data: bytes) -> None:
        self._require_turn()
        self._port.send(data)

    def _until(self, end: bytes, question: str, *, within_s: float | None = None) -> str:
        """Return the text up to a terminator; by default within the time limit of a reply."""
        within_s = (self._answer_s if within_s is None else within_s) + self.slack_s()
        deadline_s = time.monotonic() + within_s
        while end not in self._received:
            self._require_turn()
            left_s = deadline_s - time.monotonic()
            # The last look is after the deadline: this thread may have slept through it.
            self._received += (came := self._port.receive(max(0.0, min(left_s, SLICE_S))))
            if left_s <= 0 and not came:
                partial = f"only {self._received[:80]!r}" if self._received else "nothing"
                raise InstrumentTimeout.of(
                    self.name, f"answer {question} within {within_s:.2g} s", partial
                )
            if len(self._received) > LONGEST_ANSWER and end not in self._received:
                began, self._received = self._received[:40], b""
                rule = f"end its answer to {question} within {LONGEST_ANSWER} bytes"
                raise self.reply_error(rule, f"more that begin {began!r}")
        piece, self._received = self._received.split(end, 1)
        return piece.decode("ascii", "replace")

    def _await_known(self, end: bytes, known: KnownAnswer) -> None:
        """Skip late replies until the one to the last query."""
        deadline_s = time.monotonic() + self._answer_s
        while not re.fullmatch(known.form, answer := self._until(end, known.question).strip()):
            if time.monotonic() > deadline_s:
                raise InstrumentTimeout.of(
                    self.name, f"answer {known.question} in a known form", repr(answer[:80])
                )

    def _drain(self, *, quiet_s: float = 0.05, within_s: float | None = None) -> None:
        """Discard input until the line is quiet for a time or the time limit is over."""
        now_s = heard_s = time.monotonic()
        deadline_s = now_s + (self._answer_s if within_s is None else within_s)
        self._received = b""
        while now_s < deadline_s and now_s - heard_s < quiet_s:
            self._require_turn()
            came = self._port.receive(SLICE_S)
            now_s = time.monotonic()
            heard_s = now_s if came else heard_s


class FramedLine(InstrumentLine):
    """Line with commands and replies of one text line each; `known` is the query for
    resynchronisation.
    """

    def __init__(
        self,
        port: Port,
        *,
        name: str,
        answer_end: bytes = b"\r\n",
        command_end: bytes = b"\n",
        answer_s: float = ANSWER_S,
        known: KnownAnswer = IDENTITY_ANSWER,
    ) -> None:
        super().__init__(port, name=name, answer_s=answer_s)
        self._end, self._command_end, self._known = answer_end, command_end, known

    def write(self, command: str) -> None:
        with self._turn:
            self._say(command)

    def _say(self, *commands: str) -> None:
        self._send(b"".join(command.encode("ascii") + self._command_end for command in commands))

    def _order(self, command: str) -> None:
        self._say(command)

    def _exchange(self, question: str) -> str:
        self._say(question)
        return self._until(self._end, question).strip()

    def _get_into_step(self) -> None:
        self._drain()
        self._say(self._known.question)
        self._await_known(self._end, self._known)


class EchoCheckedLine(InstrumentLine):
    """Line with echo: each exchange is compared with its echo.

    A wrong echo is InstrumentReplyError, an error reply of the unit InstrumentRejected.
    """

    def write(self, command: str) -> None:
        """Send a setting without reply beyond its echo; any other reply is InstrumentRejected."""
        if answer := self.ask(command):
            raise self.rejection(f"accept {command!r} in silence", repr(answer))

    def ask(self, question: str) -> str:
        answer = super().ask(question)
        if meaning := self._refusal(answer):
            raise self.rejection(f"accept {question!r}", meaning)
        return answer

    @abstractmethod
    def _refusal(self, answer: str) -> str | None:
        """Return the meaning of an error reply; None for any other."""


READ_TIMEOUT_MS = 200
SETTINGS = ("savecfg 0", "auto 0", "mode 1", "eoi 1", "eos 2", f"read_tmo_ms {READ_TIMEOUT_MS}")
ADAPTER_ANSWER = KnownAnswer(question="++ver", form=r"(?i).*ver.*")
_ESCAPED = "\x1b+\r\n"


class PrologixLine(FramedLine):
    """Line to one GPIB address, 0 to 30, behind a Prologix GPIB-USB adapter; replies are read on
    request only.
    """

    def __init__(self, port: Port, *, name: str, address: int, answer_s: float = ANSWER_S) -> None:
        super().__init__(port, name=name, answer_end=b"\n", answer_s=answer_s, known=ADAPTER_ANSWER)
        self._address = f"++addr {address}"
        self._is_set_up = False

    def write(self, command: str) -> None:
        with self._turn:
            self._set_up()
            self._say(_escape(command))

    def reopen(self, path: str | None = None) -> None:
        with self._turn:
            self._is_set_up = False
            super().reopen(path)

    def _order(self, command: str) -> None:
        # Without set-up: after a crash another process has set the adapter up, and the command must
        # not wait.
        self._say(self._address, _escape(command))

    def _exchange(self, question: str) -> str:
        self._say(_escape(question), "++read eoi")
        return self._until(self._end, question).strip()

    def _get_into_step(self) -> None:
        """Query and set up the adapter, and read its address back; another adapter is
        InstrumentReplyError.
        """
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
    return "".join(
        f"\x1b{character}" if character in _ESCAPED else character for character in command
    )
