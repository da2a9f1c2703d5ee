"""Writers in the background lose nothing and never stand in the way: frames, events."""

import errno
import json
import os
import threading
import time

import pytest

from labdata import BackgroundWriter, BadInput, EventLog, event_log, read_events

# What waits for a file delays nobody: queueing never waits, and each item is written or counted.


# What must not wait returns within this, s: a fifth of the time in which a tube must be safe
SOON_S = 0.2


class Stuck:
    """A write that returns only when it is let go."""

    def __init__(self) -> None:
        self.reached, self.go_on = threading.Event(), threading.Event()
        self.written: list[int] = []

    def __call__(self, item: int) -> None:
        self.reached.set()
        self.go_on.wait()
        self.written.append(item)


@pytest.fixture
def stuck():
    stuck = Stuck()
    yield stuck
    stuck.go_on.set()


def test_items_are_written_in_order_and_the_end_comes_after_the_last():
    written: list[object] = []
    writer = BackgroundWriter(written.append, name="test", finish=lambda: written.append("end"))
    for item in range(1000):
        writer.enqueue(item)
    assert writer.flush(5.0) and written == list(range(1000))
    writer.enqueue(1000)
    assert writer.close(5.0) == 0
    assert written == [*range(1001), "end"]


def test_what_fails_is_counted_and_the_next_is_written_all_the_same():
    written = []

    def write(item: int) -> None:
        if item % 3 == 0:
            raise OSError(f"no room for {item}")
        written.append(item)

    writer = BackgroundWriter(write, name="test")
    for item in range(10):
        writer.enqueue(item)
    assert writer.flush(5.0)
    assert (writer.failed, str(writer.failure)) == (4, "no room for 9")
    assert writer.close(5.0) == 4
    assert written == [1, 2, 4, 5, 7, 8]


def test_a_write_that_never_returns_holds_up_neither_put_nor_flush_nor_close(stuck):
    writer = BackgroundWriter(stuck, name="test", capacity=10)
    writer.enqueue(0)
    assert stuck.reached.wait(5.0)
    began_s = time.monotonic()
    for item in range(1, 16):
        writer.enqueue(item)
    assert writer.dropped == 5
    assert not writer.flush(0.05)
    assert writer.close(0.05) == 16
    assert time.monotonic() - began_s < SOON_S
    # What was counted as not written is not written later; the one in hand may be.
    stuck.go_on.set()
    writer._thread.join(5.0)
    assert not writer._thread.is_alive() and stuck.written == [0]


def test_a_full_queue_drops_what_comes_and_keeps_what_waits(stuck):
    writer = BackgroundWriter(stuck, name="test", capacity=3)
    writer.enqueue(0)
    assert stuck.reached.wait(5.0)
    for item in range(1, 8):
        writer.enqueue(item)
    stuck.go_on.set()
    assert writer.close(5.0) == 4
    assert stuck.written == [0, 1, 2, 3]


def test_a_signal_handler_may_put_while_its_thread_is_inside_put(stuck, monkeypatch):
    """The lock is taken again by the thread that has it, as a handler between two lines of `put`
    does.
    """
    writer = BackgroundWriter(stuck, name="test")
    done = threading.Event()

    def handled() -> None:
        with writer._turn:
            writer.enqueue(1)
        done.set()

    threading.Thread(target=handled, daemon=True).start()
    assert done.wait(5.0)


