"""One thread for one line, so that an instrument which keeps silent holds up nobody but itself."""

import queue
import threading
from collections.abc import Callable

from drivers.errors import BenchError, BenchStopped
from drivers.instruments.models import InstrumentModel
from drivers.serial_lines.line import InstrumentLine

_MONITOR = {"do": "monitor"}


class LineWorker:
    """Does what is asked on one line, in order, in a thread of its own.

    Parameters
    ----------
    line
        The line.
    model
        What is at its other end.
    reply
        Called with the answer to each request.
    spare
        Whether the bench does without it: an error ends nothing but the request.
    """

    def __init__(
        self, line: InstrumentLine, *, model: InstrumentModel, reply: Callable[[dict], None], spare: bool = False
    ) -> None:
        self.line, self.driver = line, model.driver(line)
        self._model, self._spare = model, spare
        self.failure: BenchError | None = None
        """The first error of the line, which ends its use."""
        self._reply = reply
        self._jobs: queue.SimpleQueue[dict | None] = queue.SimpleQueue()
        self._busy = threading.Lock()
        self._watching = False
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def put(self, request: dict) -> None:
        """Take a request {"id", "do": "ask" | "write" | "watch", "text"}."""
        self._jobs.put(request)

    def monitor(self) -> None:
        """Look for a sign of life, or for a trip of a supply, if watching and nothing else is to do."""
        if self._watching and self._jobs.empty() and not self._busy.locked():
            self._jobs.put(_MONITOR)

    def pause(self) -> None:
        """Stop watching, and let a wait that is going on give up at once."""
        self._watching = False
        self.line.take_over()

    def wait_idle(self, timeout_s: float) -> bool:
        """Wait until nothing is going on and keep it so; whether that was reached in time."""
        held = self._busy.acquire(timeout=timeout_s)
        self.line.release()
        return held

    def resume(self, held: bool, *, fault: BenchError | None) -> None:
        """Go on; with a fault of the bench, every further request is answered by it."""
        self.failure = fault or self.failure
        if held:
            self._busy.release()

    def close(self) -> None:
        """End the thread and let go of the port."""
        self._jobs.put(None)
        self._thread.join(1.0)
        self.line.close()

    def _work(self) -> None:
        while (request := self._jobs.get()) is not None:
            with self._busy:
                self._serve(request)

    def _serve(self, request: dict) -> None:
        answer: dict = {"id": request.get("id")}
        try:
            if self.failure is not None:
                raise self.failure
            answer["reply"] = self._do(request)
        except Exception as caught:
            error = caught if isinstance(caught, BenchError) else BenchError(f"the {self.line.name} failed: {caught!r}")
            answer["error"] = described(error)
            if not (isinstance(error, BenchStopped) or self._spare):
                self.failure = self.failure or error
        if "id" in request:
            self._reply(answer)

    def _do(self, request: dict) -> str | None:
        if request["do"] == "ask":
            return self.line.ask(request["text"])
        if request["do"] == "write":
            self.line.write(request["text"])
        elif request["do"] == "watch":
            # A driver that has seen nothing yet: what it finds at its first look is how things should stay.
            self.driver, self._watching = self._model.driver(self.line), request["on"]
        elif self._watching:
            self.driver.look()
        return None


def described(error: BenchError | None) -> dict | None:
    """An error as JSON can carry it."""
    if error is None:
        return None
    return {"kind": type(error).__name__, "sentence": str(error), **vars(error)}
