"""Safe state of the tube: gate shut, high voltage off, lamp off, each step recorded."""

import queue
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

from drivers.errors import (
    BenchError,
    InstrumentDisconnected,
    InstrumentReplyError,
    InstrumentTimeout,
)
from drivers.instruments.gate_limits import Gate
from drivers.instruments.light_source import LightSource
from drivers.instruments.voltage_limits import DISCHARGED_V, FALL_S, Supply
from labdata.instrument_config import Role

# Roles that the safe action covers
DANGEROUS: tuple[Role, ...] = "gate", "supply", "light-source"

Record = Callable[..., object]  # Called as record(step, **details) for each step; it must not block
Warn = Callable[["SafeStateReport"], object]  # Called with a report of a tube that may be hot

FOLLOW_S = 0.2  # Interval between attempts, s
DEAF_S = 3.0  # Longest time of attempts on an instrument that does not obey, s
REOPEN_S = 15.0  # Longest time of attempts to reopen a lost port, s
# Of as many reopened ports at which nobody known answers, one is given the time of a busy machine:
# ports may be swapped, and each then costs that time
PORTS_A_PATIENT_ONE = 5
LONGEST_TURN_S = 1.0  # Longest wait for another task that reopens ports, s
STEADY_READINGS = 3  # Readings of an output ordered off that does not fall, before it is reported

# Manual steps for a tube that could not be made safe
BY_HAND = (
    "switch the high-voltage supply off at its front panel, then cover the camera and "
    "disconnect the gate unit"
)


def say_on_stderr(sentence: str) -> None:
    """Say a sentence to the person at the terminal."""
    print(sentence, file=sys.stderr, flush=True)


@dataclass(frozen=True, kw_only=True)
class SafeStateReport:
    """Report of a safe action."""

    gate_shut: bool  #: Whether the gate read back no pulses and a shut idle level
    off_ordered: bool  #: Whether the command to switch the high voltage off was sent
    #: Last voltage measured at the output, V; None if none could be measured
    residual_v: float | None
    #: Whether every lamp of the bench read back that it is off; true without lamps
    light_dark: bool = True
    failures: tuple[
        str, ...
    ] = ()  #: One sentence for each failed step of an instrument that was not verified

    @property
    def whole(self) -> bool:
        """Whether everything was verified: gate shut, output discharged, lamp off."""
        discharged = self.residual_v is not None and self.residual_v <= DISCHARGED_V
        return self.gate_shut and discharged and self.light_dark

    def sentence(self) -> str:
        """Return one sentence on the state of the tube."""
        gate = "the gate is shut" if self.gate_shut else "the gate may be open"
        if self.residual_v is not None and self.residual_v <= DISCHARGED_V:
            gain = f"the high voltage is off and down to {self.residual_v:g} V"
        elif self.residual_v is not None:
            gain = f"{self.residual_v:g} V were last measured at the output"
        else:
            gain = (
                "the high voltage was ordered off but not verified"
                if self.off_ordered
                else "the high voltage is on"
            )
        return f"{gate}, {gain}" if self.light_dark else f"{gate}, {gain}, the lamp may burn"

    def last_words(self) -> str:
        """Return the state of the tube, with manual steps if it may be hot."""
        return self.sentence() if self.whole else f"{self.sentence()}; by hand, now: {BY_HAND}"

    def warning(self) -> str:
        """Return what a person must do while the safe action goes on."""
        return f"The tube: {self.last_words()}; the software goes on trying meanwhile."

    def not_whole(self) -> str:
        """Return the sentence of the error of an unverified safe state."""
        why = f" ({self.failures[0]})" if self.failures else ""
        rule = "the bench must be left with gate shut, high voltage off and light out"
        return f"{rule}, got: {self.last_words()}{why}"

    def require_whole(self) -> None:
        """Raise BenchError if the safe state was not verified."""
        if not self.whole:
            raise BenchError(self.not_whole())


def tell_failures(sentences: Iterable[str | None], error: BaseException | None) -> None:
    """Raise the first sentence as BenchError, or add all as notes to an earlier error."""
    for sentence in filter(None, sentences):
        if error is None:
            raise BenchError(sentence)
        error.add_note(sentence)


class Crew:
    """Waiting threads, so that a process that can no longer start threads can still make the tube
    safe.
    """

    def __init__(self, size: int = 4) -> None:
        self._jobs: queue.SimpleQueue[tuple[Callable[[], object], threading.Event] | None] = (
            queue.SimpleQueue()
        )
        self._size = size
        for _ in range(size):
            threading.Thread(target=self._work, name="safe", daemon=True).start()

    def run(
        self, tasks: Sequence[Callable[[], object]], again: Sequence[Callable[[], object]]
    ) -> None:
        """Run tasks at once until all have ended; one that has ended is followed meanwhile by its
        task of `again` at each interval.
        """
        ended = [self.start(task) for task in tasks]
        latest = list(ended)
        while pending := [event for event in ended if not event.is_set()]:
            if pending[0].wait(FOLLOW_S):
                continue
            for number, event in enumerate(latest):
                if event.is_set():
                    latest[number] = self.start(again[number])
        for event in latest:
            event.wait()

    def start(self, task: Callable[[], object]) -> threading.Event:
        """Run a task without waiting; return the event of its end."""
        ended = threading.Event()
        self._jobs.put((task, ended))
        return ended

    def dismiss(self) -> None:
        """End the threads."""
        for _ in range(self._size):
            self._jobs.put(None)

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            task, ended = job
            try:
                task()
            finally:
                ended.set()


