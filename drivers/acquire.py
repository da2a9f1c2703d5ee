"""Acquisition: a plan becomes a session, step by step, and the tube is safe whichever way it ends."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from drivers.errors import BenchError
from drivers.interface import Bench, Camera, Operator
from drivers.plan_check import check_plan, same_but_wires
from labdata.border import from_toml, to_toml
from labdata.capture import CameraSettings
from labdata.conditions import Conditions
from labdata.durable import write_durably
from labdata.errors import BadInput
from labdata.plan import Judge, Plan, Step
from labdata.sensor import Sensor
from labdata.sensors import load_sensor, save_sensor, shipped
from labdata.session import MANIFEST, Session, open_session
from labdata.store import SessionWriter, StackWriter

PLAN = "plan.toml"
DISCARDED_FRAMES = 3  # a frame in the grabber, a frame in the camera, and one for the phosphor
BITS = {"Mono8": 8, "Mono10": 10, "Mono12": 12, "Mono14": 14, "Mono16": 16}


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
) -> Session:
    """Take a plan's stacks into a session.

    The plan is checked in full before anything is switched on. Each frame is on the disk before the next is taken.
    Whatever ends the run, an error of an instrument included, the gate is shut and the gain lowered first; the frames
    so far stay.

    Parameters
    ----------
    plan
        The plan.
    folder
        Folder of the session.
    camera
        The camera, not yet open; opened first and closed last.
    bench
        Gate and gain, not yet open; leaving it makes the tube safe.
    operator
        Puts targets and light before the camera.
    judge
        Looks at each finished stack; its complaint becomes a note of the stack.
    resume
        Go on with a run that was broken off: finished stacks are not repeated, a broken one is filled up, or taken
        anew where the bench failed while it was taken.
    progress
        Told the step and the share done (0..1).

    Returns
    -------
    Session
        The session, open.

    Raises
    ------
    BadInput
        If the plan breaks a rule, the folder holds a session, or a resumed plan is not the one that was begun.
    BenchError
        If an instrument or the camera fails; the sentence says which and how.
    """
    folder = Path(folder)
    sensor = None if plan.sensor is None else load_sensor(plan.sensor)
    check_plan(plan, folder, sensor)
    _keep_plan(plan, folder, resume=resume)
    with ExitStack() as opened:
        eye = opened.enter_context(camera)
        settings = eye.configure(_whole_sensor(sensor))
        writer = opened.enter_context(_writer(plan, folder, sensor, settings))
        opened.callback(operator.darken)
        tube = opened.enter_context(bench)
        run = _Run(plan, writer, eye, tube, operator, settings, judge, progress)
        for step in plan.steps:
            if step.label not in writer.finished:
                run.take(step)
    return open_session(folder)


class _Run:
    """One run of a plan with everything open."""

    def __init__(
        self,
        plan: Plan,
        writer: SessionWriter,
        camera: Camera,
        bench: Bench,
        operator: Operator,
        settings: CameraSettings,
        judge: Judge | None,
        progress: Callable[[str, float], None],
    ) -> None:
        self._plan, self._writer, self._camera, self._bench = plan, writer, camera, bench
        self._operator, self._settings, self._judge, self._progress = operator, settings, judge, progress
        self._frames = sum(step.frames for step in plan.steps)
        self._done = sum(step.frames for step in plan.steps if step.label in writer.finished)

    def take(self, step: Step) -> None:
        """Take one stack: settings, light, the frames that it still lacks, and what is to be said of it."""
        self._tell(step, 0)
        anew = self._put_aside(step)
        conditions = self._set(step)
        with self._begin(step, conditions) as stack:
            there = len(stack)
            lost = self._fill(step, stack) if there < step.frames else 0
            with _doubting(stack):
                # No target moves before an open gate.
                self._bench.set_conditions(replace(step.conditions, gate_ns=None))
            stack.finish(lost_frames=lost, notes=(*anew, *self._notes(step, there, conditions)))
        self._done += step.frames

    def _put_aside(self, step: Step) -> tuple[str, ...]:
        """Put the frames of an earlier run aside that may not show what their stack says, and say so."""
        why = self._writer.doubtful.get(step.label)
        if why is None:
            return ()
        return (f"taken anew, the frames before are in {self._writer.put_aside(step.label).name}: {why}",)

    def _set(self, step: Step) -> Conditions:
        """Set what a step asks in the order that spares the tube, and return what was read back.

        Light goes out before gate and gain move and comes back after them.
        """
        asked = step.conditions
        light = self._operator.place(kind=step.kind, target=step.target, illuminance_lux=0.0)
        self._settings = self._camera.configure(
            CameraSettings(exposure_s=asked.exposure_s, gain_db=asked.camera_gain_db)
        )
        tube = self._bench.set_conditions(asked)
        if asked.illuminance_lux:
            light = self._operator.place(kind=step.kind, target=step.target, illuminance_lux=asked.illuminance_lux)
        camera = Conditions(exposure_s=self._settings.exposure_s, camera_gain_db=self._settings.gain_db)
        return _merged(asked, tube, light, camera)

    def _begin(self, step: Step, conditions: Conditions) -> StackWriter:
        pixel = np.uint8 if BITS[self._settings.pixel_format or "Mono16"] <= 8 else np.uint16
        shape = (self._settings.rows or 0, self._settings.columns or 0)
        return self._writer.begin_stack(
            step.label, step.kind, shape, pixel, conditions, asked=step.conditions, target=step.target
        )

    def _fill(self, step: Step, stack: StackWriter) -> int:
        """Take frames until the stack is full, each durable before the next, and return how many were lost."""
        with self._camera.capture(frames=step.frames - len(stack), discard=DISCARDED_FRAMES) as capture:
            try:
                for frame in capture:
                    with _doubting(stack):
                        self._bench.check()
                    stack.append(frame.pixels, frame.time_s, frame.number)
                    self._tell(step, len(stack))
            except BaseException as error:
                # The gate first: stopping a camera may take long, and Bench shuts it only when its block ends.
                _make_safe(self._bench, error)
                raise
            return capture.lost_frames

    def _notes(self, step: Step, there: int, conditions: Conditions) -> list[str]:
        entry = open_session(self._writer.folder).stack(step.label)
        notes = []
        if there:
            notes.append(f"broken off after {there} frames and filled up by a later run")
            notes += _differences(entry.conditions, conditions)
        if self._judge is not None and (complaint := self._judge.complaint(entry.read(), step)):
            notes.append(complaint)
        return notes

    def _tell(self, step: Step, frames: int) -> None:
        self._progress(f"{step.label}: {frames} of {step.frames} frames", (self._done + frames) / self._frames)


@contextmanager
def _doubting(stack: StackWriter) -> Iterator[None]:
    """Where the bench fails, doubt the frames so far: the gate may have been shut before it was told."""
    try:
        yield
    except BenchError as error:
        stack.doubt(f"the bench failed while they were taken, and the last may be dark: {error}")
        raise


def _make_safe(bench: Bench, error: BaseException) -> None:
    try:
        bench.safe()
    except BenchError as second:
        error.add_note(f"making the tube safe failed as well: {second}")


def _differences(before: Conditions, now: Conditions) -> list[str]:
    """Say which conditions read back differently, beyond a tenth of a percent, when a stack was gone on with."""
    notes = []
    for item in fields(Conditions):
        first, second = getattr(before, item.name), getattr(now, item.name)
        if first is None or second is None or abs(second - first) <= 1e-3 * abs(first):
            continue
        notes.append(f"{item.name} was {first:g} in the first run and {second:g} in the later one")
    return notes


def _merged(asked: Conditions, *read_back: Conditions) -> Conditions:
    """Return the conditions in force: what was read back where something was, else what was asked."""
    for part in read_back:
        known = {item.name: value for item in fields(Conditions) if (value := getattr(part, item.name)) is not None}
        asked = replace(asked, **known)
    return asked


def _whole_sensor(sensor: Sensor | None) -> CameraSettings:
    """Ask for the size and depth that the sensor's description names; without one the camera stays as it is."""
    if sensor is None:
        return CameraSettings()
    depth = next(name for name, bits in BITS.items() if bits >= sensor.video.bit_depth)
    wide = "Mono8" if depth == "Mono8" else "Mono16"
    return CameraSettings(rows=sensor.ccd.rows, columns=sensor.ccd.columns, pixel_format=wide)


