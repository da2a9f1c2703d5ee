"""A client of the campaign: a forked process that acquires, with its terminal, its disk and its
person at the bench.
"""

import ctypes
import mmap
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from benchmarks.studies.faults.campaign.rig import CampaignRig, StoppablePipe
from charact.cli.benches import PromptingOperator
from charact.live import SaturationJudge
from drivers import acquire
from drivers.acquisition.acquire import PLAN
from drivers.acquisition.run_control import RunControl
from drivers.bench.local_bench import open_bench
from drivers.cameras.aravis.camera import AravisCamera
from drivers.errors import BenchError
from drivers.interface import Operator
from labdata import BadInput, Conditions, DoseLedger, Frame, Plan, limits_in_force

CLOCK_JUMP_S = 7200.0
SATURATED = 0.05
"""Share of saturated pixels beyond which a frame ends a run, dimensionless."""

LAST_WORDS = "The tube:"
PROMPT = "What does the meter read"
_LIBC = ctypes.CDLL(None)


class Hang:
    """A call that does not come back as long as this holds, and in which no signal reaches its
    thread.
    """

    def __init__(self) -> None:
        self._shared = mmap.mmap(-1, mmap.PAGESIZE)
        self._mutex = ctypes.byref(ctypes.c_char.from_buffer(self._shared))
        shared_by_processes = ctypes.create_string_buffer(64)
        _LIBC.pthread_mutexattr_init(shared_by_processes)
        _LIBC.pthread_mutexattr_setpshared(shared_by_processes, 1)
        _LIBC.pthread_mutex_init(self._mutex, shared_by_processes)

    @property
    def holds(self) -> bool:
        """Whether calls hang now."""
        return bool(self._shared[-1])

    def begin(self) -> None:
        """Have calls hang."""
        if not self.holds:
            _LIBC.pthread_mutex_lock(self._mutex)
            self._shared[-1] = 1

    def end(self) -> None:
        """Have them come back."""
        if self.holds:
            self._shared[-1] = 0
            _LIBC.pthread_mutex_unlock(self._mutex)

    def call(self) -> None:
        """Make a call that hangs if calls do."""
        if self.holds:
            _LIBC.pthread_mutex_lock(self._mutex)
            _LIBC.pthread_mutex_unlock(self._mutex)

    def call_with_every_write(self, folder: Path) -> None:
        """Make one before every write, sync and rename of this process in a folder."""

        def after_call(act: Any) -> Any:
            def called(where: Any, *rest: Any) -> Any:
                path = (
                    os.readlink(f"/proc/self/fd/{where}")
                    if self.holds and isinstance(where, int)
                    else where
                )
                if str(path).startswith(str(folder)):
                    self.call()
                return act(where, *rest)

            return called

        for name in ("write", "fsync", "rename", "replace"):
            setattr(os, name, after_call(getattr(os, name)))


class Client:
    """An acquiring process, and what came to its terminal.

    Parameters
    ----------
    rig
        The bench.
    plan, session
        What to take, and where to.
    silence_s
        How long its camera may be silent, s.
    prompts
        Whether a person at its terminal sets the light: `answer` is what they type.
    """

    def __init__(
        self,
        rig: CampaignRig,
        plan: Plan,
        session: Path,
        *,
        silence_s: float,
        prompts: bool = False,
    ) -> None:
        self.began_s, self.session = time.monotonic(), session
        self.disk, self.camera = Hang(), Hang()
        self.terminal, self._marks = StoppablePipe(*os.pipe()), StoppablePipe(*os.pipe())
        keyboard, self._typed = os.pipe()
        self._status: int | None = None
        self._lines: list[str] = []
        self._rest, self._marked = b"", b""
        self._rig = rig
        self.pid = os.fork()
        if not self.pid:
            os.dup2(keyboard, 0)
            _acquire(self, rig, plan, session, silence_s=silence_s, prompts=prompts)
        os.close(keyboard)
        self.terminal.close_writer()
        self._marks.close_writer()

    def listen(self) -> None:
        """Read what came to the terminal and to the log, so that neither is full."""
        self._rig.read_log()
        *lines, self._rest = (self._rest + self.terminal.read()).split(b"\n")
        self._lines += [line.decode(errors="replace") for line in lines if line.strip()]
        self._marked += self._marks.read()

    def told(self) -> list[str]:
        """Whole lines so far."""
        self.listen()
        return self._lines

    def acknowledged(self) -> dict[str, int]:
        """Frames of each stack that the client was told are safe."""
        return {label: count for label, count in map(_acknowledged, self.told()) if label}

    def marks_s(self, event: str) -> list[float]:
        """Monotonic times of an event that the client marks, s."""
        self.listen()
        marks = (line.split() for line in self._marked.decode().splitlines())
        return [float(at_s) for name, at_s in marks if name == event]

    def mark(self, event: str) -> None:
        """Mark an event; for the client itself."""
        os.write(self._marks.writer, f"{event} {time.monotonic():.4f}\n".encode())

    def await_steps(self, timeout_s: float) -> None:
        """Wait until it takes its first step, or has ended."""
        until_s = time.monotonic() + timeout_s
        while self.exit_code() is None and not self.told() and time.monotonic() < until_s:
            time.sleep(0.005)

    def await_prompt(self, timeout_s: float) -> None:
        """Wait until it asks the person at its terminal."""
        until_s = time.monotonic() + timeout_s
        while self.exit_code() is None and time.monotonic() < until_s:
            self.listen()
            if PROMPT in self._rest.decode(errors="replace"):
                return
            time.sleep(0.005)

    def answer(self, line: str) -> None:
        """Type a line."""
        with suppress(OSError):
            os.write(self._typed, line.encode() + b"\n")

    def exit_code(self) -> int | None:
        """Exit code, negative for a signal; None while it runs."""
        if self._status is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self._status = status if pid else None
        return None if self._status is None else os.waitstatus_to_exitcode(self._status)

    def wait(self, timeout_s: float) -> int | None:
        """Wait for its end; None if it did not come in time."""
        until_s = time.monotonic() + timeout_s
        while self.exit_code() is None and time.monotonic() < until_s:
            self.listen()
            time.sleep(0.005)
        return self.exit_code()

    def signal(self, number: signal.Signals) -> None:
        """Send it a signal, if it still runs."""
        if self.exit_code() is None:
            os.kill(self.pid, number)

    def close(self) -> None:
        """Let go of its terminal."""
        self.listen()
        self.terminal.close()
        self._marks.close()
        os.close(self._typed)


