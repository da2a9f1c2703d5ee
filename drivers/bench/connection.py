"""The conversation between a client and its bench server: whole messages over a socket pair, never waited for."""

import pickle
import select
import socket
from dataclasses import dataclass, field
from typing import Any

from drivers.bench.safe_state import SafeStateReport
from drivers.errors import BenchError
from labdata.errors import BadInput
from labdata.instrument_config import Role

BEAT_S = 0.1
"""Time between two signs of life, s."""

SILENCE_S = 0.5
"""Silence after which the other side counts as hung, s: five signs of life."""

LARGEST_BYTES = 1 << 17
"""Largest message; a setup with its calibrations has some thousand bytes."""


@dataclass(frozen=True, kw_only=True)
class Beat:
    """A sign of life, and the time since the run itself showed one, s (0 for the server)."""

    age_s: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Request:
    """A command of the bench by its name, see `server.COMMANDS`; number 0 wants no reply."""

    number: int
    command: str
    arguments: tuple[Any, ...] = ()
    named: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Reply:
    """What a request brought."""

    number: int
    value: Any = None
    error: BenchError | BadInput | None = None


@dataclass(frozen=True, kw_only=True)
class Ports:
    """The server has opened ports, whose descriptors come with this message, in the order of the roles."""

    roles: tuple[Role, ...]


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Something failed, and the tube is made safe; sent before the gate is shut."""

    error: BenchError


@dataclass(frozen=True, kw_only=True)
class MadeSafe:
    """How a safe action left the tube."""

    report: SafeStateReport


class Connection:
    """One end of the conversation, over one of a pair of `SOCK_SEQPACKET` sockets, which keep messages whole."""

    def __init__(self, end: socket.socket) -> None:
        self._socket = end
        end.setblocking(False)
        self._poll = select.poll()
        self._poll.register(end, select.POLLIN)
        self.gone = False
        """Whether the other side has closed its end, or reads nothing any more."""

    def fileno(self) -> int:
        """Descriptor, for `select`."""
        return self._socket.fileno()

    def send(self, message: object, descriptors: tuple[int, ...] = ()) -> None:
        """Send a message with copies of descriptors; nobody waits for a side that reads nothing, it counts as gone."""
        data = pickle.dumps(message)
        try:
            if descriptors:
                socket.send_fds(self._socket, [data], list(descriptors))
            else:
                self._socket.send(data)
        except OSError:
            self.gone = True

    def receive(self, timeout_s: float) -> list[tuple[Any, list[int]]]:
        """Return the messages that came within a time, each with the descriptors that came with it."""
        messages: list[tuple[Any, list[int]]] = []
        if self.gone or not self._poll.poll(1e3 * timeout_s):
            return messages
        while True:
            try:
                data, descriptors, _, _ = socket.recv_fds(self._socket, LARGEST_BYTES, 8)
            except BlockingIOError:
                return messages
            except ConnectionResetError:
                continue  # the other side left with messages unread; its last ones are still to be taken
            except OSError:
                data, descriptors = b"", []
            if not data:
                self.gone = True
                return messages
            messages.append((pickle.loads(data), descriptors))

    def close(self) -> None:
        """Close this end, which the other side notices at once."""
        self._socket.close()
