"""What waits for a file delays nobody: queueing never waits, and each item is written or
counted.
"""

import threading
import time

import pytest

from labdata import BackgroundWriter

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
