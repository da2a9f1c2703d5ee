"""Bench server: the process that owns ports, drivers and interlock, and outlives its client until
the outputs are seen safe.

A high-voltage supply has no watchdog. When the client ends (the kernel closes its socket), hangs or
is silent, or an instrument fails, gate and high voltage are switched off at once. The main loop
never blocks: commands, checks, the safe action, the log and the dose have separate threads.
"""

import argparse
import os
import queue
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from drivers.bench.connection import (
    BEAT_S,
    SILENCE_AT_REST_S,
    SILENCE_S,
    Beat,
    Connection,
    Fault,
    MadeSafe,
    Ports,
    Reply,
    Request,
    SchedulingDelay,
)
from drivers.bench.light_control import Station, stations_on
from drivers.bench.safe_state import DANGEROUS, FOLLOW_S, Record, StepRecord
from drivers.bench.setup import BenchSetup, with_present_ports
from drivers.bench.state import Failed
from drivers.bench.tube_bench import DISPENSABLE, LOOK_EVERY_S, TubeBench
from drivers.errors import BenchError, BenchServerLost
from drivers.instruments.models import model_of
from drivers.serial_lines.line import InstrumentLine
from labdata import BadInput, EventLog
from labdata.instrument_config import Role

TICK_S = 0.02
# Time without heartbeat of the run, in a living process, after which the tube is made safe, s
STALLED_S = 1.2

# Commands of a client, besides `frame_seen`, `safe` and `leave`, which are not queued
COMMANDS = (
    "set_conditions",
    "shut_gate",
    "light_unknown",
    "permit_light",
    "light_read",
    "darken",
    "shine",
    "dark_frame_seen",
    "read_meters",
    "verify",
    "check",
)


