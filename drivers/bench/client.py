"""Client of the bench server: commands, heartbeat, and the safe state without a server."""

import contextlib
import itertools
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Self

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
from drivers.bench.light_control import GuardedLight
from drivers.bench.safe_state import (
    FOLLOW_S,
    REOPEN_S,
    Crew,
    Record,
    SafeStateReport,
    StepRecord,
    make_safe,
    say_on_stderr,
    tell_failures,
)
from drivers.bench.setup import BenchSetup, remember_bench
from drivers.errors import BenchError, BenchServerLost, BenchStopped
from drivers.instruments.models import model_of
from drivers.instruments.voltage_limits import FALL_S
from drivers.interface import FrameLevels, Operator
from labdata.event_log import EventLog
from labdata.instrument_config import Role

# Time without heartbeat of the server after which it is killed, s
SERVER_SILENCE_S = SILENCE_S + BEAT_S

# Longest duration of the safe action, s: wait for a lost port, then for the decay of the voltage
SAFE_S = FALL_S + REOPEN_S + 5.0

START_S = 60.0  # Longest start of the server, s

SLICE_S = 0.1
RESERVE_BYTES = 8 << 20  # Memory reserved for the safe action, bytes


def _command(name: str) -> Callable[..., Any]:
    """Return a method that runs a command of the bench in the server."""

    def ask(client: "BenchClient", *arguments: Any, **named: Any) -> Any:
        return client._ask(name, *arguments, **named)

    return ask