def test_many_threads_lose_nothing():
    written: list[int] = []
    writer = BackgroundWriter(written.append, name="test")
    threads = [
        threading.Thread(target=lambda first=first: [writer.enqueue(first + n) for n in range(500)])
        for first in range(0, 4000, 500)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert writer.close(5.0) == 0
    assert sorted(written) == list(range(4000))


# Each event is on its line, and a file that blocks or takes no line delays nobody.


def test_events_come_back_in_order_with_their_times(tmp_path):
    log = EventLog(tmp_path / "log.jsonl")
    log("begun", plan="series")
    log("ended", frames=3)
    assert log.close() == 0
    first, second = read_events(tmp_path / "log.jsonl")
    assert (first["event"], first["plan"], second["frames"]) == ("begun", "series", 3)
    assert first["monotonic_s"] <= second["monotonic_s"]


def test_a_line_cut_short_by_a_crash_spoils_no_other(tmp_path):
    (tmp_path / "log.jsonl").write_text('{"event": "begun"}\n{"event": "en')
    log = EventLog(tmp_path / "log.jsonl")
    log("resumed")
    assert log.close() == 0
    assert (tmp_path / "log.jsonl").read_text().count("\n") == 3
    assert [each["event"] for each in read_events(tmp_path / "log.jsonl")] == ["begun", "resumed"]


class Disk:
    """A disk that can be frozen, or takes only so many bytes of each line."""

    def __init__(self, monkeypatch) -> None:
        self.takes_bytes: int | None = None
        self.go_on, self.reached = threading.Event(), threading.Event()
        self.go_on.set()
        self._write = os.write
        monkeypatch.setattr(os, "write", self.write)

    def write(self, file: int, data: bytes) -> int:
        self.reached.set()
        self.go_on.wait()
        if self.takes_bytes is None:
            return self._write(file, data)
        if self.takes_bytes == 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        written = self._write(file, data[: self.takes_bytes])
        self.takes_bytes -= written
        return written


@pytest.fixture
def disk(monkeypatch):
    disk = Disk(monkeypatch)
    yield disk
    disk.go_on.set()


@pytest.mark.parametrize("takes_bytes", [0, 7])
def test_lines_that_a_full_disk_did_not_take_are_counted_and_raise_nothing(
    tmp_path, disk, takes_bytes
):
    log = EventLog(tmp_path / "log.jsonl")
    disk.takes_bytes = takes_bytes
    log("lost")
    log("lost as well")
    log.flush()
    disk.takes_bytes = None
    log("found")
    log("after it")
    assert log.close() == 2
    found, after = read_events(tmp_path / "log.jsonl")
    assert (found["event"], found["lines_missed_before"]) == ("found", 2)
    assert after["event"] == "after it" and "lines_missed_before" not in after
    if takes_bytes == 0:
        assert all(json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines())


def test_times_are_those_of_the_event_and_not_of_the_writing(tmp_path, disk):
    log = EventLog(tmp_path / "log.jsonl")
    disk.go_on.clear()
    log("early")
    called_s = time.monotonic()
    time.sleep(0.05)
    disk.go_on.set()
    assert log.close() == 0
    assert read_events(tmp_path / "log.jsonl")[0]["monotonic_s"] <= called_s + 1e-3


def test_a_frozen_disk_delays_neither_events_nor_the_end_and_its_lines_are_counted(tmp_path, disk):
    log = EventLog(tmp_path / "log.jsonl")
    disk.go_on.clear()
    log("frozen")
    assert disk.reached.wait(5.0)
    began_s = time.monotonic()
    for number in range(5):
        log("waits", number=number)
    assert log.close(timeout_s=0.05) == 6
    assert time.monotonic() - began_s < SOON_S


def test_a_full_queue_is_told_with_the_first_line_behind_the_gap(tmp_path, disk, monkeypatch):
    log = EventLog(tmp_path / "log.jsonl")
    log._writer._capacity = 3
    disk.go_on.clear()
    log("in hand")
    assert disk.reached.wait(5.0)
    for number in range(8):
        log("waits", number=number)
    disk.go_on.set()
    assert log.flush()
    log("behind the gap")
    assert log.close() == 5
    events = read_events(tmp_path / "log.jsonl")
    assert [each.get("number") for each in events] == [None, 0, 1, 2, None]
    assert [each.get("lines_missed_before") for each in events] == [None, None, None, None, 5]


def test_a_pipe_that_nobody_reads_delays_the_start_by_its_bound_and_nothing_else(tmp_path):
    os.mkfifo(tmp_path / "log.jsonl")
    began_s = time.monotonic()
    log = EventLog(tmp_path / "log.jsonl")
    opened_s = time.monotonic()
    assert opened_s - began_s < event_log.OPENING_S + SOON_S
    log("never read")
    assert log.close(timeout_s=0.05) == 1
    assert time.monotonic() - opened_s < SOON_S
    # Lets the thread go.
    os.close(os.open(tmp_path / "log.jsonl", os.O_RDONLY | os.O_NONBLOCK))


def test_a_pipe_whose_reader_comes_late_has_all_lines(tmp_path):
    os.mkfifo(tmp_path / "log.jsonl")
    log = EventLog(tmp_path / "log.jsonl")
    log("waits for its reader")
    with open(tmp_path / "log.jsonl", "rb") as reader:
        assert log.close() == 0
        assert json.loads(reader.read())["event"] == "waits for its reader"


@pytest.mark.parametrize("name", [".", "none/log.jsonl"])
def test_a_file_that_cannot_be_opened_is_one_sentence(tmp_path, name):
    with pytest.raises(
        BadInput, match=r"^an event log must be a file that can be written, got .*: [A-Z][a-z ]+$"
    ):
        EventLog(tmp_path / name)


def test_what_json_does_not_know_raises_nothing(tmp_path):
    log = EventLog(tmp_path / "log.jsonl")
    circle: dict = {}
    circle["circle"] = circle
    log("a circle", of=circle)
    log("a path", path=tmp_path)
    assert log.close() == 1
    (event,) = read_events(tmp_path / "log.jsonl")
    assert (event["path"], event["lines_missed_before"]) == (str(tmp_path), 1)
