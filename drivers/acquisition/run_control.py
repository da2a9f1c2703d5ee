"""What a person asks of a running acquisition: to stop after this step, to stop now, to pause and to go on."""

import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

LOOK_S = 0.05

URGENT = (signal.SIGTERM, signal.SIGHUP)
GRACE_S, STUCK_S = 5.0, 15.0
"""How long a run that was ended by a signal may take to leave, once the tube is safe and in all, s."""

STOPPING = "stopping after this step; Ctrl-C again shuts the gate now"
PAUSING = "pausing after this step; the same signal again goes on"
PAUSED = "paused with gate shut and light out; SIGUSR1 goes on, Ctrl-C ends the run"


class RunControl:
    """What was asked so far.

    Parameters
    ----------
    say
        Told in a sentence that it was heard.
    """

    def __init__(self, say: Callable[[str], None] = lambda sentence: None) -> None:
        self.say = say
        self.stop = False
        """End the run when the present step is finished."""
        self.pause = False
        """Wait when the present step is finished, until this is False again."""
        self.make_safe_at_once: Callable[[], None] = lambda: None
        """Called from a thread of its own at SIGTERM, SIGHUP and the second Ctrl-C, whatever the run waits for."""
        self.last_words: Callable[[], str] = lambda: ""
        """Returns how the tube was left; what a run that does not leave writes on the terminal at its end."""
        self._running = self._leaving = False
        self._ended = threading.Event()

    @contextmanager
    def heard(self) -> Iterator[None]:
        """Hear signals for a while; only the main thread of a process can.

        While steps run, the first Ctrl-C asks to stop after the step, and the second is a KeyboardInterrupt at once.
        Before, the first is; after, when the tube is being made safe, none is. SIGTERM and SIGHUP are a SystemExit.
        SIGUSR1 pauses and goes on.
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
        threading.Thread(target=self._take_signals, args=(reading,), name="signals", daemon=True).start()
        try:
            yield
        finally:
            self._ended.set()
            signal.set_wakeup_fd(wakeup)
            writing.close()
            for number, handler in before.items():
                signal.signal(number, handler if handler is not None else signal.SIG_DFL)

    def _take_signals(self, reading: socket.socket) -> None:
        """Make safe at an urgent signal, which the main thread may be too stuck to hear; in a thread of its own."""
        interrupts = 0
        with reading:
            while numbers := reading.recv(64):
                for number in numbers:
                    interrupts += number == signal.SIGINT
                    if number in URGENT or interrupts > 1:
                        self.make_safe_at_once()
                        self._end_if_stuck(number)

    def _end_if_stuck(self, number: int) -> None:
        """End the process where the main thread does not, with what is to be said of the tube."""
        stuck_s = time.monotonic() + STUCK_S
        while not self._ended.wait(GRACE_S):
            if self.last_words() or time.monotonic() > stuck_s:
                os.set_blocking(2, False)
                with suppress(OSError):
                    os.write(2, f"charact: the tube: {self.last_words() or 'not known to be safe'}\n".encode())
                os._exit(128 + number)

    @contextmanager
    def running(self) -> Iterator[None]:
        """The time in which steps are taken; after it the tube is made safe, and nothing may keep that up."""
        self._running = True
        try:
            yield
        finally:
            self._running, self._leaving = False, True

    def between_steps(self, look: Callable[[], None]) -> None:
        """End the run (KeyboardInterrupt) or wait as asked; called between steps with the gate shut.

        Parameters
        ----------
        look
            Called all the while; raises what went wrong at the bench.
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
    """Unwind the stack like Ctrl-C, so that every `with` is left properly."""
    raise SystemExit(128 + number)
