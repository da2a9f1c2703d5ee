"""One run with everything open: each step set, filled and finished in the order that spares the tube."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.acquisition.run_control import RunControl
from drivers.acquisition.run_progress import RunProgress, StepClock
from drivers.errors import BenchError, CameraError
from drivers.interface import Bench, Camera, FrameLevels, Operator
from labdata.capture import PIXEL_BITS, CameraSettings, LostFrames
from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.event_log import EventLog
from labdata.plan import Judge, Plan, SaturationSearch, Step, Watcher, by_calibration, gain_table_of
from labdata.sensor import Sensor
from labdata.session import open_session
from labdata.store import SessionWriter
from labdata.store.storage_thread import Storage, StoredStack

LOOK_S = 0.1
DISK_S = 1.2
"""Longest time in which the disk may take nothing while frames wait, s: a hot tube is not kept waiting for it."""

CAMERA_S = 15.0
"""Longest time in which a camera may take its settings, the gate being shut, s."""

PROBE_SHARE, PROBE_NS = 0.01, 100.0
"""Share of the gate's width at which a light that a person set is looked at first, in whole ns, and its least width."""

SAME, SAME_LIGHT = 1e-3, 0.02
"""Relative difference within which an instrument, and a light meter, which repeats less well, reads back the same."""

OBSERVED = ("temperature_c", "temperature_time_s", "metered_w", "metered_lux", "metered_time_s")
"""What nobody set: it is recorded as it was, and need not be the same again."""

DISCARDED_FRAMES = 3  # a frame in the grabber, a frame in the camera, and one for the phosphor


