"""Frames are stored as they come, on disks that are slow, full or gone."""

import errno
import json
import os
import shutil
import subprocess
import sys
import textwrap
import threading
import time

import numpy as np
import pytest

from labdata import BadInput, Conditions, Frame, LostFrames, SessionWriter, Storage, open_session

# The storage thread writes beside the camera: bounded, in order, and each frame that it could not
# write is told.


SHAPE = (49, 77)


def frames(count: int, first: int = 1) -> list[Frame]:
    return [
        Frame(pixels=np.full(SHAPE, n % 256, np.uint8), number=n, time_s=n / 30)
        for n in range(first, first + count)
    ]


@pytest.fixture
def writer(tmp_path):
    with SessionWriter.create(tmp_path / "s", name="test") as writer:
        yield writer


def begun(storage: Storage, label: str = "flat", count: int = 0):
    """A stack of which some frames wait."""
    stack = storage.begin_stack(label, "flat", SHAPE, np.uint8, Conditions(mcp_v=700.0))
    for frame in frames(count):
        stack.enqueue(frame)
    return stack


class Disk:
    """A disk whose every forcing can be held up, or fails."""

    def __init__(self, monkeypatch) -> None:
        self.go_on = threading.Event()
        self.go_on.set()
        self.full = False
        self._fsync = os.fsync
        monkeypatch.setattr(os, "fsync", self.fsync)

    def fsync(self, file: int) -> None:
        self.go_on.wait(30.0)
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")
        self._fsync(file)


def test_frames_of_several_stacks_arrive_whole_and_in_order(writer):
    with Storage(writer) as storage:
        for label in ("a", "b"):
            stack = begun(storage, label, count=40)
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
            stack.enqueue(frame)
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
        stack.enqueue(first)
        storage.wait()
        disk.go_on.clear()
        with pytest.raises(
            BadInput,
            match=r"the disk must keep up with the camera, got \d frames waiting for 0\.05 s",
        ):
            for frame in rest:
                stack.enqueue(frame)
        assert storage.waiting_bytes <= 5 * size
        disk.go_on.set()
    entry = open_session(writer.folder).stack("flat")
    assert not entry.finished
    taken = len(entry.read())
    assert [(one.first, one.last) for one in entry.losses] == [(taken + 1, taken + 1)]
    assert "did not keep up" in entry.losses[0].reason


def test_a_disk_that_is_full_before_the_first_frame_ends_in_a_sentence_too(writer, monkeypatch):
    disk = Disk(monkeypatch)
    refusal = "the disk must take what a session records, got 'No space left on device'"
    with pytest.raises(BadInput, match=refusal), Storage(writer) as storage:
        disk.full = True
        begun(storage)
        storage.wait()


def test_a_full_disk_ends_the_writing_and_every_frame_that_waited_has_number_and_reason(
    writer, monkeypatch
):
    disk = Disk(monkeypatch)
    refusal = "the disk must take every frame, got 'No space left on device' after 3 frames"
    with pytest.raises(BadInput, match=refusal), Storage(writer) as storage:
        stack = begun(storage, count=3)
        storage.wait()
        disk.go_on.clear()
        for frame in frames(5, first=4):
            stack.enqueue(frame)
        # The room that was kept for it takes the manifest.
        monkeypatch.setattr(storage._reserve, "release", lambda: setattr(disk, "full", False))
        disk.full = True
        disk.go_on.set()
        storage.wait()
    entry = open_session(writer.folder).stack("flat")
    assert len(entry.read()) == 3
    assert [(one.first, one.last) for one in entry.losses] == [(4, 8)]
    assert "No space left" in entry.losses[0].reason


def test_what_is_doubted_is_doubted_after_its_frames(writer):
    with Storage(writer) as storage:
        stack = begun(storage, count=5)
        stack.doubt("the gate was shut")
    assert writer.doubtful == {"flat": "the gate was shut"}
    assert len(open_session(writer.folder).stack("flat").read()) == 5


def test_a_stack_that_may_not_be_begun_is_told_when_its_frames_come(writer):
    with (
        pytest.raises(BadInput, match="a complete stack cannot be begun again"),
        Storage(writer) as storage,
    ):
        for _ in range(2):
            stack = begun(storage, count=1)
            stack.finish()
        storage.wait()


def test_a_disk_is_stalled_while_work_waits_and_nothing_moves(writer, monkeypatch):
    disk = Disk(monkeypatch)
    with Storage(writer) as storage:
        assert storage.stall_s == 0.0
        stack = begun(storage)
        storage.wait()
        storage._progress_s -= 1000.0
        assert storage.stall_s == 0.0
        disk.go_on.clear()
        stack.enqueue(frames(1)[0])
        # The time in which no work waited does not count.
        assert storage.stall_s < 500.0
        time.sleep(0.1)
        assert storage.stall_s >= 0.1
        disk.go_on.set()
        storage.wait()
        assert storage.stall_s == 0.0


def test_each_sync_of_a_slow_disk_is_progress(writer, monkeypatch):
    fsync = os.fsync
    monkeypatch.setattr(os, "fsync", lambda file: (time.sleep(0.1), fsync(file)))
    with Storage(writer) as storage:
        stack, stalls = begun(storage), []
        for frame in frames(4):
            stack.enqueue(frame)
        began_s = time.monotonic()
        while stack.acknowledged < 4:
            stalls.append(storage.stall_s)
            time.sleep(0.01)
    assert time.monotonic() - began_s > 0.5 and max(stalls) < 0.4


