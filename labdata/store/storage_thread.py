"""The storage thread: frames are written beside the camera through a bounded queue, and none is lost in silence."""

import os
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from labdata.capture import Frame, LostFrames, lost_frames_with_reason
from labdata.errors import BadInput
from labdata.store.session_writer import SessionWriter, StackWriter

CAPACITY_BYTES = 256 << 20
"""Bytes of frames that may wait for the disk: 11 s of a 768 x 493 camera of 16 bits, as a busy disk pauses for some."""

TOGETHER_BYTES = 12 << 20
"""Bytes that are forced to the disk together: more gains nothing and acknowledges late."""

PATIENCE_S = 0.4
"""Longest wait for room in the queue, s; a camera's driver buffers two seconds at 30 frames/s."""


STALLED_S = 10.0
"""Longest time without any progress, s, after which a disk is given up: a busy one pauses for some seconds."""

LOOK_S = 0.1
"""Time between two looks at the progress of the disk, s."""

RESERVE_BYTES = 1 << 20
"""Bytes of the session's disk that are kept free for its last words."""


class Storage:
    """Writes the stacks of a session in a thread of its own, between `with` and the end of its block.

    The first error of the disk ends all writing: what was not acknowledged by then is recorded as lost, with numbers
    and reason, in the room that was kept for it; every later call raises that error. A disk that makes no progress for
    `STALLED_S` while `wait` or the end of the block waits for it is given up with an error, too.

    Parameters
    ----------
    writer
        The session; nobody else may use it meanwhile.
    capacity_bytes
        Bytes of frames that may wait.
    patience_s
        Longest wait for room, s.
    """

    def __init__(
        self, writer: SessionWriter, *, capacity_bytes: int = CAPACITY_BYTES, patience_s: float = PATIENCE_S
    ) -> None:
        self._writer, self._capacity, self._patience_s = writer, capacity_bytes, patience_s
        self._jobs: deque[_Job] = deque()
        self._waiting_bytes = 0
        self._open_stack: StackWriter | None = None
        self._turn = threading.Condition()
        self._in_hand: list[_Job] = []
        self._idle, self._over, self._ended = True, False, False
        self._progress_s = time.monotonic()
        self.failure: Exception | None = None
        """What ended the writing, if anything did."""
        self._thread = threading.Thread(target=self._work, name="storage", daemon=True)

    def __enter__(self) -> Self:
        self._reserve = Reserve(self._writer.folder)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
    def waiting_bytes(self) -> int:
        """Bytes of frames that wait for the disk."""
        return self._waiting_bytes

    @property
    def stall_s(self) -> float:
        """Time for which the disk has made no progress while work waits for it, s; 0 where none waits."""
        return 0.0 if self._idle else time.monotonic() - self._progress_s

    def begin_stack(self, *settings: Any, **named: Any) -> "StoredStack":
        """Begin a stack as `SessionWriter.begin_stack` does, without waiting; the one before is left as it is."""
        stack = StoredStack(self)
        self.post(lambda: self._open(stack, *settings, **named))
        return stack

    def post(self, work: Callable[[], object]) -> None:
        """Have something done in the thread, after all that was asked before; does not wait."""
        self._put(_Job(work=work))

    def set_aside(self, label: str) -> Path:
        """Take a stack that was broken off out of the session, as `SessionWriter.set_aside` does; waits for it."""
        where: list[Path] = []
        self.post(lambda: where.append(self._writer.set_aside(label)))
        self.wait()
        return where[0]

    def remark(self, note: str) -> None:
        """Add a remark to the session, without waiting for it."""
        self.post(lambda: self._writer.add_note(note))

    def wait(self) -> None:
        """Wait until all that was asked is done; raise what went wrong, or that the disk makes no progress."""
        with self._turn:
            self._wait_for(lambda: not self._jobs and self._idle)
        self._raise_failure()

    def put(self, stack: "StoredStack", frame: Frame) -> None:
        """Queue a frame; a queue that stays full is a BadInput, and the frame is recorded as lost."""
        size = frame.pixels.nbytes
        with self._turn:
            room = self._turn.wait_for(
                lambda: self.failure is not None or self._waiting_bytes + size <= max(self._capacity, size),
                self._patience_s,
            )
            waiting = sum(job.frame is not None for job in self._jobs)
        if not room:
            why = f"the disk did not keep up: {waiting} frames waited"
            stack.lose(lost_frames_with_reason(why, [frame.number]))
            raise BadInput(
                f"the disk must keep up with the camera, got {waiting} frames waiting for {self._patience_s:g} s"
            )
        self._put(_Job(stack=stack, frame=frame))

    def _put(self, job: "_Job") -> None:
        self._raise_failure()
        with self._turn:
            if self._idle:
                self._idle, self._progress_s = False, time.monotonic()
            self._jobs.append(job)
            self._waiting_bytes += job.bytes
            self._turn.notify_all()

    def _raise_failure(self) -> None:
        if self.failure is not None:
            raise self.failure

    def _wait_for(self, condition: Callable[[], bool]) -> None:
        """Wait, holding the turn, until a condition holds or the disk is given up."""
        while not self._turn.wait_for(condition, LOOK_S):
            if self.stall_s > STALLED_S:
                return self._give_up()

    def _give_up(self) -> None:
        """Take nothing more: the thread may hang for ever, and if it does not, it still writes what waits."""
        frames = sum(job.frame is not None for job in (*self._in_hand, *self._jobs))
        self.failure = self.failure or BadInput(
            f"the disk must take every frame, got no progress for {STALLED_S:g} s: {frames} frames of "
            f"{self._writer.folder} are not acknowledged"
        )

    # In the thread

    def _work(self) -> None:
        while jobs := self._next():
            try:
                self._do(jobs)
            except Exception as error:  # whatever it is, it is raised where frames are put
                self._fail(error, jobs)
            with self._turn:
                self._waiting_bytes -= sum(job.bytes for job in jobs)
                self._in_hand, self._progress_s = [], time.monotonic()
                self._idle = not self._jobs
                self._turn.notify_all()
        try:
            self._close_stack()
            self._reserve.release()
        except OSError as error:
            self.failure = self.failure or error
        with self._turn:
            self._idle = self._ended = True
            self._turn.notify_all()

    def _next(self) -> list["_Job"]:
        """Wait for work: one thing to do, or frames of one stack that can be written together; [] at the end."""
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
        stack.opened(self._open_stack)

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
            self.failure = self.failure or error
        self._reserve.release()
        for stack in dict.fromkeys(job.stack for job in jobs if job.stack is not None):
            numbers = [job.frame.number for job in jobs if job.stack is stack and job.frame is not None]
            stack.record_lost(lost_frames_with_reason(f"not stored: {error}", numbers))


