"""Lines to instruments: one command out, one complete answer back, each wait bounded, and the safe action first."""

import math
import re
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from drivers.errors import BenchError, BenchStopped, InstrumentRejected, InstrumentReplyError, InstrumentTimeout
from drivers.serial_lines.port import ANSWER_S, SLICE_S, Port

LONGEST_ANSWER = 4096
"""Bytes after which an answer without an end is no answer."""

LONGEST_QUOTE = 100
"""Characters of an answer that a sentence repeats."""

QUIET_S = 0.05


class _Caller(threading.local):
    """Whether the calling thread belongs to the safe action."""

    is_safing = False


@dataclass(frozen=True, kw_only=True)
class KnownAnswer:
    """A question without side effect whose answer no other answer resembles: the way back into step."""

    question: str
    form: str


IDENTITY_ANSWER = KnownAnswer(question="*IDN?", form=r"[^,]+,[^,]+,[^,]+,[^,]+")


class InstrumentLine(ABC):
    """A line to one instrument; making a line does no input or output.

    One exchange of a thread is over before another thread can send. Between `take_over` and `release` only threads
    within `safing` can send or wait; in all others `BenchStopped` is raised.

    Parameters
    ----------
    port
        The port.
    name
        Name of the instrument.
    answer_s
        Time that an answer may take, s.
    """

    def __init__(self, port: Port, *, name: str, answer_s: float = ANSWER_S) -> None:
        self.name = name
        self._port, self._answer_s = port, answer_s
        self._received = b""
        self._in_step = False  # a program that held the port before may have left an answer due
        self._turn = threading.RLock()
        self._taken_over = threading.Event()
        self._caller = _Caller()

    @abstractmethod
    def write(self, command: str) -> None:
        """Send a command that has no answer."""

    def ask(self, question: str) -> str:
        """Send a question and return its answer without terminators.

        Raises
        ------
        InstrumentTimeout
            If no complete answer comes in time. The line is then out of step: before the next question it throws away
            late answers and asks a question whose answer has a known form.
        InstrumentDisconnected
            If the port is gone.
        BenchStopped
            If the safe action has taken the line over.
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
        """Ask, and return the answer as a finite number; anything else is InstrumentReplyError."""
        return self.parse_float(self.ask(question), question)

    def query_int(self, question: str) -> int:
        """Ask, and return the answer as a whole number; anything else is InstrumentReplyError."""
        value = self.query_float(question)
        if value != round(value):
            raise self.reply_error(f"answer {question} with a whole number", f"{value:g}")
        return round(value)

    def parse_float(self, answer: str, question: str) -> float:
        """Return the answer to a question as a finite number; anything else is InstrumentReplyError."""
        try:
            value = float(answer)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.reply_error(f"answer {question} with a number", repr(answer))
        return value

    def verify_read_back(self, question: str, value: float, *, within: float = 0.0) -> str:
        """Ask for a setting and return the answer; one that is not as it was set is InstrumentRejected."""
        answer = self.ask(question)
        if abs((read := self.parse_float(answer, question)) - value) > within:
            raise self.rejection(f"answer {question} with {value:g} as set", f"{read:g}")
        return answer

    def reply_error(self, rule: str, got: str) -> InstrumentReplyError:
        """Return the error of an answer that is not of the form its question asks for."""
        return InstrumentReplyError.of(self.name, rule, got[:LONGEST_QUOTE])

    def rejection(self, rule: str, got: str, *, code: int | None = None) -> InstrumentRejected:
        """Return the error of an instrument that did not obey."""
        return InstrumentRejected.of(self.name, rule, got[:LONGEST_QUOTE], code=code)

    def order(self, command: str) -> None:
        """Send a command that must go out, whatever became of the exchange before; its answer is not waited for."""
        with self._turn:
            self._in_step = False
            self._order(command)

    def take_over(self) -> None:
        """Let only the safe action speak from here on, and have the waits of other threads end at once."""
        self._taken_over.set()

    def release(self) -> None:
        """Let every thread speak again."""
        self._taken_over.clear()

    @contextmanager
    def safing(self) -> Iterator[None]:
        """Let the calling thread speak on a line that was taken over."""
        before, self._caller.is_safing = self._caller.is_safing, True
        try:
            yield
        finally:
            self._caller.is_safing = before

    def reopen(self) -> None:
        """Open the port anew, and trust nothing that came before; InstrumentDisconnected where it is not there."""
        with self._turn:
            self._in_step, self._received = False, b""
            self._port.reopen()

    def fileno(self) -> int:
        """File descriptor of the open port, for the process that makes the tube safe when this one cannot."""
        return self._port.fileno()

    def close(self) -> None:
        """Close the port."""
        with self._turn:
            self._port.close()

    @abstractmethod
    def _get_into_step(self) -> None:
        """Throw away what is late, until the instrument answers a question whose answer has a known form."""

    @abstractmethod
    def _exchange(self, question: str) -> str:
        """Send a question on a line in step and return its answer."""

    @abstractmethod
    def _order(self, command: str) -> None:
        """Send a command on a line whose state is unknown."""

    def _require_turn(self) -> None:
        if self._taken_over.is_set() and not self._caller.is_safing:
            raise BenchStopped.of(self.name, "obey the safe action alone", "a command of another thread")

    def _send(self, data: bytes) -> None:
        self._require_turn()
        self._port.send(data)

    def _until(self, end: bytes, question: str, *, within_s: float | None = None) -> str:
        """Text up to a terminator, which is taken off; by default within the answer time."""
        within_s = self._answer_s if within_s is None else within_s
        deadline_s = time.monotonic() + within_s
        while end not in self._received:
            self._require_turn()
            if (left_s := deadline_s - time.monotonic()) <= 0:
                partial = f"only {self._received[:80]!r}" if self._received else "nothing"
                raise InstrumentTimeout.of(self.name, f"answer {question} within {within_s:g} s", partial)
            self._received += self._port.receive(min(left_s, SLICE_S))
            if len(self._received) > LONGEST_ANSWER and end not in self._received:
                began, self._received = self._received[:40], b""
                rule = f"end its answer to {question} within {LONGEST_ANSWER} bytes"
                raise self.reply_error(rule, f"more that begin {began!r}")
        piece, self._received = self._received.split(end, 1)
        return piece.decode("ascii", "replace")

    def _await_known(self, end: bytes, known: KnownAnswer) -> None:
        """Pass over late answers until the one to a question that was just sent."""
        deadline_s = time.monotonic() + self._answer_s
        while not re.fullmatch(known.form, answer := self._until(end, known.question).strip()):
            if time.monotonic() > deadline_s:
                raise InstrumentTimeout.of(self.name, f"answer {known.question} in a known form", repr(answer[:80]))

    def _drain(self, *, quiet_s: float = QUIET_S, within_s: float | None = None) -> None:
        """Throw away what came, until the line is quiet for a time or the time allowed is over."""
        now_s = heard_s = time.monotonic()
        deadline_s = now_s + (self._answer_s if within_s is None else within_s)
        self._received = b""
        while now_s < deadline_s and now_s - heard_s < quiet_s:
            self._require_turn()
            came = self._port.receive(SLICE_S)
            now_s = time.monotonic()
            heard_s = now_s if came else heard_s


class FramedLine(InstrumentLine):
    """Commands and answers that are one line of text each.

    Parameters
    ----------
    port, name, answer_s
        See `InstrumentLine`.
    answer_end
        Terminator of answers.
    command_end
        Terminator of commands.
    known
        How to get into step after an answer that came late.
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
    """Commands and answers over a line that echoes: each exchange is compared with its echo, or begun anew.

    An echo of another command is InstrumentReplyError, an answer that is an error of the unit InstrumentRejected.
    """

    def write(self, command: str) -> None:
        """Send a setting, which has no answer beyond its echo; one that comes is InstrumentRejected."""
        if answer := self.ask(command):
            raise self.rejection(f"accept {command!r} in silence", repr(answer))

    def ask(self, question: str) -> str:
        answer = super().ask(question)
        if meaning := self._refusal(answer):
            raise self.rejection(f"accept {question!r}", meaning)
        return answer

    @abstractmethod
    def _refusal(self, answer: str) -> str | None:
        """Return what an answer says is wrong; None where it is no error."""


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