def make_safe(
    *,
    gate: Gate | None,
    supply: Supply | None,
    lamps: Sequence[LightSource | None] = (),
    record: Record,
    crew: Crew | None = None,
    warn: Warn = lambda report: None,
    is_patient: bool = True,
) -> SafeStateReport:
    """Shut the gate, switch high voltage and lamps off in parallel, then follow the decay of the
    output.

    A silent line does not delay the others, which are ordered and read back again meanwhile: a
    person at a panel may undo what was verified. A lost port is reopened for up to 15 s, and its
    instrument made safe when it is back. This raises nothing, since the next step must be tried
    too.

    Parameters
    ----------
    gate, supply, lamps
        Instruments of the tube; None if the line to one could not be opened.
    crew
        Threads to use; None: new ones.
    warn
        Called once, in a thread of the crew, with the report so far as soon as the first attempts
        show an instrument that does not obey.
    is_patient
        Whether to repeat the attempts on an instrument that is lost or silent; otherwise a lost
        port is reopened once.
    """
    shut = _Task(
        gate,
        "delay generator",
        record,
        "gate",
        orders="shut_commands",
        verify=("shut and read back", "shut"),
    )
    fall = _Falling(supply, "high-voltage supply", record, "high voltage", orders="off_commands")
    dark = [
        _Task(
            lamp,
            "light source",
            record,
            "light",
            orders="dark_commands",
            verify=("out and read back", "darken"),
        )
        for lamp in lamps
    ]
    tasks, workers = (shut, fall, *dark), crew or Crew(3 + len(dark))
    reopening = threading.Lock()
    for task in tasks:
        task.reopening = reopening
        task.other_paths = [other.path for other in tasks if other.path and other is not task]

    def report() -> SafeStateReport:
        failures = dict.fromkeys(failure for task in tasks for failure in tuple(task.failures))
        return SafeStateReport(
            gate_shut=shut.verified,
            off_ordered=fall.ordered,
            residual_v=fall.residual_v,
            light_dark=all(task.verified for task in dark),
            failures=tuple(failures),
        )

    attempts = _FirstAttempts(len(tasks), lambda: workers.start(partial(warn, report())))
    workers.run(
        [partial(task.run, attempts, is_patient) for task in tasks],
        [partial(task.follow, attempts) for task in tasks],
    )
    if crew is None:
        workers.dismiss()
    return report()


class StepRecord:
    """Records steps; where terse, those alone that end otherwise than the last time, so that no log
    fills a disk.
    """

    def __init__(self, record: Record, *, is_terse: bool = False) -> None:
        self._record, self._outcomes, self.is_terse = record, dict[str, bool](), is_terse

    def __call__(self, step: str, *, ok: bool = True, **details: Any) -> None:
        if not self.is_terse or self._outcomes.get(step) is not ok:
            self._record(step, ok=ok, **details)
        self._outcomes[step] = ok


class _FirstAttempts:
    """Calls `alarm` once, when all tasks have made their first attempt and one shows trouble."""

    def __init__(self, size: int, alarm: Callable[[], object]) -> None:
        self._size, self._alarm = size, alarm
        self._attempted = set[_Task]()
        self._is_troubled = self._has_alarmed = False
        self._turn = threading.Lock()

    def take(self, task: "_Task") -> None:
        """Take the outcome of an attempt of one task."""
        with self._turn:
            self._attempted.add(task)
            self._is_troubled = self._is_troubled or task.is_troubled
            is_early = len(self._attempted) < self._size
            if is_early or not self._is_troubled or self._has_alarmed:
                return
            self._has_alarmed = True
        self._alarm()


