"""One program of faults: a forked client takes a plan over the emulated instruments, and the tube
is watched.
"""

import ctypes
import json
import mmap
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.studies.faults.inventing.emulator import GATE, OUTPUTS, SUPPLY, serve
from benchmarks.studies.faults.inventing.faults import CAMERA_KINDS, INSTRUMENTS, RULE, RULES, Fault
from drivers import acquire
from drivers.acquisition.run_control import RunControl
from drivers.bench.local_bench import open_bench
from drivers.cameras.frame_assembly import FrameCapture, IncompleteFrame
from drivers.errors import BenchError, CameraError
from labdata import (
    BadInput,
    CameraSettings,
    Conditions,
    DoseLedger,
    Frame,
    InstrumentConfig,
    Limits,
    Plan,
    Step,
    open_session,
)

LIMIT_S, SLACK_S = 2.0, 2.5  # Longest time hot, and what delays of system calls add at most
SILENCE_S, PERIOD_S = 0.5, 1.0 / 60.0
END_S, LOOK_S = 45.0, 3e-3
SIZE = (64, 96)
# Offsets in the shared memory
FRAME_S, FLAGS, SERVER, SLACK = OUTPUTS.size, OUTPUTS.size + 8, 1024, 1032
ASKED = Conditions(mcp_v=650.0, gate_ns=1.6e7)
PLAN = Plan(
    name="invented",
    steps=(
        Step(label="dark", kind="dark", frames=40, conditions=ASKED),
        Step(
            label="flat",
            kind="flat",
            frames=100,
            conditions=Conditions(mcp_v=720.0, gate_ns=1.6e7, illuminance_lux=1e-5),
        ),
    ),
)
SIGNALS = {"killed": signal.SIGKILL, "stopped": signal.SIGSTOP, "terminated": signal.SIGTERM}


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What became of a program: the longest times that gate and voltage were on though they had to
    be off, s, by what time the machine and slowed system calls explain more than `LIMIT_S`, s, what
    broke, and whether nobody was left to act.
    """

    hot_s: dict[str, float]
    slack_s: float
    broken: tuple[str, ...]
    beyond_software: bool
    ended: str


class Watch:
    """Outputs of the instruments, and how long each was on though it had to be off and could
    hear.
    """

    def __init__(self, program: tuple[Fault, ...], shared: mmap.mmap) -> None:
        self._program, self._shared = program, shared
        self.hot_s = dict.fromkeys(INSTRUMENTS, 0.0)
        self._since_s = dict.fromkeys(INSTRUMENTS, 0.0)
        self.late_s, self._looked_s = 0.0, time.monotonic()

    def look(self, at_s: float, *, guarded: bool, is_dangerous: bool) -> bool:
        """Take the outputs at a time of the program; return whether one of them is on."""
        now_s = time.monotonic()
        self.late_s = max(self.late_s, now_s - self._looked_s - LOOK_S)
        self._looked_s = now_s
        gate_on, voltage_on, changed, volts, _ = OUTPUTS.unpack_from(self._shared, 0)
        frame_s = np.frombuffer(self._shared, float, 1, FRAME_S)[0]
        flagged = any(self._shared[FLAGS + place] for place in range(len(CAMERA_KINDS)))
        silent = gate_on and now_s - frame_s > LIMIT_S
        must_be_off = is_dangerous or changed or silent or (gate_on and flagged)
        for who, is_on in ((GATE, gate_on), (SUPPLY, voltage_on and volts > 15.0)):
            hears = not any(
                fault.deafens(who) and fault.at_s <= at_s <= fault.over_s + fault.delay_s
                for fault in self._program
            )
            if not (is_on and must_be_off and hears and guarded):
                self._since_s[who] = now_s
            self.hot_s[who] = max(self.hot_s[who], now_s - self._since_s[who])
        return gate_on or voltage_on


def try_program(program: tuple[Fault, ...], folder: Path, shim: str | None, seed: int) -> Verdict:
    """Run the plan, have the faults happen and heal, and judge what became of the tube."""
    (folder / "ports").mkdir(parents=True)
    (folder / "disk").mkdir()
    rules = folder / "rules"
    rules.write_bytes(bytes(RULE.size * RULES))
    shared = mmap.mmap(-1, mmap.PAGESIZE)
    ours, theirs = socket.socketpair()
    parent = os.getpid()
    emulator = _fork(lambda: serve(folder / "ports", shared, theirs.fileno(), parent, seed))
    while not OUTPUTS.unpack_from(shared, 0)[-1]:
        time.sleep(0.01)
    client = _fork(lambda: _acquire(folder, shared, shim))
    try:
        return _Trial(program, folder, shared, ours, client, rules).judge()
    finally:
        for pid in (client, emulator):
            _reap(pid, kill=True)
        ours.close()
        theirs.close()
        shutil.rmtree(folder, ignore_errors=True)


def _fork(work: Callable[[], object]) -> int:
    if not (pid := os.fork()):
        try:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            work()
        finally:
            os._exit(3)
    return pid


def _reap(pid: int, *, kill: bool = False) -> bool:
    """Whether a child has ended."""
    try:
        if kill:
            os.kill(pid, signal.SIGKILL)
        return bool(os.waitpid(pid, 0 if kill else os.WNOHANG)[0])
    except (ChildProcessError, ProcessLookupError):
        return True


class _Trial:
    def __init__(
        self,
        program: tuple[Fault, ...],
        folder: Path,
        shared: mmap.mmap,
        control: socket.socket,
        client: int,
        rules: Path,
    ) -> None:
        self._program, self._folder, self._shared = program, folder, shared
        self._control, self._client, self._rules = control, client, rules
        self._output = folder / "client.txt"
        self._client_ended = False
        self._server: int | None = None
        self._beyond = False

    def judge(self) -> Verdict:
        """Watch until everything has ended."""
        watch = Watch(self._program, self._shared)
        due = [(fault.at_s, True, fault) for fault in self._program]
        due += [(fault.over_s, False, fault) for fault in self._program]
        due.sort(key=lambda each: each[0])
        opened_s = time.monotonic()
        began_s: float | None = None
        over_s = opened_s + END_S
        while time.monotonic() < over_s:
            now_s = time.monotonic()
            if began_s is None and (self._has_begun() or now_s > opened_s + 20.0):
                began_s = now_s
            # Faults before the first step fall into the opening, which takes about a second.
            at_s = now_s - opened_s - 1.5 if began_s is None else max(0.0, now_s - began_s)
            while due and due[0][0] <= at_s:
                _, strikes, fault = due.pop(0)
                self._happen(fault, strikes)
            self._client_ended = self._client_ended or _reap(self._client)
            lives = self._lives(at_s)
            is_on = watch.look(
                at_s, guarded=any(lives.values()), is_dangerous=not all(lives.values())
            )
            if not any(lives.values()) and is_on and not due:
                self._beyond = True
            if self._client_ended and not self._server_runs() and not due:
                break
            time.sleep(LOOK_S)
        return self._verdict(watch)

    def _has_begun(self) -> bool:
        return self._output.exists() and b" frames" in self._output.read_bytes()

    def _server_runs(self) -> bool:
        # Not by its log, whose first line a fault may keep from the disk.
        self._server = int(np.frombuffer(self._shared, np.int32, 1, SERVER)[0]) or None
        if self._server is None:
            return False
        try:
            status = Path(f"/proc/{self._server}/stat").read_text().rpartition(")")[2].split()[0]
            return status != "Z"
        except OSError:
            return False

    def _lives(self, at_s: float) -> dict[str, bool]:
        """Which process can act now."""
        runs = {"client": not self._client_ended, "server": self._server_runs()}
        hindered = {
            fault.who
            for fault in self._program
            if fault.hinders and fault.at_s <= at_s <= fault.over_s + fault.delay_s
        }
        return {process: alive and process not in hindered for process, alive in runs.items()}

    def _happen(self, fault: Fault, strikes: bool) -> None:
        pid = self._client if fault.who == "client" else self._server
        if fault.kind in SIGNALS:
            number = SIGNALS[fault.kind] if strikes else signal.SIGCONT
            if pid is not None and not (fault.who == "client" and self._client_ended):
                try:
                    os.kill(pid, number)
                except ProcessLookupError:
                    return
        elif fault.who == "camera":
            self._shared[FLAGS + CAMERA_KINDS.index(fault.kind)] = int(strikes)
        elif fault.kind == "call":
            rule = (("client", "server").index(fault.who) + 1, *fault.value)
            with self._rules.open("r+b") as file:
                file.seek(RULE.size * self._program.index(fault))
                file.write(RULE.pack(*(rule if strikes else [0] * 6)))
        elif fault.kind != "panel" or strikes:
            message = [fault.who, fault.kind, fault.value if strikes else None]
            self._control.send(json.dumps(message).encode() + b"\n")

    def _verdict(self, watch: Watch) -> Verdict:
        lines = self._output.read_text().splitlines() if self._output.exists() else []
        # By what the bench itself measured in this run and granted, see `SchedulingDelay`, by how
        # late this judge looked, and by what each order costs where its calls are slowed
        slowed_s = max((fault.delay_s for fault in self._program), default=0.0)
        granted_s = float(np.frombuffer(self._shared, float, 1, SLACK)[0])
        slack_s = max(granted_s, watch.late_s, min(SLACK_S, 4.0 * slowed_s))
        broken = [
            f"{who} on for {seconds:.2f} s, of which the machine explains {slack_s:.2f} s"
            for who, seconds in watch.hot_s.items()
            if seconds > LIMIT_S + slack_s
        ]
        if not self._client_ended:
            broken.append("the client did not end")
        if self._server_runs():
            broken.append("the server did not end")
            os.kill(self._server or 0, signal.SIGKILL)
        if any(line.startswith("TRACEBACK") for line in lines):
            broken.append(f"traceback: {lines[-1]}")
        return Verdict(
            hot_s=watch.hot_s,
            slack_s=slack_s,
            broken=(*broken, *self._frames_broken(lines)),
            beyond_software=self._beyond,
            ended=lines[-1] if lines else "",
        )

    def _frames_broken(self, lines: list[str]) -> list[str]:
        """What is wrong with the frames that the client was told are on the disk."""
        counts = {words[0]: int(words[1]) for words in map(str.split, lines) if _counts(words)}
        broken = []
        for label, count in counts.items():
            try:
                entry = open_session(self._folder / "disk/s").stack(label[:-1])
                frames = entry.read().data
            except (KeyError, OSError, BadInput) as error:
                broken += [f"frames of {label} are lost: {error}"] * bool(count)
                continue
            if len(frames) < count:
                broken.append(f"{count} frames of {label} acknowledged, {len(frames)} there")
            is_noted = any("equal an earlier one" in note for note in entry.notes)
            if len({frame.tobytes() for frame in frames}) < len(frames) and not is_noted:
                broken.append(f"a frame of {label} is there twice")
        return broken


def _counts(words: list[str]) -> bool:
    return words[2:3] == ["of"] and words[0].endswith(":")


# In the client


def _acquire(folder: Path, shared: mmap.mmap, shim: str | None) -> None:
    output = os.open(folder / "client.txt", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(output, 1)
    os.dup2(output, 2)
    sys.stdout = sys.stderr = os.fdopen(1, "w", buffering=1)
    if shim is not None:
        ctypes.CDLL(shim).inject_begin(os.fsencode(folder / "rules"), 1)
        os.environ |= {"INJECT_FILE": str(folder / "rules"), "INJECT_ROLE": "2"}
    popen = subprocess.Popen

    def begin(*asked: Any, **named: Any) -> subprocess.Popen:
        process = popen(*asked, **named)
        np.frombuffer(shared, np.int32, 1, SERVER)[0] = process.pid
        return process

    subprocess.Popen = begin  # type: ignore[misc]
    wires = InstrumentConfig(
        gate_port=str(folder / "ports" / GATE), supply_port=str(folder / "ports" / SUPPLY)
    )
    bench = open_bench(
        wires,
        Limits(ramp_v_per_s=4000.0),
        log=folder / "disk/safety.jsonl",
        dose=DoseLedger(folder / "disk/dose.jsonl"),
    )
    code = 0
    threading.Thread(target=_tell_slack, args=(bench, shared), daemon=True).start()
    try:
        acquire(
            PLAN,
            folder / "disk/s",
            camera=_Camera(shared),
            bench=bench,
            operator=_Hands(),
            progress=lambda sentence, fraction: print(sentence, flush=True),
            requests=RunControl(print),
        )
    except (BadInput, BenchError, OSError) as error:
        print(f"ENDED {error}", flush=True)
        code = 1
    except SystemExit:
        code = 2
    except BaseException as error:
        print(f"TRACEBACK {error!r}", flush=True)
    os._exit(code)


def _tell_slack(bench: Any, shared: mmap.mmap) -> None:
    """Keep the longest time by which the limits of a bench grew, s."""
    slack_s = np.frombuffer(shared, float, 1, SLACK)
    while True:
        time.sleep(0.02)
        if hasattr(bench, "_delay"):  # once it is open
            slack_s[0] = max(slack_s[0], bench.slack_s())


class _Hands:
    """Who sets the light at once."""

    is_by_hand = False

    def __init__(self) -> None:
        self.while_waiting: Callable[[], None] = lambda: None

    def darken(self) -> None:
        pass

    def place(self, **asked: Any) -> Conditions:
        return Conditions(illuminance_lux=asked["illuminance_lux"])


class _Camera:
    """A camera that sees gate, voltage and light, with its faults in the shared memory."""

    identifier = "invented"

    def __init__(self, shared: mmap.mmap) -> None:
        self._shared = shared
        self._settings = CameraSettings(
            rows=SIZE[0],
            columns=SIZE[1],
            pixel_format="Mono8",
            exposure_s=0.0166,
            gain_db=0.0,
            frame_rate_hz=60.0,
        )

    def __enter__(self) -> "_Camera":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def configure(self, settings: CameraSettings) -> CameraSettings:
        return self._settings

    def capture(self, **asked: Any) -> "_Capture":
        return _Capture(self._shared, identifier=self.identifier, patience_s=SILENCE_S, **asked)


class _Capture(FrameCapture):
    _number = 0
    _rng = np.random.default_rng(5)
    _pixels = _rng.normal(12.0, 1.5, SIZE).astype(np.uint8)

    def __init__(self, shared: mmap.mmap, **asked: Any) -> None:
        super().__init__(**asked)
        self._shared = shared

    def _has(self, kind: str) -> bool:
        return bool(self._shared[FLAGS + CAMERA_KINDS.index(kind)])

    def _next_frame(self) -> Frame | IncompleteFrame:
        began_s = time.monotonic()
        time.sleep(PERIOD_S)
        while self._has("hangs"):
            time.sleep(0.01)
        while self._has("stalled"):
            self._while_waiting()
            if time.monotonic() > began_s + SILENCE_S:
                raise CameraError(f"the camera has sent no frame for {SILENCE_S:g} s")
            time.sleep(0.02)
        _Capture._number += 1
        if self._has("broken"):
            return IncompleteFrame(number=self._number, fault="missing packets")
        gate_on, _, _, volts, _ = OUTPUTS.unpack_from(self._shared, 0)
        if not self._has("repeats"):
            light = (200 if self._has("room light") else 20) * (gate_on and volts > 100.0)
            noise = self._rng.normal(12.0 + 2.0 * light, 1.5, SIZE)
            _Capture._pixels = noise.clip(0, 255).astype(np.uint8)
        np.frombuffer(self._shared, float, 1, FRAME_S)[0] = time.monotonic()
        return Frame(pixels=self._pixels.copy(), number=self._number, time_s=time.monotonic())