@dataclass(kw_only=True)
class Run:
    """Takes the steps of a plan, in volts; made by `acquire` once camera, storage and bench are open."""

    plan: Plan
    sensor: Sensor | None
    folder: Path
    writer: SessionWriter
    storage: Storage
    log: EventLog
    camera: Camera
    bench: Bench
    operator: Operator
    settings: CameraSettings
    full_scale_dn: float
    judge: Judge | None
    progress: Callable[[str, float], None]

    def __post_init__(self) -> None:
        self._gain_table, self._before = gain_table_of(self.plan, self.sensor), None
        self._finished, self._partial, self._doubtful = self.writer.finished, self.writer.partial, self.writer.doubtful
        frames = {step.label: step.most_frames for step in self.plan.steps}
        done = sum(frames[label] for label in frames if label in self._finished)
        self._pace = RunProgress(frames=sum(frames.values()), done=done)

    def take_all(self, requests: RunControl) -> None:
        """Take the stacks that are not finished, and search where a step asks for it; `requests` ends or pauses it."""
        for step in self.plan.steps:
            if step.search is not None:
                self._search(step, step.search, requests)
            elif step.label not in self._finished:
                self._between_steps(requests)
                self._take(step)

    def _search(self, step: Step, wanted: SaturationSearch, requests: RunControl) -> None:
        """Find the light that saturates, from the step's on, each level a stack; finished levels are read instead."""
        seen: list[tuple[float, bool]] = []
        is_new = False
        begin_lux = step.conditions.illuminance_lux or 0.0
        while (lux := wanted.next_lux(begin_lux, seen)) is not None:
            level = step.level(lux, f"{step.label}-{len(seen) + 1}")
            if level.label in self._finished:
                self._look_back(level, watcher := self._watcher(level))
                self._pace.done += level.frames
                seen.append((lux, watcher.saturated()))
                continue
            self._between_steps(requests)
            seen.append((lux, self._take(level)))
            is_new = True
        if is_new:
            sentence = f"search {step.label!r}: {wanted.verdict(seen)}"
            self.log("remark", sentence=sentence)
            self.storage.remark(sentence)

    def _between_steps(self, requests: RunControl) -> None:
        """Stop or pause if that was asked; the gate is shut, and while the run pauses the light is out."""
        if requests.pause and not requests.stop:
            self.log("paused")
            self.operator.darken()
        requests.between_steps(self._look)

    def _take(self, step: Step) -> bool:
        """Take one stack and return whether it is saturated."""
        clock = StepClock()
        self._pace.step_begins()
        self._tell(step, 0)
        self.log("step begins", step=step.label)
        anew, watcher = self._set_aside(step), self._watcher(step)
        there = 0 if anew else self._partial.get(step.label, 0)
        before = self._look_back(step, watcher) if there else None
        conditions = self._set(step, clock)
        conditions, silent = self._read_meters(conditions, clock)
        if before is not None:
            _require_same(before, conditions, label=step.label)
        stack = self._begin(step, conditions)
        losses, enough = self._fill(step, stack, there, watcher, clock)
        stack.finish(losses, (*self._notes(there, anew, enough, watcher), *silent))
        self._pace.done += step.frames
        self.log(
            "step finished",
            step=step.label,
            lost_frames=sum(map(len, losses)),
            stopped_early=enough,
            wire_s=round(clock.wire_s, 4),
            settling_s=round(clock.settling_s, 4),
            overhead_ms=round(1e3 * clock.overhead_s, 3),
        )
        return watcher.saturated()

    def _set_aside(self, step: Step) -> str | None:
        """Put the frames of an earlier run aside that may not show what their stack says, and say so."""
        why = self._doubtful.get(step.label)
        if why is None:
            return None
        return f"taken anew, the frames before are in {self.storage.set_aside(step.label).name}: {why}"

    def _watcher(self, step: Step) -> Watcher:
        return _Unwatched() if self.judge is None else self.judge.watch(step, self.full_scale_dn)

    def _set(self, step: Step, clock: StepClock) -> Conditions:
        """Set what a step asks in the order that spares the tube, and return what was read back.

        Light goes out before gate and gain move and comes back after them.
        """
        asked = step.conditions
        with clock.wire():
            light = self.operator.place(kind=step.kind, target=step.target, illuminance_lux=0.0)
            with self.bench.patience(CAMERA_S):
                self.settings = self.camera.configure(
                    CameraSettings(exposure_s=asked.exposure_s, gain_db=asked.camera_gain_db)
                )
            tube = self.bench.set_conditions(asked)
            if asked.illuminance_lux:
                self._require_dark()
                light = self.operator.place(
                    kind=step.kind,
                    target=step.target,
                    illuminance_lux=asked.illuminance_lux,
                    filter_density=asked.filter_density,
                )
                if self.operator.is_by_hand:
                    self._probe_light(step)
                    tube = self.bench.set_conditions(asked)
        self._wait(self.plan.settle.wait_s(self._before, asked), clock)
        self._before = asked
        camera = Conditions(exposure_s=self.settings.exposure_s, camera_gain_db=self.settings.gain_db)
        return _conditions_in_force(asked, tube, by_calibration(self._gain_table, tube.mcp_v), light, camera)

    def _read_meters(self, conditions: Conditions, clock: StepClock) -> tuple[Conditions, tuple[str, ...]]:
        """Read the auxiliary meters once all has settled; one that keeps silent is noted."""
        with clock.wire():
            read, silent = self.bench.read_meters()
        for sentence in silent:
            self.log("meter silent", sentence=sentence)
        return _conditions_in_force(conditions, read), silent

    def _look(self) -> None:
        """Look after the bench and the disk, and show that the run lives."""
        self.bench.check()
        if self.storage.stall_s > DISK_S:
            raise BadInput(
                f"the disk must take a frame within {DISK_S:g} s, got {self.storage.stall_s:.1f} s without one; "
                "find what holds it up, then resume"
            )

    def _wait(self, seconds: float, clock: StepClock) -> None:
        """Let gain and light settle, with an eye on the bench."""
        with clock.settling():
            until_s = time.monotonic() + seconds
            while (left_s := until_s - time.monotonic()) > 0.0:
                self._look()
                time.sleep(min(left_s, LOOK_S))

    def _require_dark(self) -> None:
        """Before the first light: a frame through the open gate must be dark."""
        if not self.bench.dark_seen:
            self.bench.dark_frame_seen(self._one_frame(0.0))

    def _probe_light(self, step: Step) -> None:
        """Show the bench a frame in a light that a person set, with the gate open for a hundredth of the time only."""
        asked = step.conditions
        gate_ns = asked.gate_ns or 0.0
        self.bench.set_conditions(replace(asked, gate_ns=max(round(PROBE_SHARE * gate_ns), min(gate_ns, PROBE_NS))))
        self.bench.frame_seen(self._one_frame(step.max_saturated_fraction))

    def _one_frame(self, allowed: float) -> FrameLevels:
        capture = self.camera.capture(frames=1, discard=DISCARDED_FRAMES, while_waiting=self._look)
        with capture as running:
            (frame,) = running
        return FrameLevels.of(frame.pixels, self.full_scale_dn, allowed=allowed)

    def _look_back(self, step: Step, watcher: Watcher) -> Conditions:
        """Judge the frames of a stack that is gone on with, and return the conditions under which it was begun."""
        entry = open_session(self.folder).stack(step.label)
        for pixels in entry.read().data:
            self._look()
            watcher.see(pixels)
        return entry.conditions

    def _begin(self, step: Step, conditions: Conditions) -> StoredStack:
        pixel = np.uint8 if PIXEL_BITS[self.settings.pixel_format or "Mono16"] <= 8 else np.uint16
        shape = (self.settings.rows or 0, self.settings.columns or 0)
        return self.storage.begin_stack(
            step.label, step.kind, shape, pixel, conditions, asked=step.conditions, target=step.target
        )

    def _fill(
        self, step: Step, stack: StoredStack, there: int, watcher: Watcher, clock: StepClock
    ) -> tuple[tuple[LostFrames, ...], str | None]:
        """Take frames until the stack is full or holds enough; return which were lost, and why it holds enough."""
        taken, enough = there, watcher.enough() if there else None
        if taken >= step.frames or enough:
            self._shut(step, stack, clock)
            return (), enough
        allowed = step.max_saturated_fraction
        with ExitStack() as running:
            with clock.wire():
                capture = running.enter_context(
                    self.camera.capture(frames=step.frames - there, discard=DISCARDED_FRAMES, while_waiting=self._look)
                )
            try:
                with self._doubting(stack):
                    for frame in clock.waiting_for(capture):
                        with clock.wire():
                            self._show(step, frame.pixels, allowed)
                            self._look()
                        stack.put(frame)
                        taken += 1
                        watcher.see(frame.pixels)
                        self._tell(step, stack.acknowledged)
                        if enough := watcher.enough():
                            break
                self._shut(step, stack, clock)
            except BaseException as error:
                # The gate first: stopping a camera may take long.
                make_safe_after(error, self.bench)
                with suppress(BadInput):
                    stack.lose(capture.losses)
                raise
            with clock.wire():
                running.close()
        return capture.losses, enough

    def _show(self, step: Step, pixels: NDArray, allowed: float) -> None:
        """Show the bench how bright a frame is."""
        levels = FrameLevels.of(pixels, self.full_scale_dn, allowed=allowed)
        if step.kind == "dark" and not self.bench.dark_seen:
            self.bench.dark_frame_seen(levels)
        self.bench.frame_seen(levels)

    def _shut(self, step: Step, stack: StoredStack, clock: StepClock) -> None:
        """Compare the tube with what was set, then shut the gate: no target moves before an open one."""
        with self._doubting(stack), clock.wire():
            self.bench.verify()
            self.bench.set_conditions(replace(step.conditions, gate_ns=None))

    def _notes(self, there: int, anew: str | None, enough: str | None, watcher: Watcher) -> tuple[str, ...]:
        filled_up = f"broken off after {there} frames and filled up by a later run" if there else None
        return tuple(note for note in (anew, filled_up, enough, watcher.complaint()) if note)

    def _tell(self, step: Step, frames: int) -> None:
        sentence = f"{step.label}: {frames} of {step.frames} frames{self._pace.words(frames)}"
        self.progress(sentence, self._pace.share(frames))

    @contextmanager
    def _doubting(self, stack: StoredStack) -> Iterator[None]:
        """Where the bench fails, doubt the frames so far: the gate may have been shut before it was told."""
        try:
            yield
        except CameraError:
            raise
        except BenchError as error:
            with suppress(BadInput):
                stack.doubt(f"the bench failed while they were taken, and the last may be dark: {error}")
            raise


