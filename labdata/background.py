"""Writer thread with a bounded queue, so that a blocking file delays no other thread."""

import threading
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Generic, TypeVar

T = TypeVar("T")


class BackgroundWriter(Generic[T]):
    """Writes items one by one in a daemon thread; the write may block, fail or never return.

    `begin` and `finish` run in the thread before the first item and after the last. At most
    `capacity` items wait. The thread starts in the constructor, so that a process that later can
    start none still has it.
    """

    def __init__(
        self,
        write: Callable[[T], object],
        *,
        name: str,
        capacity: int = 10_000,  # Queued items: minutes of events, a few megabytes of memory
        begin: Callable[[], object] = lambda: None,
        finish: Callable[[], object] = lambda: None,
    ) -> None:
        self._write, self._begin, self._finish, self._capacity = write, begin, finish, capacity
        self._items: deque[T] = deque()
        self._begun, self._writing, self._closed = False, False, False
        # Reentrant: a signal handler may put an item while its thread is inside `enqueue`.
        self._turn = threading.Condition(threading.RLock())
        self.dropped = 0  # Number of items that found no room, or came after `close`
        self.failed = 0  # Number of items whose writing raised
        self.failure: Exception | None = None  # Last exception raised in the thread
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def enqueue(self, item: T) -> None:
        """Queue an item; never waits for the writing and never raises."""
        with self._turn:
            if self._closed or len(self._items) >= self._capacity:
                self.dropped += 1
                return
            try:
                self._items.append(item)
            except MemoryError:
                self.dropped += 1
            self._turn.notify_all()

    def flush(self, timeout_s: float | None) -> bool:
        """Wait until the thread has begun and no item waits, at most `timeout_s` (None: for ever);
        return whether.
        """
        with self._turn:
            return self._turn.wait_for(
                lambda: self._begun and not self._items and not self._writing, timeout_s
            )

    def close(self, timeout_s: float | None) -> int:
        """Write what waits, for at most `timeout_s` (None: for ever), and end; return how many were
        not written.
        """
        with self._turn:
            self._closed = True
            self._turn.notify_all()
        self._thread.join(timeout_s)
        with self._turn:
            self.dropped += len(self._items)
            # An item counted as not written must not be written later.
            self._items.clear()
            return self.dropped + self.failed + self._writing

    def _work(self) -> None:
        self.failure = self._failure_of(self._begin)
        with self._turn:
            self._begun = True
            self._turn.notify_all()
        while True:
            with self._turn:
                self._turn.wait_for(lambda: self._items or self._closed)
                if not self._items:
                    break
                item = self._items.popleft()
                self._writing = True
            failure = self._failure_of(partial(self._write, item))
            with self._turn:
                self.failed += failure is not None
                self.failure = failure or self.failure
                self._writing = False
                self._turn.notify_all()
        self.failure = self._failure_of(self._finish) or self.failure

    @staticmethod
    def _failure_of(action: Callable[[], object]) -> Exception | None:
        """Return the exception of an action, so that the next item is still tried."""
        try:
            action()
        except Exception as error:
            return error
        return None
