"""One run with everything open: each step set, filled and finished in the order that spares the tube."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.acquisition.read_back import merged, require_same
from drivers.acquisition.run_control import RunControl
from drivers.acquisition.run_progress import RunProgress, StepClock
from drivers.errors import BenchError
from drivers.interface import Bench, Camera, CameraError, FrameLevels, Operator
from labdata.calibrated_gain import by_calibration
from labdata.capture import PIXEL_BITS, CameraSettings, LostFrames
from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.event_log import EventLog
from labdata.gain_table import GainTable
from labdata.plan import Judge, Settle, Step, Watcher
from labdata.session import open_session
from labdata.store.storage import Storage, StoredStack

LOOK_S = 0.1
DISK_S = 1.2
"""Longest time in which the disk may take nothing while frames wait, s: a hot tube is not kept waiting for it."""

CAMERA_S = 15.0
"""Longest time in which a camera may take its settings, the gate being shut, s."""

PROBE_SHARE = 0.01
"""Share of the gate's width at which a light that a person set is looked at first."""

DISCARDED_FRAMES = 3  # a frame in the grabber, a frame in the camera, and one for the phosphor


class Run:
    """Takes steps; made by `acquire` once camera, storage and bench are open."""

    def __init__(
        self,
        folder: Path,
        *,
        storage: Storage,
        log: EventLog,
        camera: Camera,
        bench: Bench,
        operator: Operator,
        settings: CameraSettings,
        full_scale_dn: float,
        judge: Judge | None,
        settle: Settle,
        gain_table: GainTable | None,
        pace: RunProgress,
        progress: Callable[[str, float], None],
        finished: Sequence[str],
        partial: Mapping[str, int],
        doubtful: Mapping[str, str],
    ) -> None:
        self._folder, self._storage, self._log = folder, storage, log
        self._camera, self._bench, self._operator = camera, bench, operator
        self._settings, self._full_scale_dn, self._judge = settings, full_scale_dn, judge
        self._pace, self._progress = pace, progress
        self._settle, self._gain_table, self._before = settle, gain_table, None
        self.finished, self._partial, self._doubtful = finished, partial, doubtful

    def between_steps(self, requests: RunControl) -> None:
        """Stop or pause if that was asked; the gate is shut, and while the run pauses the light is out."""
        if requests.pause and not requests.stop:
            self._log("paused")
            self._operator.darken()
        requests.between_steps(self._look)

    def take(self, step: Step) -> bool:
        """Take one stack and return whether it is saturated."""
        clock = StepClock()
        self._pace.step_begins()
        self._tell(step, 0)
        self._log("step begins", step=step.label)
        anew, watcher = self._put_aside(step), self._watcher(step)
        there = 0 if anew else self._partial.get(step.label, 0)
        before = self._look_back(step, watcher) if there else None
        conditions = self._set(step, clock)
        conditions, silent = self._read_meters(conditions, clock)
        if before is not None:
            require_same(before, conditions, label=step.label)
        stack = self._begin(step, conditions)
        losses, enough = self._fill(step, stack, there, watcher, clock)
        stack.finish(losses, (*self._notes(there, anew, enough, watcher), *silent))
        self._pace.done += step.frames
        self._log(
            "step finished",
            step=step.label,
            lost_frames=sum(map(len, losses)),
            stopped_early=enough,
            wire_s=round(clock.wire_s, 4),
            settling_s=round(clock.settling_s, 4),
            overhead_ms=round(1e3 * clock.overhead_s, 3),
        )
        return watcher.saturated()

    def report_end(self) -> None:
        """Report that all is on the disk."""
        self._progress("all frames are stored", 1.0)

    def read_saturated(self, step: Step) -> bool:
        """Return whether a stack that an earlier run finished is saturated."""
        watcher = self._watcher(step)
        for pixels in open_session(self._folder).stack(step.label).read().data:
            self._look()
            watcher.see(pixels)
        self._pace.done += step.frames
        return watcher.saturated()

    def remark(self, sentence: str) -> None:
        """Add a remark to the session and its log, once."""
        self._log("remark", sentence=sentence)
        self._storage.remark(sentence)

    def _put_aside(self, step: Step) -> str | None:
        """Put the frames of an earlier run aside that may not show what their stack says, and say so."""
        why = self._doubtful.get(step.label)
        if why is None:
            return None
        return f"taken anew, the frames before are in {self._storage.put_aside(step.label).name}: {why}"

    def _watcher(self, step: Step) -> Watcher:
        return _Unwatched() if self._judge is None else self._judge.watch(step, self._full_scale_dn)

    def _set(self, step: Step, clock: StepClock) -> Conditions:
        """Set what a step asks in the order that spares the tube, and return what was read back.

        Light goes out before gate and gain move and comes back after them.
        """
        asked = step.conditions
        with clock.wire():
            light = self._operator.place(kind=step.kind, target=step.target, illuminance_lux=0.0)
            with self._bench.patience(CAMERA_S):
                self._settings = self._camera.configure(
                    CameraSettings(exposure_s=asked.exposure_s, gain_db=asked.camera_gain_db)
                )
            tube = self._bench.set_conditions(asked)
            if asked.illuminance_lux:
                self._require_dark()
                light = self._operator.place(
                    kind=step.kind,
                    target=step.target,
                    illuminance_lux=asked.illuminance_lux,
                    filter_density=asked.filter_density,
                )
                if self._operator.is_by_hand:
                    self._probe_light(step)
                    tube = self._bench.set_conditions(asked)
        self._wait(self._settle.wait_s(self._before, asked), clock)
        self._before = asked
        camera = Conditions(exposure_s=self._settings.exposure_s, camera_gain_db=self._settings.gain_db)
        return merged(asked, tube, by_calibration(self._gain_table, tube.mcp_v), light, camera)

    def _read_meters(self, conditions: Conditions, clock: StepClock) -> tuple[Conditions, tuple[str, ...]]:
        """Read the auxiliary meters once all has settled; one that keeps silent is noted."""
        with clock.wire():
            read, silent = self._bench.read_meters()
        for sentence in silent:
            self._log("meter silent", sentence=sentence)
        return merged(conditions, read), silent

    def _look(self) -> None:
        """Look after the bench and the disk, and show that the run lives."""
        self._bench.check()
        if self._storage.stalled_s > DISK_S:
            raise BadInput(
                f"the disk must take a frame within {DISK_S:g} s, got {self._storage.stalled_s:.1f} s without one; "
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
        if not self._bench.dark_seen:
            self._bench.dark_frame_seen(self._one_frame(0.0))

    def _probe_light(self, step: Step) -> None:
        """Show the bench a frame in a light that a person set, with the gate open for a hundredth of the time only."""
        asked = step.conditions
        self._bench.set_conditions(replace(asked, gate_ns=PROBE_SHARE * (asked.gate_ns or 0.0)))
        self._bench.frame_seen(self._one_frame(step.allowed_saturation))

    def _one_frame(self, allowed: float) -> FrameLevels:
        capture = self._camera.capture(frames=1, discard=DISCARDED_FRAMES, while_waiting=self._look)
        with capture as running:
            (frame,) = running
        return FrameLevels.of(frame.pixels, self._full_scale_dn, allowed=allowed)

    def _look_back(self, step: Step, watcher: Watcher) -> Conditions:
        """Judge the frames of a stack that is gone on with, and return the conditions under which it was begun."""
        entry = open_session(self._folder).stack(step.label)
        for pixels in entry.read().data:
            self._look()
            watcher.see(pixels)
        return entry.conditions

    def _begin(self, step: Step, conditions: Conditions) -> StoredStack:
        pixel = np.uint8 if PIXEL_BITS[self._settings.pixel_format or "Mono16"] <= 8 else np.uint16
        shape = (self._settings.rows or 0, self._settings.columns or 0)
        return self._storage.begin_stack(
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
        allowed = step.allowed_saturation
        with ExitStack() as running:
            with clock.wire():
                capture = running.enter_context(
                    self._camera.capture(frames=step.frames - there, discard=DISCARDED_FRAMES, while_waiting=self._look)
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
                make_safe_after(error, self._bench)
                with suppress(BadInput):
                    stack.lose(capture.losses)
                raise
            with clock.wire():
                running.close()
        return capture.losses, enough

    def _show(self, step: Step, pixels: NDArray, allowed: float) -> None:
        """Show the bench how bright a frame is."""
        levels = FrameLevels.of(pixels, self._full_scale_dn, allowed=allowed)
        if step.kind == "dark" and not self._bench.dark_seen:
            self._bench.dark_frame_seen(levels)
        self._bench.frame_seen(levels)

    def _shut(self, step: Step, stack: StoredStack, clock: StepClock) -> None:
        """Compare the tube with what was set, then shut the gate: no target moves before an open one."""
        with self._doubting(stack), clock.wire():
            self._bench.verify()
            self._bench.set_conditions(replace(step.conditions, gate_ns=None))

    def _notes(self, there: int, anew: str | None, enough: str | None, watcher: Watcher) -> tuple[str, ...]:
        filled_up = f"broken off after {there} frames and filled up by a later run" if there else None
        return tuple(note for note in (anew, filled_up, enough, watcher.complaint()) if note)

    def _tell(self, step: Step, frames: int) -> None:
        sentence = f"{step.label}: {frames} of {step.frames} frames{self._pace.words(frames)}"
        self._progress(sentence, self._pace.share(frames))

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


def make_safe_after(error: BaseException, bench: Bench) -> None:
    """Make the tube safe after an error; where that fails too, the error says so."""
    try:
        bench.safe()
    except BenchError as second:
        error.add_note(f"making the tube safe failed as well: {second}")
