"""Storage thread: a bounded queue between the camera and the disk."""

import os
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from labdata.capture import Frame, LostFrames, lost_frames_with_reason
from labdata.errors import BadInput
from labdata.file_io import call_at_syncs
from labdata.session_writer import SessionWriter, StackWriter

# Queued bytes of frames: 11 s of a 768 x 493 camera of 16 bits; a busy disk pauses for several
# seconds
CAPACITY_BYTES = 256 << 20

# Bytes per sync of the disk: more gain nothing and delay the acknowledgement
TOGETHER_BYTES = 12 << 20
# Longest wait for space in the queue, s; a camera driver buffers two seconds at 30 frames/s
PATIENCE_S = 0.4


# Longest time without progress before the disk is considered stuck, s; a busy disk pauses for
# several seconds
STALLED_S = 10.0

LOOK_S = 0.1  # Polling interval of the progress of the disk, s
# Bytes reserved on the session's disk for the last entries of manifest and log
RESERVE_BYTES = 1 << 20


class Storage:
    """Writes the stacks of a session in a separate thread; use it in a `with` block.

    The first disk error ends all writing: frames not yet acknowledged are recorded as lost, with
    numbers and reason, in the reserved space; every later call raises that error. A disk without
    progress for `STALLED_S` during `wait` or at the end of the block is an error too. At most
    `capacity_bytes` wait, and a frame waits `patience_s` for room.
    """

    def __init__(
        self,
        writer: SessionWriter,
        *,
        capacity_bytes: int = CAPACITY_BYTES,
        patience_s: float = PATIENCE_S,
    ) -> None:
        self._writer, self._capacity, self._patience_s = writer, capacity_bytes, patience_s
        self._jobs: deque[_Job] = deque()
        self.waiting_bytes = 0  # Queued bytes of frames
        self._open_stack: StackWriter | None = None
        self._turn = threading.Condition()
        self._in_hand: list[_Job] = []
        self._idle, self._over, self._ended = True, False, False
        self._progress_s = time.monotonic()
        self.failure: Exception | None = None  # The error that ended writing, if any
        self._thread = threading.Thread(target=self._work, name="storage", daemon=True)

    def __enter__(self) -> Self:
        self._reserve = Reserve(self._writer.folder)
        self._thread.start()
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        with self._turn:
            self._over = True
            self._progress_s = time.monotonic() if self._idle else self._progress_s
            self._turn.notify_all()
            self._wait_for(lambda: self._ended)
        if self.failure is not None and error is None:
            raise self.failure
        if self.failure is not None and error is not None and error is not self.failure:
            error.add_note(str(self.failure))

    @property
    def stall_s(self) -> float:
        """Time without progress of the disk while work is queued, s; 0 without queued work."""
        return 0.0 if self._idle else time.monotonic() - self._progress_s

    def begin_stack(self, *settings: Any, **named: Any) -> "StoredStack":
        """Begin a stack as by `SessionWriter.begin_stack`, without waiting; the previous one is
        closed.
        """
        stack = StoredStack(self)
        self.post(lambda: self._open(stack, *settings, **named))
        return stack

    def post(self, work: Callable[[], object]) -> None:
        """Run a task in the thread after all queued work; does not wait."""
        self._enqueue(_Job(work=work))

    def set_aside(self, label: str) -> Path:
        """Set an interrupted stack aside as by `SessionWriter.set_aside`; waits for it."""
        where: list[Path] = []
        self.post(lambda: where.append(self._writer.set_aside(label)))
        self.wait()
        return where[0]

    def remark(self, note: str) -> None:
        """Add a remark to the session, without waiting for it."""
        self.post(lambda: self._writer.add_note(note))

    def wait(self) -> None:
        """Wait for all queued work; raise its error, or that the disk makes no progress."""
        with self._turn:
            self._wait_for(lambda: not self._jobs and self._idle)
        self._raise_failure()

    def enqueue(self, stack: "StoredStack", frame: Frame) -> None:
        """Queue a frame; if the queue stays full, the frame is recorded as lost and BadInput is
        raised.
        """
        size = frame.pixels.nbytes
        with self._turn:
            room = self._turn.wait_for(
                lambda: (
                    self.failure is not None
                    or self.waiting_bytes + size <= max(self._capacity, size)
                ),
                self._patience_s,
            )
            waiting = sum(job.frame is not None for job in self._jobs)
        if not room:
            why = f"the disk did not keep up: {waiting} frames waited"
            stack.lose(lost_frames_with_reason(why, [frame.number]))
            raise BadInput(
                f"the disk must keep up with the camera, got {waiting} frames waiting for "
                f"{self._patience_s:g} s"
            )
        self._enqueue(_Job(stack=stack, frame=frame))

    def _enqueue(self, job: "_Job") -> None:
        self._raise_failure()
        with self._turn:
            if self._idle:
                self._idle, self._progress_s = False, time.monotonic()
            self._jobs.append(job)
            self.waiting_bytes += job.bytes
            self._turn.notify_all()

    def _raise_failure(self) -> None:
        if self.failure is not None:
            raise self.failure

    def _wait_for(self, condition: Callable[[], bool]) -> None:
        """Wait, with the lock held, until a condition is true or the disk is considered stuck."""
        while not self._turn.wait_for(condition, LOOK_S):
            if self.stall_s > STALLED_S:
                return self._give_up()

    def _give_up(self) -> None:
        """Accept no further work; a thread that continues still writes the queue."""
        frames = sum(job.frame is not None for job in (*self._in_hand, *self._jobs))
        self.failure = self.failure or BadInput(
            f"the disk must take every frame, got no progress for {STALLED_S:g} s: {frames} "
            f"frames of {self._writer.folder} are not acknowledged"
        )

    # In the thread

    def _work(self) -> None:
        call_at_syncs(self._note_progress)
        while jobs := self._next():
            try:
                self._do(jobs)
            except Exception as error:  # raised again where frames are queued
                self._fail(error, jobs)
            with self._turn:
                self.waiting_bytes -= sum(job.bytes for job in jobs)
                self._in_hand, self._progress_s = [], time.monotonic()
                self._idle = not self._jobs
                self._turn.notify_all()
        try:
            self._close_stack()
            self._reserve.release()
        except OSError as error:
            self.failure = self.failure or _refusal_of(error)
        with self._turn:
            self._idle = self._ended = True
            self._turn.notify_all()

    def _note_progress(self) -> None:
        """Count a sync as progress: a slow disk that goes on is not stuck."""
        self._progress_s = time.monotonic()

    def _next(self) -> list["_Job"]:
        """Wait for work: one task, or frames of one stack that can be written together; [] at the
        end.
        """
        with self._turn:
            self._idle = not self._jobs
            self._turn.notify_all()
            self._turn.wait_for(lambda: self._jobs or self._over)
            self._idle = False
            jobs, size = [], 0
            while self._jobs and (not jobs or self._jobs[0].goes_with(jobs[0])):
                size += self._jobs[0].bytes
                if jobs and size > TOGETHER_BYTES:
                    break
                jobs.append(self._jobs.popleft())
            self._in_hand = list(jobs)
            return jobs

    def _open(self, stack: "StoredStack", *settings: Any, **named: Any) -> None:
        self._close_stack()
        self._open_stack = self._writer.begin_stack(*settings, **named)
        stack.attach(self._open_stack)

    def _close_stack(self) -> None:
        if self._open_stack is not None:
            self._open_stack.close()

    def _do(self, jobs: list["_Job"]) -> None:
        stack, work = jobs[0].stack, jobs[0].work
        if stack is not None:
            stack.write([job.frame for job in jobs if job.frame is not None])
        elif work is not None:
            work()

    def _fail(self, error: Exception, jobs: list["_Job"]) -> None:
        with self._turn:
            jobs += self._jobs
            self._jobs.clear()
            cause = _refusal_of(error) if isinstance(error, OSError) else error
            self.failure = self.failure or cause
        self._reserve.release()
        for stack in dict.fromkeys(job.stack for job in jobs if job.stack is not None):
            numbers = [
                job.frame.number for job in jobs if job.stack is stack and job.frame is not None
            ]
            stack.record_lost(lost_frames_with_reason(f"not stored: {error}", numbers))


