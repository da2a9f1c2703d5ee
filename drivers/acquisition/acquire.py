"""Acquisition: a plan becomes a session, step by step, and the tube is safe whichever way it ends."""

from collections.abc import Callable, Container, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import Self

from drivers.acquisition.frame_format_check import picture_of
from drivers.acquisition.plan_check import check_plan
from drivers.acquisition.run import Run, make_safe_after
from drivers.acquisition.run_control import RunControl
from drivers.acquisition.run_progress import RunProgress
from drivers.acquisition.run_start import bit_depth, keep_plan, session_writer
from drivers.acquisition.saturation_search import search
from drivers.interface import Bench, Camera, Operator
from labdata.background import BackgroundWriter
from labdata.calibrated_gain import gain_table_of, in_volts
from labdata.errors import BadInput
from labdata.event_log import EventLog
from labdata.plan import Judge, Plan
from labdata.sensors import load_sensor
from labdata.session import Session, open_session
from labdata.store.storage import Storage

LOG = "log.jsonl"

PROGRESS_S = 1.0
"""Longest wait at the end for progress to be shown, s."""


def acquire(
    plan: Plan,
    folder: str | Path,
    *,
    camera: AbstractContextManager[Camera],
    bench: AbstractContextManager[Bench],
    operator: Operator,
    judge: Judge | None = None,
    resume: bool = False,
    progress: Callable[[str, float], None] = lambda sentence, share: None,
    requests: RunControl | None = None,
) -> Session:
    """Take a plan's stacks into a session.

    The tube is made safe before anything else, and the plan checked in full before anything is switched on. Frames are
    stored by a thread of their own; progress counts those that are on the disk. Whatever ends the run, an error of an
    instrument or of the disk included, the gate is shut and the gain lowered first; the frames so far stay, and the
    session's log says what happened.

    Parameters
    ----------
    plan
        The plan.
    folder
        Folder of the session.
    camera
        The camera, not yet open.
    bench
        Gate and gain, not yet open; opened first and left last. Both make the tube safe.
    operator
        Puts targets and light before the camera.
    judge
        Watches each stack while it is taken; its complaint becomes a note of the stack.
    resume
        Go on with a run that was broken off: finished stacks are not repeated, a broken one is filled up, or taken
        anew where the bench failed while it was taken.
    progress
        Told the step and the share done (0..1).
    requests
        What a person asks of the run meanwhile; by default Ctrl-C and SIGUSR1.

    Returns
    -------
    Session
        The session, open.

    Raises
    ------
    BadInput
        If the plan breaks a rule, the folder holds a session, a resumed plan is not the one that was begun or reads
        back other conditions, or the disk does not take the frames.
    BenchError
        If an instrument or the camera fails; the sentence says which and how.
    KeyboardInterrupt
        If the run was stopped: after the first Ctrl-C when the present step is finished, after the second at once.
    """
    folder = Path(folder)
    asked = requests or RunControl()
    with ExitStack() as opened:
        report = opened.enter_context(_Reporter(progress))
        opened.enter_context(asked.heard())
        # First of all, whatever becomes of plan, folder and camera: the tube is made safe.
        tube = opened.enter_context(bench)
        asked.make_safe_at_once, asked.last_words = tube.safe_at_once, lambda: tube.last_words
        sensor = None if plan.sensor is None else load_sensor(plan.sensor)
        plan = in_volts(plan, sensor)
        check_plan(plan, folder, sensor)
        _require_judge(plan, judge)
        keep_plan(plan, folder, resume=resume)
        log = opened.enter_context(_logged(folder / LOG, plan=plan.name, resume=resume))
        eye = opened.enter_context(camera)
        settings = eye.configure(picture_of(plan, sensor))
        log("camera opened", camera=eye.identifier, **vars(settings))
        writer = opened.enter_context(session_writer(plan, folder, sensor, settings))
        finished, partial, doubtful = writer.finished, writer.partial, writer.doubtful
        storage = opened.enter_context(Storage(writer))
        opened.callback(operator.darken)
        operator = tube.guard(operator)
        log("bench opened", finished=finished, broken_off=partial, doubtful=doubtful)
        run = Run(
            folder,
            storage=storage,
            log=log,
            camera=eye,
            bench=tube,
            operator=operator,
            settings=settings,
            full_scale_dn=2.0 ** bit_depth(sensor, settings) - 1.0,
            judge=judge,
            settle=plan.settle,
            gain_table=gain_table_of(plan, sensor),
            pace=_pace(plan, finished),
            progress=report,
            finished=finished,
            partial=partial,
            doubtful=doubtful,
        )
        with asked.running(), _safe_first(tube):
            _take(run, plan, finished, asked)
        storage.wait()
        run.report_end()
    return open_session(folder)


class _Reporter:
    """Progress through a queue: a terminal that takes no more must not hold up the run."""

    def __init__(self, progress: Callable[[str, float], None]) -> None:
        self._writer: BackgroundWriter[tuple[str, float]] = BackgroundWriter(
            lambda item: progress(*item), name="progress"
        )

    def __call__(self, sentence: str, share: float) -> None:
        self._writer.put((sentence, share))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.close(PROGRESS_S)


@contextmanager
def _safe_first(bench: Bench) -> Iterator[None]:
    """Make the tube safe before anything else is left, however the steps end: a camera or a disk may take long."""
    try:
        yield
    except BaseException as error:
        make_safe_after(error, bench)
        raise
    bench.safe()


def _pace(plan: Plan, finished: Container[str]) -> RunProgress:
    """Return how far the frames of a plan are, stacks that are finished counted as done."""
    return RunProgress(
        frames=sum(step.most_frames for step in plan.steps),
        done=sum(step.most_frames for step in plan.steps if step.label in finished),
    )


def _take(run: Run, plan: Plan, finished: Container[str], asked: RunControl) -> None:
    """Take the stacks that are not finished, and search where a step asks for it."""
    for step in plan.steps:
        if step.search is not None:
            search(run, step, step.search, asked)
        elif step.label not in finished:
            run.between_steps(asked)
            run.take(step)


def _require_judge(plan: Plan, judge: Judge | None) -> None:
    for step in plan.steps:
        if judge is None and (step.until or step.search):
            raise BadInput(f"a step that looks at its own frames must have a judge, got none for {step.label!r}")


@contextmanager
def _logged(path: Path, *, plan: str, resume: bool) -> Iterator[EventLog]:
    """Open the session's log; its last line says how the run ended, if anybody lived to write it."""
    log = EventLog(path)
    log("run begins", plan=plan, resume=resume)
    try:
        yield log
    except BaseException as error:
        told = [str(error) or "interrupted", *getattr(error, "__notes__", ())]
        log("run ends", whole=False, kind=type(error).__name__, reason=" - ".join(told))
        raise
    else:
        log("run ends", whole=True)
    finally:
        log.close()
