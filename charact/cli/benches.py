"""Bench of a plan: virtual instruments, or real ports, camera and a person who serves them.

The tube may be on while the person or the terminal (Ctrl-S) is slow: no wait is longer than 0.1 s
without a call of `while_waiting`.
"""

import os
import select
import shutil
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from charact.cli.output import Progress, print_message
from charact.cli.outputs import remove_session
from labdata import BadInput, Conditions, Kind, Plan, Session, Target, has_tube
from labdata.tube_dose import warnings

if TYPE_CHECKING:
    from drivers.acquisition.run import Predict
    from drivers.interface import Camera
    from simulate.virtual_bench.bench import VirtualBench
    from simulate.virtual_bench.rehearsal import FaultScript

POLL_S = 0.1
"""Longest wait between two calls of `while_waiting`, s."""


def acquire_session(
    plan: Plan,
    session: Path,
    *,
    resume: bool,
    progress: Progress,
    tell: Callable[[str], None] = print_message,
    inject_faults: "FaultScript | None" = None,
    time_scale: float = 1.0,
) -> Session:
    """Run a plan on its bench and return the session.

    `inject_faults`: faults to inject into a virtual bench; `time_scale`: how many times faster than
    real ones the instruments of a virtual bench move.
    """
    from charact.live.judge import SaturationJudge
    from drivers import acquire, bench_of
    from drivers.acquisition.acquire import dose_ledger
    from drivers.acquisition.run_control import RunControl
    from drivers.errors import BenchError

    real = plan.wires.bench == "real"
    if real and inject_faults is not None:
        raise BadInput("fault injection needs a virtual bench, got a real one")
    try:
        with ExitStack() as running:
            rig: dict[str, Any] = (
                {
                    "bench": bench_of(plan, session),
                    "operator": PromptingOperator() if plan.lamp is None else TargetPlacer(),
                }
                if real
                else _virtual_rig(plan, session, inject_faults, time_scale, tell, running)
            )
            try:
                acquired = acquire(
                    plan,
                    session,
                    **rig,
                    judge=SaturationJudge(),
                    predict=_level_predictor(plan),
                    resume=resume,
                    progress=progress,
                    requests=RunControl(tell),
                )
            finally:
                if rig["bench"].last_words:
                    tell(f"The tube: {rig['bench'].last_words}.")
    except BenchError as error:
        raise BadInput(str(error)) from error
    sensor = acquired.camera if has_tube(acquired.camera) else None
    for sentence in warnings(dose_ledger(plan, session).total(), sensor):
        tell(sentence)
    return acquired


def _level_predictor(plan: Plan) -> "Predict | None":
    """Return the level of evenly lit pixels above black, DN, by the description of the plan's tube;
    None without one, or with a gamma.
    """
    from labdata.sensors import load_sensor
    from simulate.camera import tube_photometry
    from simulate.camera.camera import CameraModel
    from simulate.camera.chain import Slot
    from simulate.camera.moments import PulseMoments

    sensor = None if plan.sensor is None else load_sensor(plan.sensor)
    if not has_tube(sensor) or float(sensor.video.gamma) != 1.0:
        return None
    camera = CameraModel(sensor)
    gain_dn_per_e = float(sensor.video.conversion_gain_dn_per_e)
    electrons_per_lux_s = tube_photometry.photoelectrons_per_lumen_s(sensor) * 1e-4
    electrons_per_lux_s *= camera.field_pixel_area_cm2
    ebi_lux = float(sensor.photocathode.ebi_lm_per_cm2) * 1e4

    def predict(conditions: Conditions) -> float:
        open_s = camera.stage(Slot.PHOTOCATHODE, conditions).open_s
        gain_dn = PulseMoments(camera.chain(conditions)).gain_e * gain_dn_per_e
        gain_dn *= 10.0 ** ((conditions.camera_gain_db or 0.0) / 20.0)
        lux = (conditions.illuminance_lux or 0.0) + ebi_lux
        return gain_dn * electrons_per_lux_s * open_s * lux

    predict(Conditions())  # compiles what the run must not wait for
    return predict


def remove_run(plan: Plan, session: Path) -> None:
    """Delete the session of an earlier run and its virtual bench, after the check of the plan that
    replaces it.
    """
    from drivers import plan_report
    from drivers.acquisition.acquire import bench_folder
    from simulate.virtual_bench.true_sensor import TRUTH

    plan_report(plan, session)
    remove_session(session, "plan")
    if (bench_folder(session) / TRUTH).is_dir():
        shutil.rmtree(bench_folder(session))


def _virtual_rig(
    plan: Plan,
    session: Path,
    script: "FaultScript | None",
    time_scale: float,
    tell: Callable[[str], None],
    running: ExitStack,
) -> dict[str, Any]:
    """Start virtual instruments, with the faults of a script, and return bench, camera and
    operator.
    """
    from drivers.acquisition.acquire import LOG, SAFETY_LOG, bench_folder, bench_of
    from drivers.instruments.models import lines_on
    from labdata.sensors import load_sensor
    from simulate.virtual_bench.bench import VirtualBench
    from simulate.virtual_bench.instrument import LINE_HZ
    from simulate.virtual_bench.rehearsal import Rehearsal

    if plan.sensor is None:
        raise BadInput("a plan for the virtual bench must name its sensor, got none")
    if plan.gating.sync == "line-locked" and plan.gating.line_hz != LINE_HZ:
        raise BadInput(
            f"the mains frequency of the virtual bench must be {LINE_HZ:g} Hz, got "
            f"{plan.gating.line_hz:g}"
        )
    folder = bench_folder(session)
    virtual = running.enter_context(
        VirtualBench(
            folder,
            load_sensor(plan.sensor),
            plan.seed,
            wires=plan.wires,
            lamp=plan.lamp,
            time_scale=time_scale,
            say=tell,
        )
    )
    if script is not None:
        log = folder / "rehearsal.jsonl"
        running.enter_context(
            Rehearsal(script, provoke=virtual.provoke, steps=session / LOG, log=log, say=tell)
        )
    session.parent.mkdir(parents=True, exist_ok=True)
    lines = None if virtual.inside is None else lines_on(virtual.inside.ports, virtual.wires)
    log = folder / SAFETY_LOG
    return {
        "bench": bench_of(plan, session, wires=virtual.wires, log=log, lines=lines),
        "camera": _virtual_camera(plan, virtual, tell),
        "operator": virtual.operator,
    }


