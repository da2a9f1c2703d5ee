"""Acquire a plan's stacks into a session and leave the tube in the safe state."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import Annotated, Self

from drivers.acquisition.plan_check import (
    check_plan,
    field_hz,
    picture_of,
    same_but_wires,
    sentences_out_of_step,
)
from drivers.acquisition.plans import load_plan
from drivers.acquisition.run import Predict, Run, make_safe_after
from drivers.acquisition.run_control import RunControl
from drivers.bench.client import BenchClient
from drivers.bench.local_bench import LocalBench, open_bench
from drivers.cameras import camera_named
from drivers.interface import Bench, Camera, Operator
from drivers.serial_lines.line import InstrumentLine
from labdata import (
    MANIFEST,
    BackgroundWriter,
    BadInput,
    DoseLedger,
    EventLog,
    Session,
    SessionWriter,
    Storage,
    ledger_of,
    limits_in_force,
    load_sensor,
    open_session,
    plan_toml,
    read_plan,
    save_sensor,
    sensor_names,
    write_atomically,
)
from labdata import Camera as Description
from labdata.capture import PIXEL_BITS, CameraSettings
from labdata.instrument_config import InstrumentConfig, Role
from labdata.plan import Judge, Plan, gain_table_of, in_volts
from labdata.settings import Argument, ProgressSink, Resume, documented, ignore_progress

PLAN = "plan.toml"
LOG = "log.jsonl"
SAFETY_LOG, DOSE = "safety.jsonl", "dose.jsonl"


@documented
def acquire(
    plan: Annotated[
        str | Path | Plan, Argument("A plan, its TOML file, or the name of a shipped one.")
    ],
    out: Annotated[str | Path, Argument("Folder of the session.")],
    *,
    operator: Annotated[Operator, Argument("Places targets and sets light.")],
    camera: Annotated[
        AbstractContextManager[Camera] | None,
        Argument("Not yet opened (default: that which the plan names)."),
    ] = None,
    bench: Annotated[
        AbstractContextManager[Bench] | None,
        Argument(
            "Not yet opened; it is opened before the camera and closed after it, and both make the "
            "tube safe (default: the real one that the plan names)."
        ),
    ] = None,
    judge: Annotated[
        Judge | None,
        Argument(
            "Assesses each stack during acquisition, such as `charact.live.SaturationJudge`; its "
            "complaint becomes a note of the stack."
        ),
    ] = None,
    predict: Annotated[
        Predict | None,
        Argument(
            "Predicts the level of the brightest part of a step above black, DN, from its "
            "conditions with the voltage of the plate; a frame far above it ends the run "
            "(default: not compared)."
        ),
    ] = None,
    resume: Resume = False,
    progress: ProgressSink = ignore_progress,
    requests: Annotated[
        RunControl | None,
        Argument(
            "Requests of the user, and where they are confirmed (default: Ctrl-C and SIGUSR1)."
        ),
    ] = None,
) -> Session:
    """Acquire a plan's stacks into a session, and return it.

    The tube is made safe first, and the plan is checked completely before anything is switched on.
    Frames are stored by a separate thread; progress counts those on the disk. Whatever ends the
    run, including errors of an instrument or the disk, the gate is shut and the gain lowered first;
    acquired frames are kept, and the session's log records the cause. A resumed run does not repeat
    finished stacks; it completes a partial one, or acquires it again where the bench failed.

    Returns
    -------
    Session
        The stacks with conditions as read back, for `charact.measure`.

    Raises
    ------
    BadInput
        If the plan breaks a rule, a virtual bench or its camera is not given, the folder has a
        session, a resumed plan differs from the original one or reads back other conditions, or the
        disk does not accept the frames.
    BenchError
        If an instrument or the camera fails; the message names it.
    KeyboardInterrupt
        If the run was stopped: by the first Ctrl-C after the present step, by the second at once.

    Examples
    --------
    A dark on a virtual bench without wires:

    >>> import tempfile
    >>> from drivers.instruments.models import lines_on
    >>> from labdata.conditions import Conditions
    >>> from labdata.plan import Step
    >>> from simulate.virtual_bench.bench import VirtualBench
    >>> wires = InstrumentConfig(bench="in-process")
    >>> sensor = load_sensor("pulnix-ag5745ef3")
    >>> dark = Step(label="dark", kind="dark", frames=2, conditions=Conditions(gate_ns=1e4))
    >>> plan = Plan(name="darks", sensor="pulnix-ag5745ef3", wires=wires, steps=(dark,))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     out = Path(folder) / "day1"
    ...     with VirtualBench(bench_folder(out), sensor, seed=1, wires=wires) as virtual:
    ...         lines = lines_on(virtual.inside.ports, virtual.wires)
    ...         acquire(
    ...             plan,
    ...             out,
    ...             bench=bench_of(plan, out, wires=virtual.wires, lines=lines),
    ...             camera=virtual.in_process_camera(),
    ...             operator=virtual.operator,
    ...         ).stacks[0].read().shape
    (2, 493, 768)
    """
    plan, folder = load_plan(plan), Path(out)
    asked = requests or RunControl()
    if bench is None or camera is None:
        if plan.wires.bench != "real":
            raise BadInput(
                f"bench and camera must be given to a plan whose bench is {plan.wires.bench}, got "
                f"no {'bench' if bench is None else 'camera'} for {plan.name!r}"
            )
        bench = bench or bench_of(plan, folder)
        camera = camera or camera_named(plan.wires.camera, say=asked.say)
    with ExitStack() as opened:
        report = opened.enter_context(_Reporter(progress))
        opened.enter_context(asked.listen())
        # The bench makes the tube safe before plan, folder or camera can fail.
        tube = opened.enter_context(bench)
        if requests is not None:
            tube.say = requests.say
        asked.make_safe_at_once, asked.last_words = tube.safe_at_once, lambda: tube.last_words
        sensor = None if plan.sensor is None else load_sensor(plan.sensor)
        plan = in_volts(plan, sensor)
        check_plan(plan, folder, sensor)
        _require_judge(plan, judge)
        _keep_plan(plan, folder, resume=resume)
        log = opened.enter_context(
            _run_log(folder / LOG, plan=plan.name, resume=resume, say=asked.say)
        )
        eye = opened.enter_context(camera)
        settings = eye.configure(picture_of(plan, sensor))
        log("camera opened", camera=eye.identifier, **vars(settings))
        writer = opened.enter_context(_session_writer(plan, folder, sensor, settings))
        storage = opened.enter_context(Storage(writer))
        opened.callback(operator.darken)
        operator = tube.guard(operator)
        log(
            "bench opened",
            finished=writer.finished_labels,
            broken_off=writer.partial,
            doubtful=writer.doubtful,
        )
        run = Run(
            plan=plan,
            sensor=sensor,
            folder=folder,
            writer=writer,
            storage=storage,
            log=log,
            camera=eye,
            bench=tube,
            operator=operator,
            settings=settings,
            full_scale_dn=2.0 ** _bit_depth(sensor, settings) - 1.0,
            judge=judge,
            progress=report,
            predict=predict,
        )
        with asked.running(), _safe_first(tube):
            run.take_all(asked)
        storage.wait()
        report("all frames are stored", 1.0)
    return open_session(folder)


def bench_of(
    plan: Plan,
    out: Path,
    *,
    wires: InstrumentConfig | None = None,
    log: Path | None = None,
    lines: Mapping[Role, InstrumentLine] | None = None,
) -> BenchClient | LocalBench:
    """Return the bench of a plan, not opened, with limits, gating and dose ledger of its tube.

    Parameters
    ----------
    plan, out
        The plan, and the folder of its session.
    wires, lines
        Wires in place of the plan's, and lines in place of their serial ports, as of a virtual
        bench.
    log
        File for the events of the interlock; None: next to the session.

    Raises
    ------
    BadInput
        If an instrument has no serial port.
    """
    sensor = None if plan.sensor is None else load_sensor(plan.sensor)
    return open_bench(
        wires or plan.wires,
        limits_in_force(plan.limits, sensor, plan.overrides),
        log=log or out.with_name(f"{out.name}.{SAFETY_LOG}"),
        lines=lines,
        lamp=plan.lamp,
        meters=plan.meters,
        field_hz=field_hz(sensor),
        gating=plan.gating,
        dose=dose_ledger(plan, out),
        session=str(out),
    )


def dose_ledger(plan: Plan, out: Path) -> DoseLedger:
    """Return the dose ledger of the plan's tube; that of an unnamed tube is a file next to the
    session, or in the folder of its virtual bench.
    """
    if plan.tube is not None:
        return ledger_of(plan.tube)
    real = plan.wires.bench == "real"
    return DoseLedger(out.with_name(f"{out.name}.{DOSE}") if real else bench_folder(out) / DOSE)


def bench_folder(session: Path) -> Path:
    """Folder of the virtual bench of a session, next to the session folder."""
    return session.with_name(session.name + ".bench")


class _Reporter:
    """Progress through a queue, so that a blocked terminal does not delay the run."""

    def __init__(self, progress: Callable[[str, float], None]) -> None:
        self._writer: BackgroundWriter[tuple[str, float]] = BackgroundWriter(
            lambda item: progress(*item), name="progress"
        )

    def __call__(self, sentence: str, fraction: float) -> None:
        self._writer.enqueue((sentence, fraction))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.close(1.0)  # Longest wait at the end for progress to be shown, s


@contextmanager
def _safe_first(bench: Bench) -> Iterator[None]:
    """Make the tube safe first when the steps end, since closing a camera or a disk may take
    long.
    """
    try:
        yield
    except BaseException as error:
        make_safe_after(error, bench)
        raise
    bench.safe()


def _bit_depth(sensor: Description | None, settings: CameraSettings) -> int:
    """Return the bits of the digitiser from the sensor description, else from the camera's
    format.
    """
    return sensor.video.bit_depth if sensor else PIXEL_BITS[settings.pixel_format or "Mono16"]


def _keep_plan(plan: Plan, folder: Path, *, resume: bool) -> None:
    """Save the plan in the session folder, or compare it with the saved one."""
    saved_path = folder / PLAN
    if not resume:
        if saved_path.exists() or (folder / MANIFEST).exists():
            raise BadInput(
                f"a run must begin in a folder without a session, or be resumed, got {folder}"
            )
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(saved_path, plan_toml(plan).encode())
        return
    if not saved_path.exists():
        raise BadInput(f"a resumed run must have been begun before, got no {PLAN} in {folder}")
    if difference := same_but_wires(plan, read_plan(saved_path)):
        raise BadInput(
            f"a resumed run must keep its plan, got another {difference} than {saved_path} has"
        )


def _session_writer(
    plan: Plan, folder: Path, sensor: Description | None, settings: CameraSettings
) -> SessionWriter:
    """Begin the session in a folder, or continue the existing one."""
    if (folder / MANIFEST).exists():
        return SessionWriter.resume(folder)
    order, table = settings.field_order, gain_table_of(plan, sensor)
    interlaced = None if order is None else order in ("top first", "bottom first")
    notes = (
        None if order is None else f"field order of the camera: {order}",
        *settings.notes,
        None if table is None else table.provenance,
        None if plan.lamp is None else plan.lamp.provenance,
        *sentences_out_of_step(plan, sensor),
        *limits_in_force(plan.limits, sensor, plan.overrides).overridden,
    )
    return SessionWriter.create(
        folder,
        name=plan.name,
        sensor=_sensor_name(plan, folder, sensor),
        bit_depth=_bit_depth(sensor, settings),
        interlaced=sensor.video.interlaced if sensor else interlaced,
        notes=tuple(note for note in notes if note is not None),
    )


def _sensor_name(plan: Plan, folder: Path, sensor: Description | None) -> str | None:
    """Return the session's name of its sensor: a shipped one by name, any other as a copy in the
    session.
    """
    if sensor is None or plan.sensor in sensor_names():
        return plan.sensor
    save_sensor(sensor, folder / "sensor.toml")
    return "sensor.toml"


def _require_judge(plan: Plan, judge: Judge | None) -> None:
    for step in plan.steps:
        if judge is None and (step.until or step.search):
            raise BadInput(f"an adaptive step must have a judge, got none for {step.label!r}")


@contextmanager
def _run_log(
    path: Path, *, plan: str, resume: bool, say: Callable[[str], None]
) -> Iterator[EventLog]:
    """Open the session's log; its last line records the end of the run."""
    log = EventLog(path)
    log("run begins", plan=plan, resume=resume)
    try:
        yield log
    except BaseException as error:
        sentences = [str(error) or "interrupted", *getattr(error, "__notes__", ())]
        log("run ends", whole=False, kind=type(error).__name__, reason=" - ".join(sentences))
        raise
    else:
        log("run ends", whole=True)
    finally:
        if unwritten := log.close():
            say(f"{unwritten} events could not be written to {path}")
