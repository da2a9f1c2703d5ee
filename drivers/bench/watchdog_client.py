"""The client's side of the watchdog: start it, show signs of life, and speak to the instruments through it."""

import contextlib
import itertools
import json
import queue
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from drivers import errors
from drivers.bench.safe_state import SafeStateReport
from drivers.errors import BenchError, BenchServerLost
from drivers.instruments.models import model_of
from drivers.instruments.voltage_limits import FALL_S
from labdata.wires import Role, Wires

BEAT_S = 0.1
START_S = 15.0
REPLY_S = 3.0
SAFETY_S = FALL_S + 5.0


class WatchedLine:
    """A line to an instrument whose port the watchdog owns."""

    def __init__(self, guard: "Guard", *, line: str, name: str) -> None:
        self.name = name
        self._guard, self._line = guard, line

    def write(self, command: str) -> None:
        """Send a command that has no answer."""
        self._guard.request({"line": self._line, "do": "write", "text": command})

    def order(self, command: str) -> None:
        """Send a command that must go out."""
        self.write(command)

    def ask(self, question: str) -> str:
        """Send a question and return its answer."""
        return self._guard.request({"line": self._line, "do": "ask", "text": question})["reply"]

    def watch(self, on: bool) -> None:
        """Have the watchdog look every moment for a sign of life, or, on the supply, for a trip."""
        self._guard.request({"line": self._line, "do": "watch", "on": on})

    def close(self) -> None:
        """Nothing: the watchdog holds the port until the end."""


class Guard:
    """A watchdog process of our own.

    Parameters
    ----------
    wires
        Models, serial ports and addresses of the instruments.
    log
        File to which the watchdog appends its JSON lines.
    on_lost
        Called from a thread of its own, at once, when the watchdog is gone before it was told to leave.

    Raises
    ------
    BenchServerLost
        If it does not start.
    BenchError
        If a port cannot be opened.
    """

    def __init__(self, *, wires: Wires, log: Path, on_lost: Callable[[], object] = lambda: None) -> None:
        self.fault: BenchError | None = None
        """What went wrong at the bench since, as the watchdog told it."""
        self._numbers, self._sending = itertools.count(1), threading.Lock()
        self._replies: dict[int, queue.SimpleQueue[dict]] = {}
        self._ready: queue.SimpleQueue[dict] = queue.SimpleQueue()
        self._on_lost, self._leaving = on_lost, False
        self._over = threading.Event()
        ours, theirs = socket.socketpair()
        command = [sys.executable, "-m", "drivers.bench.watchdog", "--socket", str(theirs.fileno())]
        for one in wires.instruments:
            command += ["--instrument", one.role, one.model, str(one.port), str(one.address)]
        with theirs:
            self.process = subprocess.Popen(
                [*command, "--log", str(Path(log).absolute())],
                pass_fds=[theirs.fileno()],
                start_new_session=True,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
        self._connection = ours
        self._threads = [threading.Thread(target=task, daemon=True) for task in (self._listen, self._beat)]
        for thread in self._threads:
            thread.start()
        self.lines: dict[Role, WatchedLine] = {
            one.role: WatchedLine(self, line=one.role, name=model_of(one).title) for one in wires.instruments
        }
        """Lines to the instruments, by role."""
        try:
            self._await_ready()
        except BaseException:
            self.hang_up()
            raise

    def request(self, message: dict, *, timeout_s: float = REPLY_S) -> dict:
        """Send a request and return its reply; the error of an instrument is raised here."""
        number, reply = next(self._numbers), queue.SimpleQueue()
        self._replies[number] = reply
        try:
            self._send({"id": number, **message})
            answer = reply.get(timeout=timeout_s)
        except queue.Empty:
            raise BenchServerLost(f"the watchdog must answer within {timeout_s:g} s, got nothing") from None
        finally:
            del self._replies[number]
        if answer.get("error"):
            raise _error(answer["error"])
        return answer

    def check(self) -> None:
        """Raise what went wrong since, if anything did."""
        if self.fault is not None:
            raise self.fault

    def safe(self) -> SafeStateReport:
        """Have the bench made safe now; the watchdog goes on."""
        return _safety(self.request({"do": "safe"}, timeout_s=SAFETY_S))

    def leave(self) -> SafeStateReport:
        """Have the bench made safe, and the watchdog end."""
        self._leaving = True
        try:
            return _safety(self.request({"do": "leave"}, timeout_s=SAFETY_S))
        finally:
            self.hang_up()

    def hang_up(self) -> None:
        """Close our end; whatever is left to do, the watchdog does."""
        self._over.set()
        self._connection.close() if threading.current_thread() in self._threads else self._close()

    def _close(self) -> None:
        with contextlib.suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join(1.0)
        self._connection.close()
        try:
            self.process.wait(SAFETY_S)
        except subprocess.TimeoutExpired:
            raise BenchServerLost(f"the watchdog must end within {SAFETY_S:g} s of leaving, got no end") from None

    def _await_ready(self) -> None:
        try:
            answer = self._ready.get(timeout=START_S)
        except queue.Empty:
            raise BenchServerLost(f"the watchdog must start within {START_S:g} s, got nothing") from None
        if not answer["ready"]:
            raise _error(answer["error"])

    def _send(self, message: dict) -> None:
        try:
            with self._sending:
                self._connection.sendall(json.dumps(message).encode() + b"\n")
        except OSError as error:
            raise self.fault or BenchServerLost(f"the watchdog must listen, got: {error}") from None

    def _beat(self) -> None:
        while not self._over.wait(BEAT_S):
            try:
                self._send({"do": "beat"})
            except BenchError:
                return

    def _listen(self) -> None:
        kept = b""
        while data := self._received():
            *lines, kept = (kept + data).split(b"\n")
            for line in lines:
                self._take(json.loads(line))
        self.fault = self.fault or BenchServerLost("the watchdog must outlive its client, got its end")
        ended = {"ready": False, "error": {"kind": type(self.fault).__name__, "sentence": str(self.fault)}}
        for waiting in [self._ready, *self._replies.values()]:
            waiting.put(ended)
        if not (self._leaving or self._over.is_set()):
            self._on_lost()

    def _received(self) -> bytes:
        try:
            return self._connection.recv(65536)
        except OSError:
            return b""

    def _take(self, message: dict) -> None:
        if "ready" in message:
            self._ready.put(message)
        elif message.get("event") == "fault":
            self.fault = self.fault or _error(message["error"])
        elif (reply := self._replies.get(message["id"])) is not None:
            reply.put(message)


def _error(description: dict) -> BenchError:
    kind = getattr(errors, description["kind"], BenchError)
    extra = {name: value for name, value in description.items() if name not in ("kind", "sentence")}
    return kind(description["sentence"], **extra)


def _safety(answer: dict) -> SafeStateReport:
    values = answer["safety"]
    return SafeStateReport(**{**values, "failures": tuple(values["failures"])})
