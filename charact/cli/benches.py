"""Wires a plan to its bench: the virtual one with its own processes, or real ports, camera and a person at the lamp."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from charact.cli.cameras import camera_named
from charact.cli.output import print_message
from charact.cli.progress import Progress
from labdata.errors import BadInput
from labdata.instrument_config import InstrumentConfig, Role
from labdata.limits import limits_in_force
from labdata.plan import Plan
from labdata.sensor import Sensor
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
REHEARSAL = "rehearsal.jsonl"


@contextmanager
def bench_failure_is_a_sentence() -> Iterator[None]:
    """Turn a failure of an instrument into one sentence, as bad input is."""
    from drivers.errors import BenchError

    try:
        yield
    except BenchError as error:
        raise BadInput(str(error)) from error


def bench_folder(session: Path) -> Path:
    """Folder of the virtual bench of a session: beside the session, never inside it."""
    return session.with_name(session.name + ".bench")


def acquire_session(
    plan: Plan,
    session: Path,
    *,
    resume: bool,
    progress: Progress,
    tell: Callable[[str], None] = print_message,
    rehearse: "FaultScript | None" = None,
) -> Session:
    """Run a plan on the bench that it names and return the session; `rehearse`: faults that strike it meanwhile."""
    real = plan.wires.bench == "real"
    if real and rehearse is not None:
        raise BadInput("a rehearsal must be on a virtual bench, got a real one")
    with bench_failure_is_a_sentence():
        if real:
            taken = _on_real_bench(plan, session, resume=resume, progress=progress, tell=tell)
        else:
            taken = _on_virtual_bench(plan, session, resume=resume, progress=progress, tell=tell, script=rehearse)
    for sentence in warnings(_ledger(plan, session).total(), taken.sensor):
        tell(sentence)
    return taken


def _ledger(plan: Plan, session: Path) -> DoseLedger:
    """Return the ledger of the plan's tube; the dose of one without a name is kept beside its session."""
    if plan.tube is not None:
        return ledger_of(plan.tube)
    real = plan.wires.bench == "real"
    return DoseLedger(session.with_name(f"{session.name}.{DOSE}") if real else bench_folder(session) / DOSE)


def _on_virtual_bench(
    plan: Plan,
    session: Path,
    *,
    resume: bool,
    progress: Progress,
    tell: Callable[[str], None],
    script: "FaultScript | None",
) -> Session:
    from drivers.instruments.models import lines_on
    from simulate.virtual_bench.bench import VirtualBench

    sensor = _virtual_sensor(plan)
    folder = bench_folder(session)
    virtual_bench = VirtualBench(folder, sensor, plan.seed, wires=plan.wires, lamp=plan.lamp, say=tell)
    with virtual_bench as virtual, _fault_rehearsal(script, virtual, session, tell):
        session.parent.mkdir(parents=True, exist_ok=True)
        lines = None if virtual.inside is None else lines_on(virtual.inside.ports, virtual.wires)
        bench = _bench(plan, session, sensor, wires=virtual.wires, log=folder / SAFETY_LOG, lines=lines)
        camera, operator = _virtual_camera(plan, virtual, tell), virtual.operator
        return _acquire_session(plan, session, camera, bench, operator, resume=resume, progress=progress, tell=tell)


def _virtual_sensor(plan: Plan) -> Sensor:
    """Return the sensor of a plan for the virtual bench, which must name one and take its mains as they are."""
    from labdata.sensors import load_sensor
    from simulate.virtual_bench.delay_generator import LINE_HZ

    if plan.sensor is None:
        raise BadInput("a plan for the virtual bench must name its sensor, got none")
    if plan.gating.sync == "line-locked" and plan.gating.line_hz != LINE_HZ:
        raise BadInput(f"the mains of the virtual bench must be of {LINE_HZ:g} Hz, got {plan.gating.line_hz:g}")
    return load_sensor(plan.sensor)


def _fault_rehearsal(
    script: "FaultScript | None", virtual: "VirtualBench", session: Path, tell: Callable[[str], None]
) -> AbstractContextManager[object]:
    """Let faults strike a virtual bench while a session is taken."""
    if script is None:
        return nullcontext()
    from drivers.acquisition.acquire import LOG
    from simulate.virtual_bench.rehearsal import Rehearsal

    log = bench_folder(session) / REHEARSAL
    return Rehearsal(script, provoke=virtual.provoke, steps=session / LOG, log=log, say=tell)


def _virtual_camera(
    plan: Plan, virtual: "VirtualBench", tell: Callable[[str], None]
) -> "AbstractContextManager[Camera]":
    """Return the virtual bench's own camera, or the one that the plan names in its place."""
    if plan.wires.camera is not None:
        return camera_named(plan.wires.camera, tell=tell)
    if virtual.camera is None:
        return virtual.in_process_camera()
    from drivers.cameras.aravis.camera import AravisCamera

    return AravisCamera(virtual.camera.identifier, silence_s=virtual.silence_s, say=tell)


def _on_real_bench(
    plan: Plan, session: Path, *, resume: bool, progress: Progress, tell: Callable[[str], None]
) -> Session:
    from charact.cli.prompting import PromptingOperator, TargetPlacer
    from labdata.sensors import load_sensor

    sensor = None if plan.sensor is None else load_sensor(plan.sensor)
    camera = camera_named(plan.wires.camera, tell=tell)
    bench = _bench(plan, session, sensor, wires=plan.wires, log=session.with_name(f"{session.name}.{SAFETY_LOG}"))
    operator = PromptingOperator() if plan.lamp is None else TargetPlacer()
    return _acquire_session(plan, session, camera, bench, operator, resume=resume, progress=progress, tell=tell)


def _bench(
    plan: Plan,
    session: Path,
    sensor: Sensor | None,
    *,
    wires: InstrumentConfig,
    log: Path,
    lines: "Mapping[Role, InstrumentLine] | None" = None,
) -> "BenchClient | LocalBench":
    """Return the bench of a plan on wires; `lines`: what stands in for serial ports."""
    from drivers.acquisition.plan_check import field_hz
    from drivers.bench.setup import open_bench

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


def _acquire_session(
    plan: Plan,
    session: Path,
    camera: "AbstractContextManager[Camera]",
    bench: "BenchClient | LocalBench",
    operator: "Operator",
    *,
    resume: bool,
    progress: Progress,
    tell: Callable[[str], None],
) -> Session:
    from charact.cli.judge import SaturationJudge
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