class BenchServer:
    """The server of one client; `log` takes each step and must not block, `clock` is monotonic
    time, s.
    """

    def __init__(
        self,
        connection: Connection,
        setup: BenchSetup,
        log: Record,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._client, self._setup, self._log, self._clock = connection, setup, log, clock
        self._bench: TubeBench | None = None
        self._is_open = False
        # Queued commands of the client
        self.orders: queue.SimpleQueue[Request] = queue.SimpleQueue()
        self.to_make_safe: queue.SimpleQueue[SafeOrder] = queue.SimpleQueue()  # Queued safe actions
        self._over = threading.Event()
        self._stop_signal: int | None = None
        self._stamp_s = self._heard_s = clock()
        self._delay = SchedulingDelay(log, clock)
        self._longest_silence_s = 0.0

    def stop(self, number: int, _frame: object) -> None:
        """Signal handler: end the server safely."""
        self._stop_signal = number

    def serve(self) -> None:
        """Serve the client until it leaves or is lost; then make the bench safe."""
        self._log("start", pid=os.getpid())
        for work in (self._obey, self._obey_safe_orders):
            threading.Thread(target=work, daemon=True).start()
        reason, leaving = "the server itself failed", 0
        try:
            reason, leaving = self._converse()
        except Exception as error:
            reason = f"the server itself failed: {error!r}"
        finally:
            self._end(reason, leaving)

    # Main loop; waits for messages only

    def _converse(self) -> tuple[str, int]:
        """Exchange messages until the end; return its reason and the number of its request, or
        0.
        """
        next_beat_s = 0.0
        while True:
            began_s = self._clock()
            messages = self._client.receive(TICK_S)
            self._delay.take(self._clock() - began_s - TICK_S)
            for message, _ in messages:
                if isinstance(message, Request) and message.command == "leave":
                    return "the client leaves", message.number
                self.take(message)
            if (now_s := self._clock()) >= next_beat_s:
                self._client.send(Beat(delay_s=self._delay.delay_s, is_hot=self._is_hot))
                next_beat_s = now_s + BEAT_S
            if reason := self.end_reason():
                # Before the gate is shut, so that a living client does not record a dark frame as
                # an illuminated one.
                self._client.send(Fault(error=BenchServerLost(f"the bench server ends: {reason}")))
                return reason, 0
            self.react()

    def take(self, message: Beat | Request) -> None:
        """Take a message, without waiting; a request is life of the run as well."""
        now_s, age_s = self._clock(), message.age_s if isinstance(message, Beat) else 0.0
        self._stamp_s = max(self._stamp_s, now_s - age_s)
        if isinstance(message, Beat):
            self._longest_silence_s = max(self._longest_silence_s, now_s - self._heard_s)
            self._heard_s = now_s
            self._delay.take(0.0, message.delay_s)
            if self._bench is not None:
                self._bench.record_heartbeat(self._delay.slack_s())
        elif message.command == "frame_seen" and self._bench is not None:
            self._bench.frame_seen(*message.arguments)
        elif message.command == "safe":
            self.to_make_safe.put(SafeOrder(reason="the client asks for it", number=message.number))
        else:
            self.orders.put(message)

    def end_reason(self) -> str | None:
        """Return why the server must end, or None."""
        if self._stop_signal is not None:
            return f"the server got signal {self._stop_signal}"
        if self._client.gone:
            return "the client is gone"
        longest_s = SILENCE_S + self._delay.slack_s() if self._is_hot else SILENCE_AT_REST_S
        if (silence_s := self._clock() - self._heard_s) > longest_s:
            return f"the client was silent for {silence_s:.2f} s"
        return None

    def react(self) -> None:
        """Make the tube safe if the run has no heartbeat, or a rule of the interlock requires
        it.
        """
        if self._bench is None or not self._is_open or self._bench.fault is not None:
            return
        stalled_s, longest_s = self._clock() - self._stamp_s, STALLED_S + self._delay.slack_s()
        if self._is_hot and stalled_s > longest_s:
            why = (
                f"the run must show life every {longest_s:.2g} s, got {stalled_s:.1f} s of silence"
            )
            self._bench.fail(BenchError(why))
        else:
            self._bench.react()

    @property
    def _is_hot(self) -> bool:
        """Whether the gate may be open or the tube at gain, once the bench is open."""
        if self._bench is None or not self._is_open:
            return False
        return not self._bench.interlock.state.shut or self._bench.interlock.state.mcp_v > 0.0

    def end(self, reason: str) -> "SafeOrder":
        """Run a last safe action, and block all pending commands of the client."""
        if self._bench is not None:
            self._bench.interlock.tell(Failed(sentence=reason))
        order = SafeOrder(reason=reason)
        self.to_make_safe.put(order)
        return order

    def _end(self, reason: str, leaving: int) -> None:
        report = unwritten = None
        if self._bench is not None:
            order = self.end(reason)
            while not order.done.wait(BEAT_S):
                self._client.send(Beat())
            report, unwritten = self._bench.report, self._bench.close()
        if unwritten:
            self._log("dose not written", error=unwritten)
        if leaving:
            self._client.send(Reply(number=leaving, value=(report, unwritten)))
        self._over.set()
        # A bench that could not be opened was not switched on here, and its ports must be free for
        # the next run, unless a voltage is seen.
        if report is not None and not report.whole and (self._is_open or report.residual_v):
            self._stand_guard()
        self._log("end", reason=reason, longest_silence_s=round(self._longest_silence_s, 3))

    def _stand_guard(self) -> None:
        """Stay until gate, voltage and lamp are seen safe, whoever else has left.

        A signal ends it, and so does the end of a virtual bench: ports that are no devices go with
        its outputs, while a device may come back.
        """
        assert self._bench is not None
        self._stop_signal = None
        ports = [Path(each.port) for each in self._setup.wires.instruments if each.port]
        self._log("standing guard", pid=os.getpid())
        while self._stop_signal is None and not (self._bench.report and self._bench.report.whole):
            if not any(port.exists() or port.is_relative_to("/dev") for port in ports):
                return
            time.sleep(FOLLOW_S)

    # Threads

    def _obey(self) -> None:
        """Open the bench, then run the queued commands."""
        try:
            self.open_bench(self._open_stations())
        except (BenchError, BadInput) as error:
            self._client.send(
                Fault(error=error if isinstance(error, BenchError) else BenchError(str(error)))
            )
            self._client.send(Reply(number=0, error=error))
            return
        self._client.send(Reply(number=0))
        self._inhibitor = inhibit_suspend(self._log)
        while not self._over.is_set():
            self.obey(self.orders.get())

    def _open_stations(self) -> dict[Role, Station]:
        lines: dict[Role, InstrumentLine] = {}
        missing: BenchError | None = None
        for connection in with_present_ports(self._setup.wires).instruments:
            try:
                lines[connection.role] = model_of(connection).open_line(
                    str(connection.port), connection.address
                )
                lines[connection.role].slack_s = self._delay.slack_s
                self._log("port opened", line=connection.role)
            except BenchError as error:
                self._log("port not opened", line=connection.role, error=str(error))
                if connection.role not in DISPENSABLE:
                    missing = missing or error
        roles: tuple[Role, ...] = tuple(role for role in DANGEROUS if role in lines)
        self._client.send(Ports(roles=roles), tuple(lines[role].fileno() for role in roles))
        stations = stations_on(lines, self._setup.wires)
        if missing is not None:
            self._bench = self._bench_on(stations)
            self._bench.fail(missing)
            raise missing
        return stations

    def open_bench(self, stations: Mapping[Role, Station]) -> None:
        """Open the bench on its instruments; each is checked by its own thread, from its own
        opening on.
        """
        self._bench = bench = self._bench_on(stations)
        bench.record_heartbeat()
        for role in bench.stations:
            if role not in DISPENSABLE:
                self._begin_looks(LOOK_EVERY_S, partial(TubeBench.look, role=role))
        bench.open()
        self._is_open = True
        self._begin_looks(1.0, TubeBench.look_at_light)  # Interval between readings of the meter, s

    def _bench_on(self, stations: Mapping[Role, Station]) -> TubeBench:
        return TubeBench(
            self._setup,
            stations,
            record=self._log,
            on_failure=self._report_failure,
            warn=lambda report: self._client.send(MadeSafe(report=report, is_warning=True)),
            clock=self._clock,
        )

    def obey(self, request: Request) -> None:
        """Run a command and send the reply."""
        assert self._bench is not None
        try:
            if request.command not in COMMANDS:
                raise BadInput(
                    f"a command must be one of {', '.join(COMMANDS)}, got {request.command}"
                )
            value = getattr(self._bench, request.command)(*request.arguments, **request.named)
            self._client.send(Reply(number=request.number, value=value))
        except (BenchError, BadInput) as error:
            self._client.send(Reply(number=request.number, error=error))
        except Exception as error:
            failed = BenchError(f"the bench server failed at {request.command}: {error!r}")
            self._bench.fail(failed)
            self._client.send(Reply(number=request.number, error=failed))

    def _report_failure(self, error: BenchError) -> None:
        """Report a failure to the client, then queue the safe action."""
        self._client.send(Fault(error=error))
        self.to_make_safe.put(SafeOrder(reason=str(error)))

    def _obey_safe_orders(self) -> None:
        record = StepRecord(self._log, is_terse=True)
        while True:
            try:
                order = self.to_make_safe.get(timeout=FOLLOW_S)
            except queue.Empty:
                self.keep_safe(record)
            else:
                self.make_safe(order)

    def make_safe(self, order: "SafeOrder") -> None:
        """Run a safe action and report it."""
        report = None if self._bench is None else self._bench.make_safe(order.reason)
        if report is not None:
            self._client.send(MadeSafe(report=report))
        if order.number:
            self._client.send(Reply(number=order.number, value=report))
        order.done.set()

    def keep_safe(self, record: Record) -> None:
        """Keep a bench safe that failed or was left, since its instruments may come back, or be set
        at their panels.
        """
        bench = self._bench
        if bench is None or bench.report is None or not (bench.fault or self._over.is_set()):
            return
        if (report := bench.keep_safe(record)) is not None:
            self._log("made safe", whole=report.whole, sentence=report.sentence())
            self._client.send(MadeSafe(report=report))

    def _begin_looks(self, every_s: float, look: Callable[[TubeBench], object]) -> None:
        threading.Thread(target=self._look, args=(every_s, look), daemon=True).start()

    def _look(self, every_s: float, look: Callable[[TubeBench], object]) -> None:
        """Check an instrument periodically; a time-out blocks only this thread."""
        while not self._over.wait(every_s):
            self.look_by(look)

    def look_by(self, look: Callable[[TubeBench], object]) -> None:
        """Run one check, then react in case the main loop hangs; an internal error makes the tube
        safe.
        """
        bench = self._bench
        if bench is None or bench.fault is not None:
            return
        try:
            look(bench)
            self.react()
        except Exception as error:
            bench.fail(BenchError(f"the bench server failed: {error!r}"))


@dataclass(frozen=True, kw_only=True)
class SafeOrder:
    """One safe action: why, the number of the request that wants its report (0: none), and whether
    it is done.
    """

    reason: str
    number: int = 0
    done: threading.Event = field(default_factory=threading.Event)


def inhibit_suspend(log: Record) -> subprocess.Popen | None:
    """Keep the machine from suspending while this process lives, where systemd-logind is
    available.
    """
    command = ["systemd-inhibit", "--what=sleep:handle-lid-switch", "--who=charact", "--mode=block"]
    command += ["--why=an image intensifier may be hot", "cat"]
    try:
        # `cat` ends with this process, and the inhibitor with `cat`.
        inhibitor = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
    except OSError as error:
        log("suspend not inhibited", error=str(error))
        return None
    log("suspend inhibited")
    return inhibitor


def main() -> None:
    """Serve the bench of the client that started this process."""
    parser = argparse.ArgumentParser(description="Serve a bench; started by its client.")
    parser.add_argument(
        "--socket", type=int, required=True, help="inherited end of the client's socket pair"
    )
    connection = Connection(socket.socket(fileno=parser.parse_args().socket))
    setup: Any = None
    while setup is None and not connection.gone:
        setup = next((message for message, _ in connection.receive(1.0)), None)
    if setup is None:
        return
    try:
        log = EventLog(Path(setup.log))
    except BadInput as error:
        connection.send(Reply(number=0, error=error))
        return
    server = BenchServer(connection, setup, log)
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, server.stop)
    try:
        server.serve()
        log.close(1.0)  # Longest wait for the log at the end, s
    finally:
        # A thread that waits for a disk or a line must not keep this process and its ports alive.
        os._exit(0)


if __name__ == "__main__":
    main()