@dataclass(frozen=True)
class _Job:
    """A frame of a stack, or something to do."""

    work: Callable[[], object] | None = None
    stack: "StoredStack | None" = None
    frame: Frame | None = None

    @property
    def bytes(self) -> int:
        return 0 if self.frame is None else self.frame.pixels.nbytes

    def goes_with(self, other: "_Job") -> bool:
        return self.stack is not None and self.stack is other.stack


class StoredStack:
    """One stack as the acquiring thread sees it; made by `Storage.begin_stack`."""

    def __init__(self, storage: Storage) -> None:
        self._storage = storage
        self._writer: StackWriter | None = None
        self.acknowledged = 0
        """Frames that are on the disk, those of an earlier run included."""

    def put(self, frame: Frame) -> None:
        """Queue a frame; see `Storage.put`."""
        self._storage.put(self, frame)

    def finish(self, losses: tuple[LostFrames, ...] = (), notes: tuple[str, ...] = ()) -> None:
        """Mark the stack as complete once its frames are stored; does not wait."""
        self._storage.post(lambda: self._known.finish(losses, notes))

    def lose(self, losses: tuple[LostFrames, ...]) -> None:
        """Record frames that are not here; does not wait."""
        self._storage.post(lambda: self._known.lose(losses))

    def doubt(self, why: str) -> None:
        """Say why the frames so far may not show what the stack says, once they are stored; does not wait."""
        self._storage.post(lambda: self._known.doubt(why))

    # In the thread

    def opened(self, writer: StackWriter) -> None:
        """Take the writer."""
        self._writer, self.acknowledged = writer, len(writer)

    def write(self, frames: list[Frame]) -> None:
        """Write frames together."""
        self._known.extend(frames)
        self.acknowledged = len(self._known)

    def record_lost(self, losses: tuple[LostFrames, ...]) -> None:
        """Record frames that the disk did not take; where even that fails, the first error is told all the same."""
        try:
            if self._writer is not None:
                self._writer.lose(losses)
        except (BadInput, OSError) as second:
            if self._storage.failure is not None:
                self._storage.failure.add_note(f"what was lost could not be recorded in the session: {second}")

    @property
    def _known(self) -> StackWriter:
        assert self._writer is not None
        return self._writer


class Reserve:
    """Room kept free on a disk, so that a full one still takes a last manifest and a last line of the log.

    Parameters
    ----------
    folder
        The session's folder.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / ".reserve"
        with open(self._path, "wb") as file:
            file.write(b"\0" * RESERVE_BYTES)
            file.flush()
            os.fsync(file.fileno())

    def release(self) -> None:
        """Give the room back."""
        self._path.unlink(missing_ok=True)
