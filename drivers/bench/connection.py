"""Messages between a bench client and its server over a socket pair."""

import pickle
import select
import socket
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from drivers.bench.safe_state import SafeStateReport
from drivers.errors import BenchError
from labdata.errors import BadInput
from labdata.instrument_config import Role

BEAT_S = 0.1  # Heartbeat interval, s
# Time without heartbeat after which the other side counts as hung, s: five intervals, and with the
# tube at rest as long as a busy machine may take: at 14 times the cores a process stood for 3 s
SILENCE_S, SILENCE_AT_REST_S = 0.5, 10.0
LARGEST_BYTES = 1 << 17  # Largest message; a setup with calibrations has a few kilobytes


@dataclass(frozen=True, kw_only=True)
class Beat:
    """A heartbeat, with the time since that of the run, s (0 for the server), the scheduling delay
    of its process, s, and whether the tube may be at gain or the gate open, which the server knows.
    """

    age_s: float = 0.0
    delay_s: float = 0.0
    is_hot: bool = True


# Multiple of the longest scheduling delay, of both sides, by which limits grow on a busy machine,
# and the most that they grow, s; the delay is forgotten after a minute, and said above 0.1 s
SLACK_FACTOR, LONGEST_SLACK_S, FORGET_S, SAID_S = 4.0, 2.5, 60.0, 0.1


class SchedulingDelay:
    """Longest lateness with which a process was scheduled in the last minute or two, s.

    A busy machine delays heartbeats and answers that come in time; both sides run on it.
    """

    def __init__(self, log: Callable[..., object], clock: Callable[[], float]) -> None:
        self._log, self._clock, self._began_s = log, clock, clock()
        self._recent_s = self._before_s = self._other_s = 0.0
        self._is_said = False

    @property
    def delay_s(self) -> float:
        """Longest lateness of this process, s."""
        return max(self._recent_s, self._before_s)

    def slack_s(self) -> float:
        """Return the time by which limits grow, s."""
        return min(LONGEST_SLACK_S, SLACK_FACTOR * max(self.delay_s, self._other_s))

    def take(self, late_s: float, other_s: float | None = None) -> None:
        """Take a lateness of this process, and that which the other side reports."""
        if (now_s := self._clock()) - self._began_s > FORGET_S:
            self._began_s, self._before_s, self._recent_s = now_s, self._recent_s, 0.0
        self._recent_s = max(self._recent_s, late_s)
        self._other_s = self._other_s if other_s is None else other_s
        if not self._is_said and self.slack_s() > SLACK_FACTOR * SAID_S:
            self._is_said = True
            self._log("busy machine: limits grow", slack_s=round(self.slack_s(), 2))


@dataclass(frozen=True, kw_only=True)
class Request:
    """A command of the bench by its name, see `server.COMMANDS`; number 0 wants no reply."""

    number: int
    command: str
    arguments: tuple[Any, ...] = ()
    named: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Reply:
    """Result of a request."""

    number: int
    value: Any = None
    error: BenchError | BadInput | None = None


@dataclass(frozen=True, kw_only=True)
class Ports:
    """Ports opened by the server; their descriptors come with this message, in the order of the
    roles.
    """

    roles: tuple[Role, ...]


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A failure that leads to the safe action; sent before the gate is shut."""

    error: BenchError


@dataclass(frozen=True, kw_only=True)
class MadeSafe:
    """Report of a safe action; of one that goes on where it is a warning."""

    report: SafeStateReport
    is_warning: bool = False


class Connection:
    """One end of a pair of `SOCK_SEQPACKET` sockets, which preserve message boundaries."""

    def __init__(self, end: socket.socket) -> None:
        self._socket = end
        end.setblocking(False)
        self._poll = select.poll()
        self._poll.register(end, select.POLLIN)
        self.gone = False  # Whether the other side has closed its end or stopped reading

    def fileno(self) -> int:
        """Descriptor, for `select`."""
        return self._socket.fileno()

    def send(self, message: object, descriptors: tuple[int, ...] = ()) -> None:
        """Send a message with copies of descriptors, without waiting; a side that does not read
        counts as gone.
        """
        data = pickle.dumps(message)
        try:
            if descriptors:
                socket.send_fds(self._socket, [data], list(descriptors))
            else:
                self._socket.send(data)
        except OSError:
            self.gone = True

    def receive(self, timeout_s: float) -> list[tuple[Any, list[int]]]:
        """Return the messages received within a time, each with its descriptors."""
        messages: list[tuple[Any, list[int]]] = []
        if self.gone or not self._poll.poll(1e3 * timeout_s):
            return messages
        while True:
            try:
                data, descriptors, _, _ = socket.recv_fds(self._socket, LARGEST_BYTES, 8)
            except BlockingIOError:
                return messages
            except ConnectionResetError:
                # the other side closed with messages unread; its last ones can still be read
                continue
            except OSError:
                data, descriptors = b"", []
            if not data:
                self.gone = True
                return messages
            messages.append((pickle.loads(data), descriptors))

    def close(self) -> None:
        """Close this end; the other side is notified at once."""
        self._socket.close()
