"""The watchdog process: it alone owns the serial ports, outlives its client, and makes the tube safe when that is gone.

A high-voltage supply has no watchdog of its own. The client talks through a socket pair; when it closes (the kernel
does that for a killed process), falls silent, or an instrument fails, gate and high voltage go at once.
"""

import argparse
import contextlib
import json
import os
import select
import signal
import socket
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from drivers.bench.safe_state import SafeStateReport, make_safe
from drivers.errors import BenchError, BenchServerLost
from drivers.instruments.models import InstrumentModel, model_of
from drivers.serial_lines.line import InstrumentLine
from drivers.serial_lines.line_worker import LineWorker, described
from labdata.wires import Reached, Role

HEARTBEAT_S = 0.5
"""Longest time between two signs of life of the client, s."""

TICK_S = 0.02
MONITOR_S = 0.15
IDLE_S = 0.5
SPARE: tuple[Role, ...] = ("light-meter", "thermometer")
"""What the tube does without: its failure is told, and the bench goes on."""

Openers = dict[Role, tuple[InstrumentModel, Callable[[], InstrumentLine]]]
"""Each instrument's model, and what opens its line."""


class Log:
    """A file of JSON lines, one for each event, on disk as soon as it happened."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("a", buffering=1)

    def __call__(self, event: str, **details: object) -> None:
        """Write an event with its time of day and monotonic time, s."""
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = {"time": now, "monotonic_s": round(time.monotonic(), 4), "event": event, **details}
        self._file.write(json.dumps(line, default=str) + "\n")

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class Client:
    """The client's end of the conversation: JSON lines over the socket."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection, self._kept = connection, b""
        self._sending = threading.Lock()
        self.heard_s = time.monotonic()
        self.longest_silence_s = 0.0
        self.gone = False

    def messages(self, timeout_s: float) -> list[dict]:
        """Messages that came within a time, s; an end of the stream sets `gone`."""
        if not select.select([self._connection], [], [], timeout_s)[0]:
            return []
        try:
            data = self._connection.recv(65536)
        except ConnectionError:
            data = b""
        self.gone = self.gone or not data
        if data:
            self.longest_silence_s = max(self.longest_silence_s, time.monotonic() - self.heard_s)
            self.heard_s = time.monotonic()
        *lines, self._kept = (self._kept + data).split(b"\n")
        return [json.loads(line) for line in lines]

    def send(self, message: dict) -> None:
        """Send a message; a client that is gone is noticed elsewhere."""
        with contextlib.suppress(OSError), self._sending:
            self._connection.sendall(json.dumps(message).encode() + b"\n")