def _acknowledged(line: str) -> tuple[str, int]:
    """Label and count of a line "label: n of m frames ..."; an empty label of any other."""
    words = line.split()
    is_count = words[2:3] == ["of"] and words[1].isdigit()
    return (words[0].rstrip(":"), int(words[1])) if is_count else ("", 0)


def _acquire(
    client: Client, rig: CampaignRig, plan: Plan, session: Path, *, silence_s: float, prompts: bool
) -> None:
    """Acquire and end the process; nothing of the parent's may be unwound here."""
    code = 3
    try:
        os.dup2(client.terminal.writer, 1)
        os.dup2(client.terminal.writer, 2)
        # A test runner may have put something else there.
        sys.stdin, sys.stdout = os.fdopen(0), os.fdopen(1, "w", buffering=1)
        sys.stderr = sys.stdout
        client.disk.call_with_every_write(session)
        signal.signal(signal.SIGUSR2, _clock_jumps)
        code = _exit_code(client, rig, plan, session, silence_s=silence_s, prompts=prompts)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 3
    except KeyboardInterrupt:
        code = 128 + signal.SIGINT
    except BaseException as error:  # the campaign counts it as what it is: a traceback
        print(f"TRACEBACK {error!r}", flush=True)
    finally:
        os._exit(code)


def _exit_code(
    client: Client, rig: CampaignRig, plan: Plan, session: Path, *, silence_s: float, prompts: bool
) -> int:
    """Acquire as the command line does, and say on the terminal what it says."""
    bench = open_bench(
        rig.wires,
        limits_in_force(plan.limits, rig.sensor, plan.overrides),
        log=rig.log,
        field_hz=float(rig.sensor.video.field_rate_hz),
        gating=plan.gating,
        dose=DoseLedger(rig.ledger),
        session=str(session),
    )
    try:
        acquire(
            plan,
            session,
            camera=_MarkingCamera(client, rig, silence_s=silence_s),
            bench=bench,
            operator=_Person(rig.operator) if prompts else _Hands(rig.operator),
            judge=SaturationJudge(),
            resume=(session / PLAN).exists(),
            progress=lambda sentence, share: print(sentence, flush=True),
            requests=RunControl(print),
        )
    except (BadInput, BenchError) as error:
        print(error, flush=True)
        return 1
    finally:
        if bench.last_words:
            print(f"{LAST_WORDS} {bench.last_words}.", flush=True)
    return 0


class _Hands:
    """Hands that set the light; they need no disk, so that one that fails says nothing of how a run
    would end.
    """

    is_by_hand = False

    def __init__(self, hands: Operator) -> None:
        self._hands = hands
        self.while_waiting: Callable[[], None] = lambda: None

    def darken(self) -> None:
        with suppress(OSError):
            self._hands.darken()

    def place(self, **asked: Any) -> Conditions:
        with suppress(OSError):
            return self._hands.place(**asked)
        return Conditions(illuminance_lux=asked["illuminance_lux"])


class _Person(PromptingOperator):
    """Whoever is asked at the terminal, and really sets the light."""

    def __init__(self, hands: Operator) -> None:
        super().__init__()
        self._hands = hands

    def darken(self) -> None:
        super().darken()
        self._hands.darken()

    def place(self, **asked: Any) -> Conditions:
        read = super().place(**asked)
        self._hands.place(**asked)
        return read


class _MarkingCamera(AravisCamera):
    """A camera whose client marks when frames are asked for, when one comes, and when one is
    saturated, at its own ceiling where that is below the camera's.
    """

    def __init__(self, client: Client, rig: CampaignRig, *, silence_s: float) -> None:
        super().__init__(rig.wires.camera, silence_s=silence_s)
        self._client, self._full_dn = client, 2**rig.sensor.video.bit_depth - 1

    def capture(
        self, *, frames: int, discard: int = 0, while_waiting: Callable[[], None] = lambda: None
    ) -> Any:
        self._client.mark("asked")
        capture = super().capture(frames=frames, discard=discard, while_waiting=while_waiting)
        return _MarkingCapture(capture, self._client, self._full_dn)


class _MarkingCapture:
    """A capture that looks at each frame before it hands it on."""

    def __init__(self, capture: Any, client: Client, full_dn: int) -> None:
        self._capture, self._client, self._full_dn = capture, client, full_dn

    def __enter__(self) -> Self:
        self._capture.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._capture.__exit__(kind, error, trace)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._capture, name)

    def __iter__(self) -> Iterator[Frame]:
        for frame in self._capture:
            self._client.camera.call()
            ceiling_dn = min(self._full_dn, frame.pixels.max())
            if np.count_nonzero(frame.pixels >= ceiling_dn) > SATURATED * frame.pixels.size:
                self._client.mark("saturated")
            self._client.mark("frame")
            yield frame


def _clock_jumps(*_: object) -> None:
    """The clock of the day jumps, as when a time server corrects it; monotonic time does not."""
    now = time.time
    time.time = lambda: now() + CLOCK_JUMP_S
