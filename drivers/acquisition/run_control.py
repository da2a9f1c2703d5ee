"""Stop, pause and resume a running acquisition by signals."""

import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

from drivers.errors import BenchStopped

LOOK_S = 0.05

URGENT = (signal.SIGTERM, signal.SIGHUP)
# Time limits of a run ended by a signal, once the tube is safe and in total, s
GRACE_S, STUCK_S = 5.0, 15.0

STOPPING = "stopping after this step; Ctrl-C again shuts the gate now"
PAUSING = "pausing after this step; the same signal again goes on"
PAUSED = "paused with gate shut and light out; SIGUSR1 goes on, Ctrl-C ends the run"


class RunControl:
    """Requests of the user to a running acquisition; `say` is called with a sentence that confirms
    a request.
    """

    def __init__(self, say: Callable[[str], None] = lambda sentence: None) -> None:
        self.say = say
        self.stop = False  # Whether to end the run after the present step
        self.pause = False  # Whether to pause after the present step, until this is False again
        # Called from a separate thread at SIGTERM, SIGHUP and the second Ctrl-C
        self.make_safe_at_once: Callable[[], None] = lambda: None
        # Returns the final state of the tube, written to the terminal by a run that hangs at its
        # end
        self.last_words: Callable[[], str] = lambda: ""
        self._running = self._leaving = False
        self._urgent: int | None = None  # Signal at which the tube was made safe
        self._ended = threading.Event()

    @contextmanager
    def listen(self) -> Iterator[None]:
        """Handle signals in the `with` block; only in the main thread of a process.

        While steps run, the first Ctrl-C requests a stop after the step; the second is a
        KeyboardInterrupt at once. Before, the first is; afterwards, during the safe action, none
        is. SIGTERM and SIGHUP are a SystemExit. SIGUSR1 pauses and resumes.
        """
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        handlers = {signal.SIGINT: self._on_interrupt, signal.SIGUSR1: self._on_pause}
        handlers |= dict.fromkeys(URGENT, _end)
        before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
        reading, writing = socket.socketpair()
        writing.setblocking(False)
        wakeup = signal.set_wakeup_fd(writing.fileno(), warn_on_full_buffer=False)
        threading.Thread(
            target=self._take_signals, args=(reading,), name="signals", daemon=True
        ).start()
        try:
            yield
        finally:
            self._ended.set()
            signal.set_wakeup_fd(wakeup)
            writing.close()
            for number, handler in before.items():
                signal.signal(number, handler if handler is not None else signal.SIG_DFL)

    def _take_signals(self, reading: socket.socket) -> None:
        """Make the tube safe at an urgent signal, in a separate thread, since the main thread may
        hang.
        """
        interrupts = 0
        with reading:
            while numbers := reading.recv(64):
                for number in numbers:
                    interrupts += number == signal.SIGINT
                    if number in URGENT or interrupts > 1:
                        self._urgent = number
                        self.make_safe_at_once()
                        self._end_if_stuck(number)

    def _end_if_stuck(self, number: int) -> None:
        """End a process whose main thread hangs, with a message on the state of the tube."""
        stuck_s = time.monotonic() + STUCK_S
        while not self._ended.wait(GRACE_S):
            if self.last_words() or time.monotonic() > stuck_s:
                os.set_blocking(2, False)
                with suppress(OSError):
                    os.write(
                        2,
                        (
                            f"charact: the tube: {self.last_words() or 'not known to be safe'}\n"
                        ).encode(),
                    )
                os._exit(128 + number)

    @contextmanager
    def running(self) -> Iterator[None]:
        """Mark the time in which steps run; in the safe action that follows Ctrl-C is ignored.

        A bench that was made safe at once by a signal says so wherever it is looked at, and may be
        the first to end the steps: two Ctrl-C that come while the main thread hangs are one to it.
        """
        self._running = True
        try:
            yield
        except BenchStopped as stopped:
            if self._urgent is None:
                raise
            if self._urgent == signal.SIGINT:
                raise KeyboardInterrupt from stopped
            raise SystemExit(128 + self._urgent) from stopped
        finally:
            self._running, self._leaving = False, True

    def between_steps(self, look: Callable[[], None]) -> None:
        """End the run (KeyboardInterrupt) or pause as requested; `look` raises errors of the bench
        meanwhile.
        """
        if self.pause and not self.stop:
            self.say(PAUSED)
        while self.pause and not self.stop:
            look()
            time.sleep(LOOK_S)
        if self.stop:
            raise KeyboardInterrupt

    def _on_interrupt(self, number: int, frame: FrameType | None) -> None:
        if self._leaving:
            return
        if self.stop or not self._running:
            raise KeyboardInterrupt
        self.stop = True
        self.say(STOPPING)

    def _on_pause(self, number: int, frame: FrameType | None) -> None:
        self.pause = not self.pause
        if self.pause:
            self.say(PAUSING)


def _end(number: int, _frame: FrameType | None) -> None:
    """Unwind the stack like Ctrl-C, so that every `with` block is closed."""
    raise SystemExit(128 + number)