class _Unwatched:
    """Nobody judges: a stack takes all its frames."""

    def see(self, pixels: NDArray) -> None: ...

    def enough(self) -> str | None:
        return None

    def saturated(self) -> bool:
        return False

    def complaint(self) -> str | None:
        return None


def _conditions_in_force(asked: Conditions, *read_back: Conditions) -> Conditions:
    """Return the conditions in force: what was read back where something was, else what was asked."""
    for part in read_back:
        known = {item.name: value for item in fields(Conditions) if (value := getattr(part, item.name)) is not None}
        asked = replace(asked, **known)
    return asked


def _require_same(before: Conditions, now: Conditions, *, label: str) -> None:
    """Refuse (BadInput) to go on with a stack under other conditions than it was begun under."""
    for item in fields(Conditions):
        if item.name in OBSERVED:
            continue
        first, second = getattr(before, item.name), getattr(now, item.name)
        if first is None or second is None:
            continue
        if abs(second - first) > (SAME_LIGHT if item.name == "illuminance_lux" else SAME) * abs(first):
            raise BadInput(
                f"a resumed step must read back what it did in its first run, got {item.name} of {second:g} "
                f"after {first:g} in {label!r}"
            )


def make_safe_after(error: BaseException, bench: Bench) -> None:
    """Make the tube safe after an error; where that fails too, the error says so."""
    try:
        bench.safe()
    except BenchError as second:
        error.add_note(f"making the tube safe failed as well: {second}")