class BenchClient:
    """A bench whose ports, drivers and interlock live in a server process; see `TubeBench` for its
    commands.

    A thread sends the heartbeat of this process and of the run, watches the server, and makes
    the tube safe over the server's ports when the server ends or is silent: nothing is opened,
    started or allocated.
    """

    wires_left_out: tuple[str, ...] = ()

    def __init__(self, setup: BenchSetup) -> None:
        self._setup = setup
        self.fault: BenchError | None = None  # First error of the bench since it was opened
        self.report: SafeStateReport | None = None  # Report of the last safe action
        self.dark_seen = False
        self.say: Callable[[str], None] = say_on_stderr
        self._numbers = itertools.count(1)
        self._replies: dict[int, queue.SimpleQueue[Reply]] = {}
        self._ports: dict[Role, int] = {}
        self._drivers: dict[Role, Any] = {}
        self._stamp_s, self._leave_number = time.monotonic(), -1
        self._left = self._over = self._leaves = False
        self._is_hot = True  # Whether the tube may be hot by the last heartbeat or a later request
        self._taking_over = threading.Lock()

    def __enter__(self) -> Self:
        self._log = EventLog(self._setup.log)
        self._crew, self._reserve = Crew(), bytearray(RESERVE_BYTES)
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self.process = subprocess.Popen(
                # -P: a module in the working folder must not shadow one of the library.
                [
                    sys.executable,
                    "-P",
                    "-m",
                    "drivers.bench.server",
                    "--socket",
                    str(theirs.fileno()),
                ],
                pass_fds=[theirs.fileno()],
                start_new_session=True,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
        self._server = Connection(ours)
        self._heard_s = time.monotonic() + START_S
        self._delay = SchedulingDelay(self._log, time.monotonic)
        opened = self._replies[0] = queue.SimpleQueue()
        self._server.send(self._setup)
        self._guard = threading.Thread(target=self._guard_server, name="bench", daemon=True)
        self._guard.start()
        try:
            self._await(opened, SAFE_S)
            if self._setup.wires.bench == "real":
                self._remember()
        except BaseException as error:
            self._leave(error)
            raise
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._leave(error)

    def _remember(self) -> None:
        """Save the wires of this bench, to make its tube safe later without a plan."""
        try:
            remember_bench(self._setup.wires)
        except OSError as error:
            self._log("bench not remembered", error=str(error))

    # Commands, as `TubeBench` describes them

    set_conditions = _command("set_conditions")
    shut_gate = _command("shut_gate")
    light_unknown = _command("light_unknown")
    permit_light = _command("permit_light")
    light_read = _command("light_read")
    darken = _command("darken")
    shine = _command("shine")
    read_meters = _command("read_meters")
    verify = _command("verify")

    def guard(self, operator: Operator) -> Operator:
        """Return the operator and lamp behind the interlock; use only what is returned."""
        return GuardedLight(operator, self)

    def dark_frame_seen(self, levels: FrameLevels) -> bool:
        """Report a frame without light; one that is not dark is NotDark."""
        self.dark_seen = self._ask("dark_frame_seen", levels)
        return self.dark_seen

    def frame_seen(self, levels: FrameLevels) -> None:
        """Report the saturation of a frame, without waiting."""
        self.alive()
        self._server.send(Request(number=0, command="frame_seen", arguments=(levels,)))

    def check(self) -> None:
        """Record a heartbeat, and raise an error of the bench."""
        self.alive()
        if self.fault is not None:
            raise self.fault

    def alive(self) -> None:
        """Record a heartbeat of the run."""
        self._stamp_s = max(self._stamp_s, time.monotonic())

    @contextmanager
    def patience(self, seconds: float) -> Iterator[None]:
        """Suspend the heartbeat for a time; the gate must be shut."""
        self._stamp_s = time.monotonic() + seconds
        try:
            yield
        finally:
            self._stamp_s = time.monotonic()

    def slack_s(self) -> float:
        """Return the time by which limits grow on a busy machine, s."""
        return self._delay.slack_s()

    def safe(self) -> None:
        """Make the tube safe now; BenchError if not verified. The bench stays usable if nothing
        failed.
        """
        self._make_safe().require_whole()

    def safe_at_once(self) -> None:
        """Order the safe state without waiting, for signal handlers of a run that may hang; no
        frame is taken for a good one from now on.
        """
        self.fault = self.fault or BenchStopped("the tube was made safe at once, as asked")
        self._server.send(Request(number=0, command="safe"))

    @property
    def last_words(self) -> str:
        """Final state of the tube, with manual steps if it may be hot; empty before the safe
        action.
        """
        return "" if self.report is None else self.report.last_words()

    # Messages

    def _ask(self, command: str, *arguments: Any, **named: Any) -> Any:
        """Send a command and return its value; an error of the bench is raised here."""
        if self.fault is not None:
            raise self.fault
        return self._request(
            Request(number=next(self._numbers), command=command, arguments=arguments, named=named)
        )

    def _request(self, request: Request, timeout_s: float | None = None) -> Any:
        reply = self._replies[request.number] = queue.SimpleQueue()
        self._is_hot = True
        self.alive()
        self._server.send(request)
        try:
            return self._await(reply, timeout_s)
        finally:
            del self._replies[request.number]

    def _await(self, reply: "queue.SimpleQueue[Reply]", timeout_s: float | None) -> Any:
        """Wait for a reply with a heartbeat of the run; the watching thread ends the wait if the
        server is lost.
        """
        until_s = time.monotonic() + (float("inf") if timeout_s is None else timeout_s)
        while time.monotonic() < until_s:
            self.alive()
            with contextlib.suppress(queue.Empty):
                answer = reply.get(timeout=SLICE_S)
                if answer.error is not None:
                    raise answer.error
                return answer.value
            if self._over:
                raise self.fault or BenchServerLost("the bench server has ended")
        raise BenchServerLost(f"the bench server must answer within {timeout_s:g} s, got nothing")

    def _guard_server(self) -> None:
        """Send heartbeats, take messages and watch the server, in a separate thread."""
        next_beat_s = 0.0
        while not self._over:
            began_s = time.monotonic()
            messages = self._server.receive(0.5 * BEAT_S)
            self._delay.take(time.monotonic() - began_s - 0.5 * BEAT_S)
            for message, descriptors in messages:
                self._heard_s = time.monotonic()
                self._take(message, descriptors)
            now_s = time.monotonic()
            if now_s >= next_beat_s:
                age_s = max(0.0, now_s - self._stamp_s)
                self._server.send(Beat(age_s=age_s, delay_s=self._delay.delay_s))
                next_beat_s = now_s + BEAT_S
            # Until the last look for messages: this thread may have slept since.
            silence_s = began_s - self._heard_s
            longest_s = SERVER_SILENCE_S + self._delay.slack_s()
            if silence_s > (longest_s if self._is_hot else SILENCE_AT_REST_S) or self._server.gone:
                if not self._left:
                    self._take_over("has ended" if self._server.gone else "was silent")
                self._over = True
        # A run that hangs does not leave, and its instruments may be set at their panels meanwhile.
        record = StepRecord(self._log, is_terse=True)
        while not self._leaves and self.report is not None:
            time.sleep(FOLLOW_S)
            with self._taking_over:
                self.report = self._secure(record, is_patient=False)

    def _take(self, message: Any, descriptors: list[int]) -> None:
        if isinstance(message, Beat):
            self._delay.take(0.0, message.delay_s)
            self._is_hot = message.is_hot or any(self._replies)  # 0: the opening
        elif isinstance(message, Ports):
            for role, descriptor in zip(message.roles, descriptors, strict=False):
                self._ports[role] = descriptor
            self._drivers = {role: self._driver(role) for role in self._ports}
        elif isinstance(message, Fault):
            self.fault = self.fault or message.error
        elif isinstance(message, MadeSafe) and message.is_warning:
            self._crew.start(lambda: self.say(message.report.warning()))
        elif isinstance(message, MadeSafe):
            self.report = message.report
        elif isinstance(message, Reply):
            self._left = self._left or message.number == self._leave_number
            if (waiting := self._replies.get(message.number)) is not None:
                waiting.put(message)

    def _driver(self, role: Role) -> Any:
        """Return a driver on the server's port, for the safe action."""
        connection = next(
            instrument for instrument in self._setup.wires.instruments if instrument.role == role
        )
        model = model_of(connection)
        port = model.later_port(str(connection.port), self._ports[role])
        return model.driver(model.line(port, connection.address))

    # Closing

    def _make_safe(self) -> SafeStateReport:
        try:
            report = self._request(Request(number=next(self._numbers), command="safe"), SAFE_S)
        except BenchServerLost:
            report = self._take_over("does not answer")
        self.report = report or self.report
        if self.report is None:
            raise BenchServerLost("the bench server must report how it left the tube, got nothing")
        return self.report

    def _leave(self, error: BaseException | None) -> None:
        """Make the bench safe and end the server; failures are raised, or become notes of the first
        error.
        """
        unwritten, self._leaves = None, True
        self._leave_number = next(self._numbers)
        try:
            if not self._over:
                report, unwritten = self._request(
                    Request(number=self._leave_number, command="leave"), SAFE_S
                )
                self.report = report or self.report
        except BenchServerLost:
            self._take_over("does not answer")
        finally:
            self._hang_up()
        sentences = [] if self.report is None or self.report.whole else [self.report.not_whole()]
        if sentences and self.process.poll() is None:
            sentences[0] += (
                f"; the bench server, process {self.process.pid}, goes on until they are seen safe"
            )
        tell_failures((*sentences, unwritten), error)

    def _hang_up(self) -> None:
        self._over = True
        if threading.current_thread() is not self._guard:
            self._guard.join(1.0)
        self._server.close()
        try:
            self.process.wait(1.0)
        except subprocess.TimeoutExpired:  # it stands guard
            threading.Thread(target=self.process.wait, daemon=True).start()
        for driver in self._drivers.values():
            driver.line.close()
        self._crew.dismiss()
        self._log.close()

    # Safe action without a server

    def _take_over(self, how: str) -> SafeStateReport:
        """Kill the server and make the tube safe over its ports."""
        with self._taking_over:
            if self.report is not None and self.report.whole and self._over:
                return self.report
            self._reserve = bytearray()
            lost = BenchServerLost(f"the bench server {how}, and its client makes the tube safe")
            self.fault = self.fault or lost
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.process.pid, signal.SIGKILL)
            # Longest wait for a killed server to release its ports, s
            until_s = time.monotonic() + 0.1
            while self.process.poll() is None and time.monotonic() < until_s:
                time.sleep(0.01)
            for waiting in list(self._replies.values()):
                waiting.put(Reply(number=0, error=lost))
            self._log(f"the bench server {how}; its client makes the bench safe")
            self.report = self._secure(self._log, warn=lambda report: self.say(report.warning()))
            self._log("made safe", whole=self.report.whole, sentence=self.report.sentence())
            return self.report

    def _secure(self, record: Record, **manner: Any) -> SafeStateReport:
        return make_safe(
            gate=self._drivers.get("gate"),
            supply=self._drivers.get("supply"),
            lamps=[self._drivers.get("light-source")] if self._setup.wires.light else [],
            record=record,
            crew=self._crew,
            **manner,
        )
