"""Acquire a plan's stacks into a session and leave the tube in the safe state."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import Self

from drivers.acquisition.plan_check import (
    check_plan,
    picture_of,
    same_but_wires,
    sentences_out_of_step,
)
from drivers.acquisition.run import Run, make_safe_after
from drivers.acquisition.run_control import RunControl
from drivers.interface import Bench, Camera, Operator
from labdata.background import BackgroundWriter
from labdata.camera.description import Camera as Description
from labdata.capture import PIXEL_BITS, CameraSettings
from labdata.errors import BadInput
from labdata.event_log import EventLog
from labdata.file_io import write_atomically
from labdata.limits import limits_in_force
from labdata.plan import Judge, Plan, gain_table_of, in_volts
from labdata.plan_file import plan_toml, read_plan
from labdata.sensors import load_sensor, save_sensor, sensor_names
from labdata.session import MANIFEST, Session, open_session
from labdata.session_writer import SessionWriter
from labdata.storage_thread import Storage

PLAN = "plan.toml"
LOG = "log.jsonl"


def acquire(
    plan: Plan,
    folder: str | Path,
    *,
    camera: AbstractContextManager[Camera],
    bench: AbstractContextManager[Bench],
    operator: Operator,
    judge: Judge | None = None,
    resume: bool = False,
    progress: Callable[[str, float], None] = lambda sentence, fraction: None,
    requests: RunControl | None = None,
) -> Session:
    """Acquire a plan's stacks into a session, and return it.

    The tube is made safe first, and the plan is checked completely before anything is switched on.
    Frames are stored by a separate thread; progress counts those on the disk. Whatever ends the
    run, including errors of an instrument or the disk, the gate is shut and the gain lowered first;
    acquired frames are kept, and the session's log records the cause.

    Parameters
    ----------
    camera, bench
        Not yet opened; the bench is opened first and closed last. Both make the tube safe.
    operator
        Places targets and sets light.
    judge
        Assesses each stack during acquisition; its complaint becomes a note of the stack.
    resume
        Continue an interrupted run: finished stacks are not repeated, a partial one is completed,
        or acquired again where the bench failed during it.
    progress
        Called with the step and the completed fraction (0..1).
    requests
        Requests of the user; by default Ctrl-C and SIGUSR1.

    Raises
    ------
    BadInput
        If the plan breaks a rule, the folder has a session, a resumed plan differs from the
        original one or reads back other conditions, or the disk does not accept the frames.
    BenchError
        If an instrument or the camera fails; the message names it.
    KeyboardInterrupt
        If the run was stopped: by the first Ctrl-C after the present step, by the second at once.
    """
    folder = Path(folder)
    asked = requests or RunControl()
    with ExitStack() as opened:
        report = opened.enter_context(_Reporter(progress))
        opened.enter_context(asked.listen())
        # The bench makes the tube safe before plan, folder or camera can fail.
        tube = opened.enter_context(bench)
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
        )
        with asked.running(), _safe_first(tube):
            run.take_all(asked)
        storage.wait()
        report("all frames are stored", 1.0)
    return open_session(folder)


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
