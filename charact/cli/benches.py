"""Bench of a plan: virtual instruments, or real ports, camera and operator."""

import math
import os
import shutil
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from charact.cli.output import Progress, print_message
from charact.cli.outputs import remove_session
from labdata.camera.description import Camera
from labdata.errors import BadInput
from labdata.instrument_config import InstrumentConfig, Role
from labdata.limits import limits_in_force
from labdata.plan import Plan, Step
from labdata.plan_file import plan_of, read_plan
from labdata.serialiser import read_toml
from labdata.session import Session
from labdata.tube_dose import DoseLedger, ledger_of, warnings

if TYPE_CHECKING:
    from drivers.bench.client import BenchClient
    from drivers.bench.local_bench import LocalBench
    from drivers.interface import Camera, Operator
    from drivers.serial_lines.line import InstrumentLine
    from simulate.virtual_bench.bench import VirtualBench
    from simulate.virtual_bench.rehearsal import FaultScript


SAFETY_LOG = "safety.jsonl"
DOSE = "dose.jsonl"


def bench_folder(session: Path) -> Path:
    """Folder of the virtual bench of a session, next to the session folder."""
    return session.with_name(session.name + ".bench")


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
    from drivers.errors import BenchError

    real = plan.wires.bench == "real"
    if real and inject_faults is not None:
        raise BadInput("fault injection needs a virtual bench, got a real one")
    run: dict[str, Any] = {"tell": tell, "resume": resume, "progress": progress}
    try:
        if real:
            taken = _on_real_bench(plan, session, **run)
        else:
            taken = _on_virtual_bench(plan, session, inject_faults, time_scale, **run)
    except BenchError as error:
        raise BadInput(str(error)) from error
    for sentence in warnings(_ledger(plan, session).total(), taken.sensor):
        tell(sentence)
    return taken


def remove_run(plan: Plan, session: Path) -> None:
    """Delete the session of an earlier run and its virtual bench, after the check of the plan that
    replaces it.
    """
    from drivers.acquisition.plan_check import check_plan
    from labdata.plan import in_volts
    from labdata.sensors import load_sensor
    from simulate.virtual_bench.true_sensor import TRUTH

    sensor = None if plan.sensor is None else load_sensor(plan.sensor)
    check_plan(in_volts(plan, sensor), session, sensor)
    remove_session(session, "plan")
    if (bench_folder(session) / TRUTH).is_dir():
        shutil.rmtree(bench_folder(session))


def _ledger(plan: Plan, session: Path) -> DoseLedger:
    """Return the dose ledger of the plan's tube; that of an unnamed tube is a file next to the
    session.
    """
    if plan.tube is not None:
        return ledger_of(plan.tube)
    real = plan.wires.bench == "real"
    return DoseLedger(
        session.with_name(f"{session.name}.{DOSE}") if real else bench_folder(session) / DOSE
    )


def _on_virtual_bench(
    plan: Plan,
    session: Path,
    script: "FaultScript | None",
    time_scale: float,
    tell: Callable[[str], None],
    **run: Any,
) -> Session:
    """Run a plan on virtual instruments, with the faults of a script."""
    from drivers.acquisition.acquire import LOG
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
    sensor, folder = load_sensor(plan.sensor), bench_folder(session)
    with ExitStack() as stack:
        virtual = stack.enter_context(
            VirtualBench(
                folder,
                sensor,
                plan.seed,
                wires=plan.wires,
                lamp=plan.lamp,
                time_scale=time_scale,
                say=tell,
            )
        )
        if script is not None:
            log = folder / "rehearsal.jsonl"
            stack.enter_context(
                Rehearsal(script, provoke=virtual.provoke, steps=session / LOG, log=log, say=tell)
            )
        session.parent.mkdir(parents=True, exist_ok=True)
        lines = None if virtual.inside is None else lines_on(virtual.inside.ports, virtual.wires)
        bench = _bench(
            plan, session, sensor, wires=virtual.wires, log=folder / SAFETY_LOG, lines=lines
        )
        return _run(
            plan,
            session,
            _virtual_camera(plan, virtual, tell),
            bench,
            virtual.operator,
            tell,
            **run,
        )


