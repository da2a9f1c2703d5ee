"""A client of the campaign: a process of its own that acquires, forked from one that has imported everything."""

import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

from charact.cli.judge import SaturationJudge
from drivers.acquisition.acquire import acquire
from drivers.acquisition.run_start import PLAN
from drivers.bench.setup import open_bench
from drivers.cameras.aravis.camera import AravisCamera
from drivers.cameras.aravis.capture import AravisCapture
from drivers.errors import BenchError
from labdata.errors import BadInput
from labdata.limits import limits_in_force
from labdata.plan import Plan
from tests.faults.campaign.rig import CampaignRig

CLOCK_JUMP_S = 7200.0
ASKED = "frames are asked for at "


class Client:
    """An acquiring process, and what it has told.

    Parameters
    ----------
    rig
        The bench.
    plan, session
        What to take, and where to.
    silence_s
        How long its camera may be silent, s.
    """

    def __init__(self, rig: CampaignRig, plan: Plan, session: Path, *, silence_s: float) -> None:
        self._told = session.with_name(f"{session.name}.told")
        self._told.write_text("")
        self.began_s = time.monotonic()
        self._status: int | None = None
        self.pid = os.fork()
        if not self.pid:
            _acquire(rig, plan, session, silence_s=silence_s, told=self._told)

    def await_steps(self, timeout_s: float) -> None:
        """Wait until it takes its first step, or has ended."""
        until_s = time.monotonic() + timeout_s
        while self.exit_code() is None and not self.told() and time.monotonic() < until_s:
            time.sleep(0.005)

    def told(self) -> list[str]:
        """Whole lines so far."""
        text = self._told.read_text()
        return text[: text.rfind("\n") + 1].splitlines()

    def acknowledged(self) -> dict[str, int]:
        """Frames of each stack that the client was told are safe."""
        return {label: count for label, count in map(_acknowledged, self.told()) if label}

    def frames_due_s(self, since_s: float) -> float:
        """When frames were first asked for after a monotonic time, s; that time where they never were again."""
        asked = (float(line.removeprefix(ASKED)) for line in self.told() if line.startswith(ASKED))
        return next((at_s for at_s in asked if at_s > since_s), since_s)

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
            time.sleep(0.005)
        return self.exit_code()

    def signal(self, number: signal.Signals) -> None:
        """Send it a signal, if it still runs."""
        if self.exit_code() is None:
            os.kill(self.pid, number)


def _acknowledged(line: str) -> tuple[str, int]:
    """Label and count of a line "label: n of m frames ..."; an empty label of any other."""
    words = line.split()
    return (words[0].rstrip(":"), int(words[1])) if words[2:3] == ["of"] else ("", 0)


def _acquire(rig: CampaignRig, plan: Plan, session: Path, *, silence_s: float, told: Path) -> None:
    """Acquire and end the process; nothing of the parent's may be unwound here."""
    code = 3
    try:
        file = told.open("a", buffering=1)
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
        sys.stdout = sys.stderr = file  # a test runner may have put something else there
        signal.signal(signal.SIGUSR2, _clock_jumps)
        code = _exit_code(rig, plan, session, silence_s)
    except BaseException as error:  # the campaign counts it as what it is: a traceback
        print(f"TRACEBACK {error!r}", flush=True)
    finally:
        os._exit(code)


def _exit_code(rig: CampaignRig, plan: Plan, session: Path, silence_s: float) -> int:
    try:
        acquire(
            plan,
            session,
            camera=_TellingCamera(rig.wires.camera, silence_s=silence_s),
            bench=open_bench(
                rig.wires,
                limits_in_force(plan.limits, rig.sensor, plan.overrides),
                log=rig.watchdog_log,
                gate_hz=float(rig.sensor.video.field_rate_hz),
            ),
            operator=rig.operator,
            judge=SaturationJudge(),
            resume=(session / PLAN).exists(),
            progress=lambda sentence, share: print(sentence, flush=True),
        )
    except (BadInput, BenchError) as error:
        print(error, flush=True)
        return 1
    return 0


class _TellingCamera(AravisCamera):
    """A camera that tells when frames are asked of it."""

    def capture(
        self, *, frames: int, discard: int = 0, while_waiting: Callable[[], None] = lambda: None
    ) -> AravisCapture:
        print(f"{ASKED}{time.monotonic():.4f}", flush=True)
        return super().capture(frames=frames, discard=discard, while_waiting=while_waiting)


def _clock_jumps(*_: object) -> None:
    """The clock of the day jumps, as when a time server corrects it; monotonic time does not."""
    now = time.time
    time.time = lambda: now() + CLOCK_JUMP_S