def _refusal_of(error: OSError) -> BadInput:
    """Return the sentence for a disk that does not take a file of the session."""
    file = f" at {error.filename}" if error.filename else ""
    return BadInput(
        f"the disk must take what a session records, got {error.strerror!r}{file}; make room or "
        "mend the disk, then resume"
    )


@dataclass(frozen=True)
class _Job:
    """A frame of a stack, or a task."""

    work: Callable[[], object] | None = None
    stack: "StoredStack | None" = None
    frame: Frame | None = None

    @property
    def bytes(self) -> int:
        return 0 if self.frame is None else self.frame.pixels.nbytes

    def goes_with(self, other: "_Job") -> bool:
        return self.stack is not None and self.stack is other.stack


class StoredStack:
    """Handle of one stack in the acquiring thread; made by `Storage.begin_stack`."""

    def __init__(self, storage: Storage) -> None:
        self._storage = storage
        self._writer: StackWriter | None = None
        self.acknowledged = 0  # Frames on the disk, including those of an earlier run

    def enqueue(self, frame: Frame) -> None:
        """Queue a frame; see `Storage.enqueue`."""
        self._storage.enqueue(self, frame)

    def finish(self, losses: tuple[LostFrames, ...] = (), notes: tuple[str, ...] = ()) -> None:
        """Mark the stack as complete once its frames are stored; does not wait."""
        self._storage.post(lambda: self._open_writer.finish(losses, notes))

    def lose(self, losses: tuple[LostFrames, ...]) -> None:
        """Record lost frames; does not wait."""
        self._storage.post(lambda: self._open_writer.lose(losses))

    def doubt(self, why: str) -> None:
        """Record a reason to doubt the frames so far, once they are stored; does not wait."""
        self._storage.post(lambda: self._open_writer.doubt(why))

    # In the thread

    def attach(self, writer: StackWriter) -> None:
        """Take the writer."""
        self._writer, self.acknowledged = writer, len(writer)

    def write(self, frames: list[Frame]) -> None:
        """Write frames together."""
        self._open_writer.extend(frames)
        self.acknowledged = len(self._open_writer)

    def record_lost(self, losses: tuple[LostFrames, ...]) -> None:
        """Record frames that the disk did not accept; if that fails, the first error is still
        reported.
        """
        try:
            if self._writer is not None:
                self._writer.lose(losses)
        except (BadInput, OSError) as second:
            if self._storage.failure is not None:
                self._storage.failure.add_note(
                    f"what was lost could not be recorded in the session: {second}"
                )

    @property
    def _open_writer(self) -> StackWriter:
        assert self._writer is not None
        return self._writer


class Reserve:
    """Space reserved on a session's disk, so that a full disk can still store the manifest and the
    log.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / ".reserve"
        with open(self._path, "wb") as file:
            file.write(b"\0" * RESERVE_BYTES)
            file.flush()
            os.fsync(file.fileno())

    def release(self) -> None:
        """Release the space."""
        self._path.unlink(missing_ok=True)