def _keep_plan(plan: Plan, folder: Path, *, resume: bool) -> None:
    """Keep the plan beside its session, or compare it with the one kept there."""
    kept = folder / PLAN
    if not resume:
        if kept.exists() or (folder / MANIFEST).exists():
            raise BadInput(f"a run must begin in a folder without a session, or be resumed, got {folder}")
        folder.mkdir(parents=True, exist_ok=True)
        write_durably(kept, to_toml(plan).encode())
        return
    if not kept.exists():
        raise BadInput(f"a resumed run must have been begun before, got no {PLAN} in {folder}")
    if difference := same_but_wires(plan, from_toml(kept, Plan)):
        raise BadInput(f"a resumed run must keep its plan, got another {difference} than {kept} has")


def _writer(plan: Plan, folder: Path, sensor: Sensor | None, settings: CameraSettings) -> SessionWriter:
    if (folder / MANIFEST).exists():
        return SessionWriter.resume(folder)
    own_bits = BITS[settings.pixel_format or "Mono16"]
    return SessionWriter.create(
        folder,
        name=plan.name,
        sensor=_sensor_name(plan, folder, sensor),
        bit_depth=sensor.video.bit_depth if sensor else own_bits,
        interlaced=sensor.video.interlaced if sensor else None,
    )


def _sensor_name(plan: Plan, folder: Path, sensor: Sensor | None) -> str | None:
    """Return how the session names its sensor: a shipped one by name, any other by a copy inside the session."""
    if sensor is None or plan.sensor in shipped():
        return plan.sensor
    save_sensor(sensor, folder / "sensor.toml")
    return "sensor.toml"