def _virtual_camera(
    plan: Plan, virtual: "VirtualBench", tell: Callable[[str], None]
) -> "AbstractContextManager[Camera]":
    """Return the camera that the plan names, else that of the virtual bench."""
    if plan.wires.camera is not None:
        from drivers.cameras import camera_named

        return camera_named(plan.wires.camera, say=tell)
    if virtual.camera is None:
        return virtual.in_process_camera()
    from drivers.cameras.aravis.camera import AravisCamera

    return AravisCamera(virtual.camera.identifier, silence_s=virtual.silence_s, say=tell)


class _Terminal:
    """Prompts on stderr and answers from stdin, polled."""

    def __init__(self) -> None:
        self.while_waiting: Callable[[], None] = lambda: None
        """Called every 0.1 s during a prompt; an exception ends the prompt."""
        self._typed = b""

    def _show(self, text: str) -> None:
        """Write a text if the terminal is ready."""
        descriptor = _descriptor(sys.stderr)
        if descriptor is None:
            print(text, end="", file=sys.stderr, flush=True)
        elif select.select((), (descriptor,), (), 0.0)[1]:
            os.write(descriptor, text.encode())

    def _answer(self, question: str, purpose: str) -> str:
        """Write a question and return the answer; the end of the input raises BadInput."""
        descriptor = _descriptor(sys.stderr)
        while descriptor is not None and not select.select((), (descriptor,), (), POLL_S)[1]:
            self.while_waiting()
        self._show(question)
        descriptor = _descriptor(sys.stdin)
        line = "" if descriptor is None else self._line_of(descriptor)
        if not line:
            raise BadInput(
                f"a person must answer {purpose}, got the end of the input; run it on a terminal"
            )
        return line.strip()

    def _line_of(self, descriptor: int) -> str:
        """Return the next line of a descriptor; further input is kept for the next question."""
        while b"\n" not in self._typed:
            if not select.select((descriptor,), (), (), POLL_S)[0]:
                self.while_waiting()
                continue
            try:
                more = os.read(descriptor, 4096)
            except OSError:  # the terminal was closed
                more = b""
            if not more:
                line, self._typed = self._typed, b""
                return line.decode(errors="replace")
            self._typed += more
        line, _, self._typed = self._typed.partition(b"\n")
        return (line + b"\n").decode(errors="replace")


class PromptingOperator(_Terminal):
    """Asks a person to place targets, to set the light and to read the light meter."""

    is_by_hand = True
    """Whether a person sets the light."""

    def darken(self) -> None:
        """Ask for the light to be blocked, without waiting."""
        self._show("Block the light now.\n")

    def place(
        self,
        *,
        kind: Kind,
        target: Target,
        illuminance_lux: float,
        filter_density: float | None = None,
    ) -> Conditions:
        """Ask for a target, a filter and an illuminance; return the reading of the light meter."""
        if illuminance_lux == 0.0:
            self.darken()
            return Conditions(illuminance_lux=0.0)
        behind = "" if filter_density is None else f" behind a filter of density {filter_density:g}"
        answer = self._answer(
            f"Place the {_words(kind, target)}; set {illuminance_lux:g} lux{behind}.\n"
            "What does the meter read, in lux? ",
            "what the meter reads",
        )
        try:
            return Conditions(illuminance_lux=float(answer), filter_density=filter_density)
        except ValueError:
            raise BadInput(f"the meter's reading must be a number in lux, got {answer!r}") from None


class TargetPlacer(_Terminal):
    """Asks a person to place targets; the bench controls the lamp."""

    is_by_hand = False
    """Whether a person sets the light."""

    def __init__(self) -> None:
        super().__init__()
        self._placed: tuple[Kind, Target] | None = None

    def darken(self) -> None:
        """Do nothing: the bench switches its lamp off."""

    def place(
        self,
        *,
        kind: Kind,
        target: Target,
        illuminance_lux: float,
        filter_density: float | None = None,
    ) -> Conditions:
        """Ask for a new target and wait until it is placed; a dark needs none."""
        if kind != "dark" and (kind, target) != self._placed:
            self._answer(
                f"Place the {_words(kind, target)}, then press Enter. ",
                f"once the {kind} target is placed",
            )
            self._placed = (kind, target)
        return Conditions(illuminance_lux=0.0)


def _descriptor(stream: object) -> int | None:
    """Return the descriptor of a stream, or None."""
    try:
        return stream.fileno()  # pyright: ignore[reportAttributeAccessIssue]
    except (AttributeError, OSError, ValueError):
        return None


def _words(kind: Kind, target: Target) -> str:
    details = ", ".join(
        f"{name} {value}" for name, value in vars(target).items() if value is not None
    )
    return f"{kind} target ({details or 'no details'})"