def _virtual_camera(
    plan: Plan, virtual: "VirtualBench", tell: Callable[[str], None]
) -> "AbstractContextManager[Camera]":
    """Return the camera that the plan names, else that of the virtual bench."""
    if plan.wires.camera is not None:
        return camera_named(plan.wires.camera, tell=tell)
    if virtual.camera is None:
        return virtual.in_process_camera()
    from drivers.cameras.aravis.camera import AravisCamera

    return AravisCamera(virtual.camera.identifier, silence_s=virtual.silence_s, say=tell)


def _on_real_bench(plan: Plan, session: Path, tell: Callable[[str], None], **run: Any) -> Session:
    from charact.cli.prompting import PromptingOperator, TargetPlacer
    from labdata.sensors import load_sensor

    sensor = None if plan.sensor is None else load_sensor(plan.sensor)
    camera = camera_named(plan.wires.camera, tell=tell)
    bench = _bench(
        plan,
        session,
        sensor,
        wires=plan.wires,
        log=session.with_name(f"{session.name}.{SAFETY_LOG}"),
    )
    return _run(
        plan,
        session,
        camera,
        bench,
        PromptingOperator() if plan.lamp is None else TargetPlacer(),
        tell,
        **run,
    )


def _bench(
    plan: Plan,
    session: Path,
    sensor: Camera | None,
    *,
    wires: InstrumentConfig,
    log: Path,
    lines: "Mapping[Role, InstrumentLine] | None" = None,
) -> "BenchClient | LocalBench":
    """Return the bench of a plan; `lines` replace its serial ports."""
    from drivers.acquisition.plan_check import field_hz
    from drivers.bench.local_bench import open_bench

    return open_bench(
        wires,
        limits_in_force(plan.limits, sensor, plan.overrides),
        log=log,
        lines=lines,
        lamp=plan.lamp,
        meters=plan.meters,
        field_hz=field_hz(sensor),
        gating=plan.gating,
        dose=_ledger(plan, session),
        session=str(session),
    )


def _run(
    plan: Plan,
    session: Path,
    camera: "AbstractContextManager[Camera]",
    bench: "BenchClient | LocalBench",
    operator: "Operator",
    tell: Callable[[str], None],
    *,
    resume: bool,
    progress: Progress,
) -> Session:
    from drivers.acquisition.acquire import acquire
    from drivers.acquisition.run_control import RunControl

    try:
        return acquire(
            plan,
            session,
            camera=camera,
            bench=bench,
            operator=operator,
            judge=SaturationJudge(),
            resume=resume,
            progress=progress,
            requests=RunControl(tell),
        )
    finally:
        if bench.last_words:
            tell(f"The tube: {bench.last_words}.")


def camera_named(
    name: str | None, *, tell: Callable[[str], None] = print_message
) -> "AbstractContextManager[Camera]":
    """Return the camera of a name, not opened.

    "v4l2:/dev/video0", "v4l2:/dev/video0#1" (input 1 of a capture card); "replay:FOLDER" (each
    capture replays the session's next stack), "replay:FOLDER#LABEL" (every capture replays that
    stack); anything else is an Aravis identifier or an IP address; None: the only camera that
    Aravis lists.
    """
    kind, colon, rest = (name or "").partition(":")
    if not colon or kind not in ("v4l2", "replay"):
        from drivers.cameras.aravis.camera import AravisCamera

        return AravisCamera(name, say=tell)
    place, _, part = rest.partition("#")
    if not place:
        raise BadInput(
            f"a camera {kind}: must name its {'file' if kind == 'v4l2' else 'folder'}, got {name!r}"
        )
    if kind == "replay":
        from drivers.cameras.replay import ReplayCamera

        return ReplayCamera(place, label=part or None, say=tell)
    from drivers.cameras.v4l2 import V4l2Camera

    if part and not part.isdigit():
        raise BadInput(
            f"the input of a capture card must be a whole number, got {part!r} in {name!r}"
        )
    return V4l2Camera(place, input_number=int(part) if part else None)


def builtin_plan_names() -> tuple[str, ...]:
    """Names of the shipped plans."""
    files = (resources.files("charact.cli") / "plans").iterdir()
    return tuple(
        sorted(file.name.removesuffix(".toml") for file in files if file.name.endswith(".toml"))
    )


