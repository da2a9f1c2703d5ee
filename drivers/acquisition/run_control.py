"""What a person asks of a running acquisition: to stop after this step, to stop now, to pause and to go on."""

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

LOOK_S = 0.05

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
        self._say = say
        self.stop = False
        """End the run when the present step is finished."""
        self.pause = False
        """Wait when the present step is finished, until this is False again."""
        self._running = self._leaving = False

    @contextmanager
    def heard(self) -> Iterator[None]:
        """Hear Ctrl-C and SIGUSR1 for a while; only the main thread of a process can.

        While steps run, the first Ctrl-C asks to stop after the step, and the second is a KeyboardInterrupt at once.
        Before, the first is; after, when the tube is being made safe, none is.
        """
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = {
            signal.SIGINT: signal.signal(signal.SIGINT, self._interrupted),
            signal.SIGUSR1: signal.signal(signal.SIGUSR1, self._paused),
        }
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler if handler is not None else signal.SIG_DFL)

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
            self._say(PAUSED)
        while self.pause and not self.stop:
            look()
            time.sleep(LOOK_S)
        if self.stop:
            raise KeyboardInterrupt

    def _interrupted(self, number: int, frame: FrameType | None) -> None:
        if self._leaving:
            return
        if self.stop or not self._running:
            raise KeyboardInterrupt
        self.stop = True
        self._say(STOPPING)

    def _paused(self, number: int, frame: FrameType | None) -> None:
        self.pause = not self.pause
        if self.pause:
            self._say(PAUSING)