class Watchdog:
    """The guard of one bench.

    Parameters
    ----------
    client
        Whom it serves.
    log
        Where each step is written.
    """

    def __init__(self, *, client: Client, log: Log) -> None:
        self._client, self._log = client, log
        self._workers: dict[Role, LineWorker] = {}
        self._unopened: dict[Role, BenchError] = {}
        self._fault: BenchError | None = None
        self._safety: SafeStateReport | None = None
        self._stop_signal: int | None = None
        self._monitored_s = 0.0

    def stop(self, number: int, _frame: object) -> None:
        """Signal handler: end soon, safely."""
        self._stop_signal = number

    def serve(self, openers: Openers) -> None:
        """Open the lines and serve the client until it leaves or is lost; in the end the bench is safe."""
        self._log("start", pid=os.getpid())
        self._has_lamp = "light-source" in openers
        self._open(openers)
        self._client.send({"ready": self._fault is None, "error": described(self._fault)})
        reason, leaving = self._guarded() if self._fault is None else (str(self._fault), None)
        if self._safety is None or self._fault is None:
            self._make_safe(reason)
        self._answer_safety(leaving)
        for worker in self._workers.values():
            worker.close()
        self._log("end", reason=reason, longest_silence_s=round(self._client.longest_silence_s, 3))

    def _open(self, openers: Openers) -> None:
        for name, (kind, opener) in openers.items():
            try:
                line = opener()
            except BenchError as error:
                self._log("port not opened", line=name, error=str(error))
                if name in SPARE:
                    self._unopened[name] = error
                else:
                    self._fault = self._fault or error
                continue
            self._workers[name] = LineWorker(line, model=kind, reply=self._client.send, spare=name in SPARE)
            self._log("port opened", line=name)

    def _guarded(self) -> tuple[str, int | None]:
        try:
            return self._converse()
        except Exception as error:  # whatever it is, the bench is made safe next
            return f"the watchdog itself failed: {error!r}", None

    def _converse(self) -> tuple[str, int | None]:
        """Serve; return why it ended, and the number of the request that ended it, if one did."""
        while True:
            for message in self._client.messages(TICK_S):
                if message.get("do") == "leave":
                    return "the client leaves", message["id"]
                self._obey(message)
            if reason := self._danger():
                # Before the gate is shut, so that a client that lives after all takes no dark frame for one of light.
                self._client.send(
                    {"event": "fault", "error": described(BenchServerLost(f"the watchdog ends: {reason}"))}
                )
                return reason, None
            self._look_after_lines()

    def _danger(self) -> str | None:
        if self._stop_signal is not None:
            return f"the watchdog was told to stop by signal {self._stop_signal}"
        if self._client.gone:
            return "the client is gone"
        silence_s = time.monotonic() - self._client.heard_s
        return f"the client was silent for {silence_s:.2f} s" if silence_s > HEARTBEAT_S else None

    def _obey(self, message: dict) -> None:
        if message.get("do") == "safe":
            if self._safety is None or self._fault is None:
                self._make_safe("the client asks for it")
            self._answer_safety(message["id"])
            self._client.heard_s = time.monotonic()
        elif "line" in message and message["line"] in self._unopened:
            self._client.send({"id": message["id"], "error": described(self._unopened[message["line"]])})
        elif "line" in message:
            self._workers[message["line"]].put(message)

    def _look_after_lines(self) -> None:
        if self._fault is None:
            for worker in self._workers.values():
                if worker.failure is not None:
                    self._fault = worker.failure
                    self._client.send({"event": "fault", "error": described(self._fault)})
                    self._make_safe(str(self._fault))
                    self._client.heard_s = time.monotonic()
                    return
            if time.monotonic() - self._monitored_s > MONITOR_S:
                self._monitored_s = time.monotonic()
                for worker in self._workers.values():
                    worker.monitor()

    def _make_safe(self, reason: str) -> None:
        self._log("making safe", reason=reason)
        for worker in self._workers.values():
            worker.pause()
        held = {name: worker.wait_idle(IDLE_S) for name, worker in self._workers.items()}
        drivers = {name: worker.driver for name, worker in self._workers.items()}
        lamps = [drivers.get("light-source")] if self._has_lamp else []
        self._safety = make_safe(gate=drivers.get("gate"), supply=drivers.get("supply"), lamps=lamps, record=self._log)
        self._log("made safe", whole=self._safety.whole, sentence=self._safety.sentence(), **vars(self._safety))
        for name, worker in self._workers.items():
            worker.resume(held[name], fault=self._fault)

    def _answer_safety(self, request: int | None) -> None:
        if request is not None and self._safety is not None:
            self._client.send({"id": request, "safety": vars(self._safety)})


def _opener(reached: Reached) -> tuple[InstrumentModel, Callable[[], InstrumentLine]]:
    kind = model_of(reached)
    return kind, lambda: kind.open_line(str(reached.port), reached.address)


def main() -> None:
    """Guard a bench; started by its client."""
    parser = argparse.ArgumentParser(description="Guard a bench; started by its client.")
    parser.add_argument("--socket", type=int, required=True, help="inherited end of the client's socket pair")
    columns = ("ROLE", "MODEL", "PORT", "ADDRESS")
    parser.add_argument("--instrument", nargs=4, action="append", required=True, metavar=columns)
    parser.add_argument("--log", type=Path, required=True)
    asked = parser.parse_args()
    log = Log(asked.log)
    watchdog = Watchdog(client=Client(socket.socket(fileno=asked.socket)), log=log)
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, watchdog.stop)
    try:
        there = [
            Reached(role=role, model=name, port=port, address=int(at)) for role, name, port, at in asked.instrument
        ]
        watchdog.serve({reached.role: _opener(reached) for reached in there})
    finally:
        log.close()


if __name__ == "__main__":
    main()