def test_a_frozen_disk_is_given_up_and_the_frames_that_it_did_not_take_are_counted(
    writer, monkeypatch
):
    monkeypatch.setattr("labdata.storage_thread.STALLED_S", 0.3)
    disk = Disk(monkeypatch)
    sentence = r"got no progress for 0\.3 s: 5 frames of .* are not acknowledged"
    began_s = 0.0
    with pytest.raises(BadInput, match=sentence), Storage(writer) as storage:
        stack = begun(storage, count=3)
        storage.wait()
        disk.go_on.clear()
        for frame in frames(5, first=4):
            stack.enqueue(frame)
        began_s = time.monotonic()
    assert time.monotonic() - began_s < 3.0
    # The disk comes back before the process ends: what waited is written after all.
    disk.go_on.set()
    storage._thread.join(5.0)
    assert not storage._thread.is_alive()
    assert open_session(writer.folder).stack("flat").read().frame_number.tolist() == list(
        range(1, 9)
    )


def test_an_error_in_the_block_keeps_its_name_and_tells_of_the_frozen_disk_as_well(
    writer, monkeypatch
):
    monkeypatch.setattr("labdata.storage_thread.STALLED_S", 0.2)
    disk = Disk(monkeypatch)
    with pytest.raises(KeyboardInterrupt) as interrupted, Storage(writer) as storage:
        stack = begun(storage)
        storage.wait()
        disk.go_on.clear()
        stack.enqueue(frames(1)[0])
        raise KeyboardInterrupt
    assert "1 frames of" in interrupted.value.__notes__[0]
    disk.go_on.set()
    storage._thread.join(5.0)


def test_a_disk_that_is_slow_but_moves_is_waited_for(writer, monkeypatch):
    """Each group of frames takes less than the bound, all of them together far more."""
    monkeypatch.setattr("labdata.storage_thread.STALLED_S", 0.4)
    monkeypatch.setattr("labdata.storage_thread.TOGETHER_BYTES", SHAPE[0] * SHAPE[1])
    forced = os.fsync
    monkeypatch.setattr(os, "fsync", lambda file: (time.sleep(0.03), forced(file))[1])
    with Storage(writer) as storage:
        begun(storage, count=8)
    assert len(open_session(writer.folder).stack("flat").read()) == 8


STUCK = """
import os, sys, threading
import numpy as np
from labdata.capture import Frame
from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata import storage_thread
from labdata.session_writer import SessionWriter

storage_thread.STALLED_S = 0.3
writer = SessionWriter.create(sys.argv[1], name="stuck")
try:
    with storage_thread.Storage(writer) as disk:
        stack = disk.begin_stack("flat", "flat", (4, 4), np.uint8, Conditions())
        disk.wait()
        os.fsync = lambda file: threading.Event().wait()
        stack.enqueue(Frame(pixels=np.zeros((4, 4), np.uint8), number=1, time_s=0.0))
except BadInput as error:
    print(error)
"""


def test_a_process_whose_disk_is_frozen_ends(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", STUCK, tmp_path / "s"], capture_output=True, text=True, timeout=30
    )
    assert done.returncode == 0 and "1 frames of" in done.stdout


# A disk that is really full ends a session cleanly: what it took is whole, all else has its number
# and reason.


DISK_BYTES = 4 << 20

# A file system of its own, seen by this process alone, so that no rights are needed and nothing is
# left behind.
MOUNTED = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c"]
CHILD = """
    import json, sys
    from pathlib import Path
    import numpy as np
    from labdata.capture import Frame
    from labdata.conditions import Conditions
    from labdata.errors import BadInput
    from labdata.session import open_session
    from labdata.session_writer import SessionWriter
    from labdata.storage_thread import Storage

    folder, said = Path(sys.argv[1]) / "s", None
    pixels = np.random.default_rng(1).integers(0, 4096, (200, 300), dtype=np.uint16)
    writer = SessionWriter.create(folder, name="full", sensor=None, bit_depth=12, interlaced=None)
    try:
        with Storage(writer) as storage:
            stack = storage.begin_stack("flat", "flat", pixels.shape, np.uint16, Conditions())
            for number in range(1, 101):
                stack.enqueue(Frame(pixels=pixels ^ number, number=number, time_s=float(number)))
                if number % 5 == 0:
                    storage.wait()
    except BadInput as error:
        said = str(error)
    entry = open_session(folder).stack("flat")
    read = entry.read()
    print(json.dumps({
        "said": said,
        "acknowledged": stack.acknowledged,
        "whole": [
            int(n)
            for n, frame in zip(read.frame_number, read.data)
            if (frame == pixels ^ int(n)).all()
        ],
        "finished": entry.finished,
        "lost": [(one.first, one.last, one.reason) for one in entry.losses],
    }))
"""


def on_a_small_disk(folder) -> dict:
    """Run the child on a file system of a few megabytes; skipped where nobody may mount one."""
    mount = f"mount -t tmpfs -o size={DISK_BYTES} none {folder}"
    if (
        shutil.which("unshare") is None
        or subprocess.run([*MOUNTED, mount], capture_output=True).returncode
    ):
        pytest.skip("nobody may mount a small disk here")
    child = [sys.executable, "-c", textwrap.dedent(CHILD), str(folder)]
    done = subprocess.run(
        [*MOUNTED, f'{mount} && exec "$@"', "sh", *child],
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_what_a_full_disk_acknowledged_is_whole_and_the_rest_is_told(tmp_path):
    told = on_a_small_disk(tmp_path)
    assert "the disk must take every frame, got 'No space left on device'" in told["said"]
    assert not told["finished"]
    assert 5 < told["acknowledged"] < DISK_BYTES / 120_000
    assert told["whole"] == list(range(1, len(told["whole"]) + 1))
    assert len(told["whole"]) == told["acknowledged"]
    (first, last, reason), *_ = told["lost"]
    assert first == told["acknowledged"] + 1 and last <= told["acknowledged"] + 5
    assert "No space left" in reason
