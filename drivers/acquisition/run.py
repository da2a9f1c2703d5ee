"""Take the steps of a plan with camera, bench and storage open."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.acquisition.run_control import RunControl
from drivers.acquisition.run_progress import RunProgress, StepClock
from drivers.errors import BenchError, BenchStopped, CameraError
from drivers.interface import Bench, Camera, FrameLevels, Operator
from labdata import BadInput, Conditions, EventLog, SessionWriter, open_session
from labdata import Camera as Description
from labdata.capture import PIXEL_BITS, CameraSettings, Frame, LostFrames
from labdata.plan import Judge, Plan, SaturationSearch, Step, Watcher, by_calibration, gain_table_of
from labdata.storage_thread import Storage, StoredStack

LOOK_S = 0.1
# Longest time without progress of the disk while frames are queued, s, since the tube is at gain
# meanwhile
DISK_S = 1.2

# Fraction of the gate width, and smallest width in ns, of the first frame in a light that a person
# set
PROBE_SHARE, PROBE_NS = 0.01, 100.0

# Largest relative difference of equal read-backs of an instrument, and of a light meter
SAME, SAME_LIGHT = 1e-3, 0.02

# Measured conditions without set-point; they may differ between runs
OBSERVED = ("temperature_c", "temperature_time_s", "metered_w", "metered_lux", "metered_time_s")

# Logarithm of the chance below which repeated pictures are no accident, and fraction of read noise
# that a video filter leaves; where noise is unknown, the fraction of pixels off the median that
# shows it (hot pixels are fewer)
LOG_CHANCE, NOISE_LEFT, VISIBLE_PIXELS = -14.0, 0.5, 0.01
BLOCK_PX = 8  # Side of the blocks in which pictures differ independently, px
VISIBLE_DN = 1.0  # Predicted level above black from which light has noise to be seen, DN
# Factor by which a level above black may exceed the one that the description predicts (specimens
# are within 2.5), and fraction of full scale by which it may exceed it in any case
PREDICTED_FACTOR, PREDICTED_MARGIN = 5.0, 0.05
# Fraction of pixels that may be saturated where none is expected, even in the brightest specimen:
# hot pixels and ions are fewer
STRAY_FACTOR, STRAY_SATURATION = 2.5, 0.005
DIGEST_BYTES = 1 << 20  # Bytes of a frame, evenly chosen rows, by which it is known again

DISCARDED_FRAMES = 3  # a frame in the grabber, a frame in the camera, and one for the phosphor


# Predicts the level of the brightest part of a step above black, DN, from its conditions
Predict = Callable[[Conditions], float]


@dataclass(kw_only=True)
class Run:
    """Acquires the steps of a plan in volts; made by `acquire` when camera, storage and bench are
    open.
    """

    plan: Plan
    sensor: Description | None
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
    predict: Predict | None

    def __post_init__(self) -> None:
        self._gain_table, self._before = gain_table_of(self.plan, self.sensor), None
        self._black_dn: float | None = None  # Mean of the first frame without light
        self._pictures: dict[int, int] = {}  # Numbers of all frames, by their digests
        self._finished, self._partial, self._doubtful = (
            self.writer.finished_labels,
            self.writer.partial,
            self.writer.doubtful,
        )
        frames = {step.label: step.most_frames for step in self.plan.steps}
        done = sum(frames[label] for label in frames if label in self._finished)
        self._pace = RunProgress(frames=sum(frames.values()), done=done)

    def take_all(self, requests: RunControl) -> None:
        """Acquire the unfinished stacks and searches; `requests` stops or pauses the run."""
        for step in self.plan.steps:
            if step.search is not None:
                self._search(step, step.search, requests)
            elif step.label not in self._finished:
                self._between_steps(requests)
                self._take(step)

    def _search(self, step: Step, wanted: SaturationSearch, requests: RunControl) -> None:
        """Search for the light that saturates, one stack per level; finished levels are read."""
        levels: list[tuple[float, bool]] = []
        is_new = False
        begin_lux = step.conditions.illuminance_lux or 0.0
        while (lux := wanted.next_lux(begin_lux, levels)) is not None:
            level = step.level(lux, f"{step.label}-{len(levels) + 1}")
            if level.label in self._finished:
                self._look_back(level, watcher := self._watcher(level))
                self._pace.done += level.frames
                levels.append((lux, watcher.is_saturated()))
                continue
            self._between_steps(requests)
            levels.append((lux, self._take(level)))
            is_new = True
        if is_new:
            sentence = f"search {step.label!r}: {wanted.verdict(levels)}"
            self.log("remark", sentence=sentence)
            self.storage.remark(sentence)

    def _between_steps(self, requests: RunControl) -> None:
        """Stop or pause if requested; the gate is shut, and during a pause the light is off."""
        if requests.pause and not requests.stop:
            self.log("paused")
            self.operator.darken()
        requests.between_steps(self._look)

    def _take(self, step: Step) -> bool:
        """Acquire one stack and return whether it is saturated."""
        clock = StepClock()
        self._pace.step_begins()
        self._tell(step, 0)
        self.log("step begins", step=step.label)
        anew, watcher = self._set_aside(step), self._watcher(step)
        asked, is_bright = step.conditions, bool(step.conditions.illuminance_lux)
        if is_bright and self.predict is not None:
            is_bright = bool(asked.mcp_v) and self.predict(asked) > VISIBLE_DN
        self._freshness = Freshness(self._pictures, is_bright=is_bright, noise_dn=self._noise_dn)
        stored_frames = 0 if anew else self._partial.get(step.label, 0)
        before = self._look_back(step, watcher) if stored_frames else None
        conditions = self._set(step, clock)
        conditions, silent = self._read_meters(conditions, clock)
        if before is not None:
            _require_same(before, conditions, label=step.label)
        stack = self._begin(step, conditions)
        losses, enough = self._fill(step, stack, stored_frames, watcher, clock)
        stack.finish(losses, (*self._notes(stored_frames, anew, enough, watcher), *silent))
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
        return watcher.is_saturated()

    def _set_aside(self, step: Step) -> str | None:
        """Set doubtful frames of an earlier run aside, and return a note."""
        why = self._doubtful.get(step.label)
        if why is None:
            return None
        return (
            "acquired again, the earlier frames are in "
            f"{self.storage.set_aside(step.label).name}: {why}"
        )

    def _watcher(self, step: Step) -> Watcher:
        return _Unwatched() if self.judge is None else self.judge.watch(step, self.full_scale_dn)

    def _set(self, step: Step, clock: StepClock) -> Conditions:
        """Set the conditions of a step and return the read-backs.

        The light is off while gate and gain change.
        """
        asked = step.conditions
        with clock.timing("wire_s"):
            light = self.operator.place(kind=step.kind, target=step.target, illuminance_lux=0.0)
            with self.bench.patience(
                15.0
            ):  # Longest time for the settings of a camera, with the gate shut, s
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
        camera = Conditions(
            exposure_s=self.settings.exposure_s, camera_gain_db=self.settings.gain_db
        )
        return _conditions_in_force(
            asked, tube, by_calibration(self._gain_table, tube.mcp_v), light, camera
        )

    def _read_meters(
        self, conditions: Conditions, clock: StepClock
    ) -> tuple[Conditions, tuple[str, ...]]:
        """Read the auxiliary meters after settling; a time-out is noted."""
        with clock.timing("wire_s"):
            read, silent = self.bench.read_meters()
        for sentence in silent:
            self.log("meter silent", sentence=sentence)
        return _conditions_in_force(conditions, read), silent

    def _look(self) -> None:
        """Check bench and disk; this is also the heartbeat of the run."""
        self.bench.check()
        longest_s = DISK_S + self.bench.slack_s()
        if self.storage.stall_s > longest_s:
            raise BadInput(
                f"the disk must take a frame within {longest_s:.2g} s, got "
                f"{self.storage.stall_s:.1f} s without one; find what holds it up, then resume"
            )

    def _wait(self, seconds: float, clock: StepClock) -> None:
        """Let gain and light settle, checking the bench."""
        with clock.timing("settling_s"):
            until_s = time.monotonic() + seconds
            while (left_s := until_s - time.monotonic()) > 0.0:
                self._look()
                time.sleep(min(left_s, LOOK_S))

    def _require_dark(self) -> None:
        """Require a dark frame through the open gate before the first light."""
        if not self.bench.dark_seen:
            self._take_dark(self._one_frame(0.0))

    def _probe_light(self, step: Step) -> None:
        """Report a frame in a light that a person set, with a hundredth of the gate width."""
        asked = step.conditions
        gate_ns = asked.gate_ns or 0.0
        self.bench.set_conditions(
            replace(asked, gate_ns=max(round(PROBE_SHARE * gate_ns), min(gate_ns, PROBE_NS)))
        )
        self.bench.frame_seen(self._one_frame(step.max_saturated_fraction))

    def _one_frame(self, allowed: float) -> FrameLevels:
        capture = self.camera.capture(frames=1, discard=DISCARDED_FRAMES, while_waiting=self._look)
        with capture as running:
            (frame,) = running
        return self._levels(frame.pixels, allowed)

    def _levels(self, pixels: NDArray, allowed: float) -> FrameLevels:
        return FrameLevels.of(pixels, self.full_scale_dn, allowed=allowed, black_dn=self._black_dn)

    def _take_dark(self, levels: FrameLevels) -> None:
        """Report a frame without light, and keep its level."""
        self.bench.dark_frame_seen(levels)
        self._black_dn = levels.mean * self.full_scale_dn

    def _look_back(self, step: Step, watcher: Watcher) -> Conditions:
        """Pass the frames of a continued stack to the watcher, and return its original
        conditions.
        """
        entry = open_session(self.folder).stack(step.label)
        for pixels in entry.read().data:
            self._look()
            watcher.see(pixels)
        return entry.conditions

    def _begin(self, step: Step, conditions: Conditions) -> StoredStack:
        pixel = np.uint8 if PIXEL_BITS[self.settings.pixel_format or "Mono16"] <= 8 else np.uint16
        shape = (self.settings.rows or 0, self.settings.columns or 0)
        return self.storage.begin_stack(
            step.label,
            step.kind,
            shape,
            pixel,
            conditions,
            asked=step.conditions,
            target=step.target,
        )

    def _fill(
        self, step: Step, stack: StoredStack, stored_frames: int, watcher: Watcher, clock: StepClock
    ) -> tuple[tuple[LostFrames, ...], str | None]:
        """Acquire frames until the stack is full or its criterion is met; return lost frames and
        the criterion.
        """
        frame_count, enough = stored_frames, watcher.enough() if stored_frames else None
        if frame_count >= step.frames or enough:
            self._shut(step, stack, clock)
            return (), enough
        allowed = step.max_saturated_fraction
        with ExitStack() as running:
            with clock.timing("wire_s"):
                capture = running.enter_context(
                    self.camera.capture(
                        frames=step.frames - stored_frames,
                        discard=DISCARDED_FRAMES,
                        while_waiting=self._look,
                    )
                )
            try:
                with self._doubting(stack):
                    for frame in clock.waiting_for(capture):
                        with clock.timing("wire_s"):
                            self._show(step, frame.pixels, allowed)
                            self._look()
                        self._freshness.see(frame)
                        stack.enqueue(frame)
                        frame_count += 1
                        watcher.see(frame.pixels)
                        self._tell(step, stack.acknowledged)
                        if enough := watcher.enough():
                            break
                self._shut(step, stack, clock)
            except BaseException as error:
                # Shut the gate before the camera is stopped, which may take long.
                make_safe_after(error, self.bench)
                with suppress(BadInput):
                    stack.lose(capture.losses)
                raise
            with clock.timing("wire_s"):
                running.close()
        return capture.losses, enough

    @property
    def _noise_dn(self) -> float | None:
        """Read noise by the description, DN; None if unknown."""
        if self.sensor is None or self.sensor.is_thermal:
            return None
        gain_dn_per_e = float(self.sensor.video.conversion_gain_dn_per_e)
        return gain_dn_per_e * float(self.sensor.ccd.read_noise_e)

    def _show(self, step: Step, pixels: NDArray, allowed: float) -> None:
        """Report the levels of a frame to the bench."""
        levels = self._levels(pixels, allowed)
        if step.kind == "dark" and not self.bench.dark_seen:
            self._take_dark(levels)
        self.bench.frame_seen(levels)
        if self.predict is not None and self._black_dn is not None and step.conditions.mcp_v:
            self._require_predicted(levels, self.predict(step.conditions))

    def _require_predicted(self, levels: FrameLevels, predicted_dn: float) -> None:
        """Require a frame to be no brighter than its step explains; BenchError otherwise."""
        full_dn, black_dn = self.full_scale_dn, self._black_dn or 0.0
        highest_dn = black_dn + PREDICTED_FACTOR * predicted_dn + PREDICTED_MARGIN * full_dn
        remedy = "find the light, or correct sensor, light or gate of the plan"
        if levels.mean * full_dn > highest_dn and not levels.allowed:
            raise BenchError.of(
                "light",
                f"keep the mean of a frame below {highest_dn:.4g} DN, as its step explains",
                f"{levels.mean * full_dn:.4g} DN: {remedy}",
            )
        is_below = black_dn + STRAY_FACTOR * predicted_dn < full_dn
        if is_below and levels.saturated > STRAY_SATURATION and not levels.allowed:
            raise BenchError.of(
                "light",
                f"saturate at most {STRAY_SATURATION:.1%} of the pixels at {predicted_dn:.4g} DN "
                "above black",
                f"{levels.saturated:.1%}: {remedy}, or state saturated_fraction in the step",
            )

    def _shut(self, step: Step, stack: StoredStack, clock: StepClock) -> None:
        """Verify the settings of the tube, then shut the gate before any target moves."""
        with self._doubting(stack), clock.timing("wire_s"):
            self.bench.verify()
            self.bench.set_conditions(replace(step.conditions, gate_ns=None))

    def _notes(
        self, stored_frames: int, anew: str | None, enough: str | None, watcher: Watcher
    ) -> tuple[str, ...]:
        filled_up = (
            f"broken off after {stored_frames} frames and filled up by a later run"
            if stored_frames
            else None
        )
        notes = (anew, filled_up, enough, watcher.complaint(), self._freshness.complaint())
        return tuple(note for note in notes if note)

    def _tell(self, step: Step, frames: int) -> None:
        sentence = f"{step.label}: {frames} of {step.frames} frames{self._pace.words(frames)}"
        self.progress(sentence, self._pace.share(frames))

    @contextmanager
    def _doubting(self, stack: StoredStack) -> Iterator[None]:
        """Mark the frames as doubtful if the bench fails: the gate may have closed before the error
        was reported.
        """
        try:
            yield
        except (CameraError, BenchStopped):  # all frames came before the gate was ordered shut
            raise
        except BenchError as error:
            with suppress(BadInput):
                stack.doubt(
                    f"the bench failed while they were taken, and the last may be dark: {error}"
                )
            raise


class Freshness:
    """Notices frames of a stack that equal an earlier one under another number.

    Noise makes every frame new, and a camera that repeats its pictures shows no light of the room.
    Where v parts vary from picture to picture, two are equal by a chance of exp(-v), and k repeats
    among n frames and m pictures happen by one of at most (n m exp(-v))^k: repeats that chance does
    not explain end the run, and others are noted. Parts are blocks of pixels, since an ion or a
    photoelectron shows in several. `pictures`: numbers of the frames of the run so far, by their
    digests; `is_bright`: whether the light of the step must show noise; `noise_dn`: read noise by
    the camera's description, DN; None if unknown.
    """

    def __init__(
        self, pictures: dict[int, int], *, is_bright: bool, noise_dn: float | None
    ) -> None:
        self._is_bright, self._noise_dn = is_bright, noise_dn
        self._pictures, self._frames, self._repeats = pictures, 0, 0
        self._newest: NDArray | None = None
        self._fewest_differing = math.inf  # Parts between two new pictures

    def see(self, frame: Frame) -> None:
        """Take a frame; repeats that chance does not explain are BenchError."""
        rows = frame.pixels[:: max(1, frame.pixels.nbytes // DIGEST_BYTES)]
        first = self._pictures.get(digest := hash(rows.tobytes()))
        self._pictures[digest] = frame.number
        self._frames += 1
        if first is None:
            if self._newest is not None:
                differing = _differing_blocks(rows, self._newest)
                self._fewest_differing = min(self._fewest_differing, differing)
            self._newest = rows
            return
        self._repeats += 1
        log_chance = math.log(self._frames * len(self._pictures)) - self._varying_parts(rows)
        if self._repeats * log_chance < LOG_CHANCE:
            raise BenchError.of(
                "camera",
                "send a new picture under each number",
                f"frame {frame.number} equal to frame {first}: restart the camera",
            )
        if log_chance >= 0.0:  # a quiet camera, whatever a later event shows
            self._fewest_differing = 0

    def complaint(self) -> str | None:
        """Return a sentence on repeated frames, or None."""
        return f"{self._repeats} frames equal an earlier one" if self._repeats else None

    def _varying_parts(self, pixels: NDArray) -> float:
        """Return how many parts vary: by light, between new pictures, else by the read noise."""
        if self._is_bright or self._fewest_differing < math.inf:
            return math.inf if self._is_bright else self._fewest_differing
        off_median = int(np.count_nonzero(pixels != np.median(pixels)))
        if self._noise_dn is None:
            return math.inf if off_median > VISIBLE_PIXELS * pixels.size else 0.0
        # Pixels of one level deviate by half a code; those of several lie at any part of one.
        noise_dn = max(NOISE_LEFT * self._noise_dn, 1e-9)
        deviating = math.erfc(0.5 / (math.sqrt(2.0) * noise_dn)) * pixels.size
        return deviating + min(1.0, noise_dn) * off_median


def _differing_blocks(first: NDArray, second: NDArray) -> int:
    """Return the number of blocks in which two pictures differ."""
    differs = first != second
    for axis, size in enumerate(differs.shape):
        differs = np.logical_or.reduceat(differs, range(0, size, BLOCK_PX), axis=axis)
    return int(np.count_nonzero(differs))


class _Unwatched:
    """Watcher without criterion: a stack has all its frames."""

    def see(self, pixels: NDArray) -> None: ...

    def enough(self) -> str | None:
        return None

    def is_saturated(self) -> bool:
        return False

    def complaint(self) -> str | None:
        return None


def _conditions_in_force(asked: Conditions, *read_back: Conditions) -> Conditions:
    """Return the conditions in force: read-backs where available, else set-points."""
    for part in read_back:
        known = {
            item.name: value
            for item in fields(Conditions)
            if (value := getattr(part, item.name)) is not None
        }
        asked = replace(asked, **known)
    return asked


def _require_same(before: Conditions, now: Conditions, *, label: str) -> None:
    """Require a continued stack to have its original conditions."""
    for item in fields(Conditions):
        if item.name in OBSERVED:
            continue
        first, second = getattr(before, item.name), getattr(now, item.name)
        if first is None or second is None:
            continue
        if abs(second - first) > (SAME_LIGHT if item.name == "illuminance_lux" else SAME) * abs(
            first
        ):
            raise BadInput(
                f"a resumed step must read back what it did in its first run, got {item.name} of "
                f"{second:g} after {first:g} in {label!r}"
            )


def make_safe_after(error: BaseException, bench: Bench) -> None:
    """Make the tube safe after an error; a second failure becomes a note of the error."""
    try:
        bench.safe()
    except BenchError as second:
        error.add_note(f"making the tube safe failed as well: {second}")