class _Task:
    """Commands on one line, each sent even if an earlier one failed, until the instrument reads
    back that it obeyed.

    `orders` names the driver's commands, and `verify` the last step and the method that does it.
    """

    def __init__(
        self,
        instrument: Any,
        name: str,
        record: Record,
        label: str,
        *,
        orders: str,
        verify: tuple[str, str] = ("", ""),
    ) -> None:
        self._instrument, self._name, self._label = instrument, name, label
        self._record = StepRecord(record)
        self._orders, self._verify, self._disconnected = orders, verify, False
        self.ordered = self.verified = False
        self.failures: list[str] = []
        self.path: str | None = None if instrument is None else instrument.line.path
        # Paths of the bench at which its instrument may answer when ports come back swapped, and
        # the turn to ask there
        self.other_paths: list[str] = []
        self.reopening = threading.Lock()
        self._unknown_ports = 0

    def run(self, attempts: _FirstAttempts, is_patient: bool) -> None:
        """Repeat the steps until they are verified or the time is over; a lost port is reopened."""
        if self._instrument is None:
            self.failures.append(f"the {self._name} could not be reached")
            attempts.take(self)
            return
        began_s = time.monotonic()
        with self._instrument.line.safing():
            while True:
                verified = self.secure()
                attempts.take(self)
                if verified or time.monotonic() >= began_s + self.patience_s(is_patient):
                    break
                time.sleep(FOLLOW_S)
                if self._disconnected:
                    self._reopen()
        if self.verified:
            self.failures.clear()

    def follow(self, attempts: _FirstAttempts) -> None:
        """Do the steps once more, whatever came of them."""
        self._record.is_terse = True
        self.run(attempts, is_patient=False)

    @property
    def is_troubled(self) -> bool:
        """Whether the last attempt shows an instrument that does not obey."""
        return not self.verified

    def patience_s(self, is_patient: bool) -> float:
        """Return the longest time of attempts, s."""
        if not is_patient:
            return FOLLOW_S
        return REOPEN_S if self._disconnected else DEAF_S

    def secure(self) -> bool:
        """Send every command and verify; return whether verified."""
        self.order()
        step, method = self._verify
        self.verified = self.attempt(step, getattr(self._instrument, method))[0]
        return self.verified

    def order(self) -> None:
        """Send every command, even if an earlier one failed."""
        send, commands = self._instrument.line.order, getattr(self._instrument, self._orders)
        sent = [self.attempt(command, partial(send, command))[0] for command in commands]
        self.ordered = self.ordered or all(sent)

    def attempt(self, step: str, action: Callable[[], object]) -> tuple[bool, object]:
        """Run and record a step; return whether it succeeded, and its result."""
        step = f"{self._label}: {step}"
        try:
            result = action()
        except Exception as error:  # the next step must be tried in any case
            self._record(step, ok=False, error=str(error))
            self.failures.append(str(error))
            self._disconnected = self._disconnected or isinstance(error, InstrumentDisconnected)
            return False, error
        self._record(step, ok=True, **({"result": result} if result is not None else {}))
        return True, result

    def _reopen(self) -> None:
        """Reopen a lost port, and ask who answers there: names of ports may be swapped.

        The orders go out before the question: an instrument may hear and its answers be lost.
        """
        with self._turn_to_reopen():
            for path in (None, *self.other_paths):
                if self._reopen_at(path):
                    self._record(f"{self._label}: port reopened", ok=True, path=path or self.path)
                    self.failures.clear()
                    return

    @contextmanager
    def _turn_to_reopen(self) -> Iterator[None]:
        """Wait until no other task reopens ports: two that ask at each other's would both find
        their own held, again and again. One that takes long is not waited for.
        """
        is_alone = self.reopening.acquire(timeout=LONGEST_TURN_S)
        try:
            yield
        finally:
            if is_alone:
                self.reopening.release()

    def _reopen_at(self, path: str | None) -> bool:
        """Return whether the port at a path could be opened and its instrument is the right one."""
        line = self._instrument.line
        try:
            line.reopen(path)
            self._disconnected = self.ordered = False
            if self.other_paths:
                self.order()
                self._identify()
        except (InstrumentReplyError, InstrumentTimeout):
            line.close()
            self._disconnected, self._unknown_ports = True, self._unknown_ports + 1
            return False
        except BenchError as error:
            self.failures.append(str(error))
            return False
        return True

    def _identify(self) -> None:
        line = self._instrument.line
        slack_s = line.slack_s
        if (self._unknown_ports + 1) % PORTS_A_PATIENT_ONE:
            line.slack_s = float
        try:
            self._instrument.identify()
        finally:
            line.slack_s = slack_s


class _Falling(_Task):
    """Switches the high voltage off and follows its decay; the order is repeated until the output
    is seen to fall.
    """

    residual_v: float | None = None
    _answers = _falls = False
    _steady_readings = 0

    @property
    def is_troubled(self) -> bool:
        is_deaf = not (self._answers and self.ordered) or self._steady_readings >= STEADY_READINGS
        return is_deaf and not self.verified

    def patience_s(self, is_patient: bool) -> float:
        return FALL_S if self._answers else super().patience_s(is_patient)

    def secure(self) -> bool:
        if not self._falls:
            self.order()
        self._answers, reading = self.attempt(
            self._instrument.reading, self._instrument.read_voltage_v
        )
        before_v, self._falls = self.residual_v, False
        if isinstance(reading, float):
            self.residual_v = reading
            self._falls = self.ordered and before_v is not None and reading < before_v
        self._steady_readings = 0 if self._falls else self._steady_readings + 1
        self.verified = (
            self._answers and self.residual_v is not None and self.residual_v <= DISCHARGED_V
        )
        return self.verified
