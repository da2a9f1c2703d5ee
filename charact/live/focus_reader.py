"""Reading the focus beside the picture: in a process of its own, so that no frame waits for an edge to be fitted."""

import multiprocessing
import signal
from collections import deque
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import AbstractContextManager
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from charact.live.focus import BestFocus, Focus, read_focus, window_about
from charact.method import Context
from charact.mtf.mean_frame import Region

AVERAGED_FRAMES = 4


class FocusReader(AbstractContextManager["FocusReader"]):
    """The focus of the newest frames, as often as it can be read.

    Parameters
    ----------
    context
        What is known of the camera.
    region
        ROW, COL, HEIGHT, WIDTH that holds the edge; None: it is looked for, and then followed in a window about it.
    executor
        Where edges are fitted; a process of its own where it is not given.
    """

    def __init__(self, context: Context, region: Region | None = None, executor: Executor | None = None) -> None:
        self._context, self._asked = context, region
        self._executor = executor or ProcessPoolExecutor(
            1, mp_context=multiprocessing.get_context("spawn"), initializer=_ignore_interrupt
        )
        self._frames: deque[NDArray] = deque(maxlen=AVERAGED_FRAMES)
        self._window = region
        self._reading: Future[Focus] | None = None
        # Frames since those of the last reading that the best was held against, and whether the one begun shares none.
        self._unread, self._reads_new = 0, False
        self.newest: Focus | None = None
        """The last reading."""
        self.best = BestFocus()
        """The best so far."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown(wait=True, cancel_futures=True)

    def forget_best(self) -> None:
        """Begin anew, as after another target or another field of view."""
        self.best = BestFocus()

    def look_at(self, frame: NDArray) -> None:
        """Take a frame in; a reading that is done is taken up and the next one begun."""
        if self._frames and self._frames[-1].shape != frame.shape:
            self._frames.clear()
        self._frames.append(frame)
        self._unread += 1
        self.take_up()
        if self._reading is None and len(self._frames) == AVERAGED_FRAMES:
            self._reads_new = self._unread >= AVERAGED_FRAMES
            self._unread = 0 if self._reads_new else self._unread
            self._reading = self._executor.submit(read_focus, np.stack(self._frames), self._window, self._context)

    def take_up(self) -> bool:
        """Take up a reading that is done; return whether there was one."""
        if self._reading is None or not self._reading.done():
            return False
        focus, self._reading = self._reading.result(), None
        self.newest, self.best = focus, self.best.after(focus) if self._reads_new else self.best
        if self._asked is None:
            found = focus.region if focus.mtf50_cy_per_px is not None else None
            self._window = None if found is None else window_about(found)
        return True


def _ignore_interrupt() -> None:
    """Let Ctrl-C on the terminal end the parent alone, which then ends this process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