def load_plan(path: Path) -> Plan:
    """Read a plan from a file, or a shipped one by name; paths in it are relative to its folder.

    Raises
    ------
    BadInput
        If there is no such plan or it is invalid.
    """
    if str(path) in builtin_plan_names():
        with resources.as_file(
            resources.files("charact.cli") / "plans" / f"{path}.toml"
        ) as shipped:
            return read_plan(shipped)
    if not os.path.exists(path):
        raise BadInput(
            f"a plan must be a file or one of {', '.join(builtin_plan_names())}, got {path}"
        )
    written = read_toml(path)
    files = {
        key: name for key in ("gain_table", "lamp") if isinstance(name := written.get(key), str)
    }
    placed = {**written, **{key: str(path.parent / name) for key, name in files.items()}}
    plan = plan_of(placed, where=path.name)
    sensor = path.parent / (plan.sensor or "")
    return (
        replace(plan, sensor=str(sensor.resolve()))
        if plan.sensor is not None and os.path.isfile(sensor)
        else plan
    )


# Allowed fraction of pixels at full scale (point sources are exempt), and that of a saturated
# stack.
MAX_SATURATED_FRACTION, SATURATED_FRACTION = 1e-3, 0.01


class SaturationJudge:
    """Reports saturated stacks and ends adaptive steps."""

    def watch(self, step: Step, full_scale_dn: float) -> "StackWatcher":
        """Return the watcher of one stack."""
        return StackWatcher(step, full_scale_dn)


class StackWatcher:
    """Running statistics of one stack over all pixels."""

    def __init__(self, step: Step, full_scale_dn: float) -> None:
        self._step, self._full_scale_dn = step, full_scale_dn
        self._full_scale = math.ceil(full_scale_dn)  # an integer: a float would convert every frame
        self._full, self._pixels = 0, 0
        self._means_dn: list[float] = []
        self._look_at = step.until.least_frames if step.until else 0

    def see(self, pixels: NDArray) -> None:
        """Add a frame, shape (row, col), DN."""
        self._full += int(np.count_nonzero(pixels >= self._full_scale))
        self._pixels += pixels.size
        if self._step.until:
            self._means_dn.append(float(pixels.mean(dtype=np.float64)))

    def enough(self) -> str | None:
        """Return a sentence that the mean is within its tolerance, or None."""
        until, taken = self._step.until, len(self._means_dn)
        if until is None or taken < self._look_at:
            return None
        # A check after every frame would find a small interval by chance.
        self._look_at = int(np.ceil(1.25 * taken))
        half_dn = half_interval_dn(np.array(self._means_dn))
        if half_dn > until.mean_within_dn:
            return None
        return (
            f"stopped after {taken} of at most {self._step.frames} frames: the mean of "
            f"{np.mean(self._means_dn):.6g} DN is known within {half_dn:.2g} DN, requested "
            f"{until.mean_within_dn:g}"
        )

    def is_saturated(self) -> bool:
        """Whether more than 1 % of the pixels are at full scale."""
        return self._share > SATURATED_FRACTION

    def complaint(self) -> str | None:
        """Return a sentence on saturated pixels, or None."""
        if self._step.kind == "point" or self._share <= MAX_SATURATED_FRACTION:
            return None
        return (
            f"{100 * self._share:.2g} % of all pixels are at full scale, {self._full_scale_dn:g} DN"
        )

    @property
    def _share(self) -> float:
        return self._full / self._pixels if self._pixels else 0.0


def half_interval_dn(means_dn: NDArray) -> float:
    """Return half the 95 % interval of a stack's mean from its frame means, shape (frame,), DN.

    Notes
    -----
    Student's interval with the effective number of frames, n / tau, because of image lag and drift.
    The autocorrelation time tau = 1 + 2 sum rho is summed while rho stays positive (Geyer, Stat.
    Sci. 7, 473 (1992)).
    """
    from scipy.special import stdtrit

    frames = len(means_dn)
    rest = means_dn - means_dn.mean()
    if not rest.any():
        return 0.0
    rho = np.correlate(rest, rest, "full")[frames - 1 :] / (rest @ rest)
    first_negative = int(np.argmax(rho <= 0.0)) or frames
    tau = 1.0 + 2.0 * float(rho[1:first_negative].sum())
    independent = max(2.0, frames / tau)
    return float(stdtrit(independent - 1.0, 0.975) * rest.std(ddof=1) / np.sqrt(independent))
