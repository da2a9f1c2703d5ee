"""The storage thread writes beside the camera: bounded, in order, and each frame that it could not write is told."""

import errno
import os
import threading

import numpy as np
import pytest

from labdata.capture import Frame, LostFrames
from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.session import open_session
from labdata.store import SessionWriter
from labdata.store.storage import Storage

SHAPE = (49, 77)


def frames(count: int, first: int = 1) -> list[Frame]:
    return [
        Frame(pixels=np.full(SHAPE, n % 256, np.uint8), number=n, time_s=n / 30) for n in range(first, first + count)
    ]


@pytest.fixture
def writer(tmp_path):
    with SessionWriter.create(tmp_path / "s", name="test") as writer:
        yield writer


def begun(storage: Storage, label: str = "flat"):
    return storage.begin_stack(label, "flat", SHAPE, np.uint8, Conditions(mcp_v=700.0))


class Disk:
    """A disk whose every forcing can be held up, or fails."""

    def __init__(self, monkeypatch) -> None:
        self.go_on = threading.Event()
        self.go_on.set()
        self.full = False
        self._fsync = os.fsync
        monkeypatch.setattr(os, "fsync", self.fsync)

    def fsync(self, file: int) -> None:
        self.go_on.wait(10.0)
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")
        self._fsync(file)


def test_frames_of_several_stacks_arrive_whole_and_in_order(writer):
    with Storage(writer) as storage:
        for label in ("a", "b"):
            stack = begun(storage, label)
            for frame in frames(40):
                stack.put(frame)
            stack.finish(losses=(LostFrames(first=41, last=42, reason="missing packets"),))
        storage.wait()
        assert stack.acknowledged == 40
    for entry in open_session(writer.folder).stacks:
        assert entry.finished
        assert entry.read().frame_number.tolist() == list(range(1, 41))
        assert entry.read().data[:, 0, 0].tolist() == list(range(1, 41))
        assert entry.lost_frames == 2


def test_the_camera_does_not_wait_for_a_disk_that_is_slow_for_a_moment(writer, monkeypatch):
    disk = Disk(monkeypatch)
    with Storage(writer) as storage:
        stack = begun(storage)
        storage.wait()
        disk.go_on.clear()
        for frame in frames(20):
            stack.put(frame)
        assert stack.acknowledged == 0
        disk.go_on.set()
        storage.wait()
        assert stack.acknowledged == 20


def test_a_queue_that_stays_full_ends_in_a_sentence_and_the_frame_has_a_reason(writer, monkeypatch):
    disk = Disk(monkeypatch)
    size = SHAPE[0] * SHAPE[1]
    with Storage(writer, capacity_bytes=5 * size, patience_s=0.05) as storage:
        stack = begun(storage)
        first, *rest = frames(20)
        stack.put(first)
        storage.wait()
        disk.go_on.clear()
        with pytest.raises(BadInput, match=r"the disk must keep up with the camera, got \d frames waiting for 0\.05 s"):
            for frame in rest:
                stack.put(frame)
        assert storage.waiting_bytes <= 5 * size
        disk.go_on.set()
    entry = open_session(writer.folder).stack("flat")
    assert not entry.finished
    taken = len(entry.read())
    assert [(one.first, one.last) for one in entry.losses] == [(taken + 1, taken + 1)]
    assert "did not keep up" in entry.losses[0].reason


def test_a_full_disk_ends_the_writing_and_every_frame_that_waited_has_number_and_reason(writer, monkeypatch):
    disk = Disk(monkeypatch)
    refusal = "the disk must take every frame, got 'No space left on device' after 3 frames"
    with pytest.raises(BadInput, match=refusal), Storage(writer) as storage:
        stack = begun(storage)
        for frame in frames(3):
            stack.put(frame)
        storage.wait()
        disk.go_on.clear()
        for frame in frames(5, first=4):
            stack.put(frame)
        # The room that was kept for it takes the manifest.
        monkeypatch.setattr(storage._reserve, "release", lambda: setattr(disk, "full", False))
        disk.full = True
        disk.go_on.set()
        storage.wait()
    entry = open_session(writer.folder).stack("flat")
    assert len(entry.read()) == 3
    assert [(one.first, one.last) for one in entry.losses] == [(4, 8)]
    assert "No space left" in entry.losses[0].reason


def test_after_a_failure_nothing_more_is_taken(writer, monkeypatch):
    disk = Disk(monkeypatch)
    storage = Storage(writer)
    with pytest.raises(BadInput, match="No space left"), storage:
        stack = begun(storage)
        storage.wait()
        disk.full = True
        stack.put(frames(1)[0])
        with pytest.raises(BadInput, match="No space left"):
            storage.wait()
        for action in (lambda: stack.put(frames(1)[0]), stack.finish, lambda: begun(storage, "other")):
            with pytest.raises(BadInput, match="No space left"):
                action()
        disk.full = False
    assert not (writer.folder / ".reserve").exists()


def test_what_is_doubted_is_doubted_after_its_frames(writer):
    with Storage(writer) as storage:
        stack = begun(storage)
        for frame in frames(5):
            stack.put(frame)
        stack.doubt("the gate was shut")
    assert writer.doubtful == {"flat": "the gate was shut"}
    assert len(open_session(writer.folder).stack("flat").read()) == 5


def test_a_stack_that_may_not_be_begun_is_told_when_its_frames_come(writer):
    with pytest.raises(BadInput, match="a complete stack cannot be begun again"), Storage(writer) as storage:
        for _ in range(2):
            stack = begun(storage)
            stack.put(frames(1)[0])
            stack.finish()
        storage.wait()
