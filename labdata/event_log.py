"""A log of what happened: a file of JSON lines, each on its way to the disk as soon as it happened."""

import json
import os
import threading
import time
from datetime import UTC, datetime
from pathlib import Path


class EventLog:
    """A log, open for appending; a last line that a crash cut short is ended first.

    Parameters
    ----------
    path
        The file; made where it is missing.
    """

    def __init__(self, path: Path) -> None:
        # Unbuffered, one write for each line: what was logged survives a kill.
        self._file = open(path, "ab+", buffering=0)  # noqa: SIM115 - open as long as the log
        self._turn = threading.Lock()
        self._missed = 0
        size = self._file.seek(0, os.SEEK_END)
        if size and os.pread(self._file.fileno(), 1, size - 1) != b"\n":
            self._write(b"\n")

    def __call__(self, event: str, **details: object) -> None:
        """Write an event with its time of day and monotonic time, s.

        A disk that takes no line must not keep anybody from making the tube safe: lines that could not be written are
        counted, and told with the next one that can.
        """
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = {"time": now, "monotonic_s": round(time.monotonic(), 4), "event": event, **details}
        with self._turn:
            if self._missed:
                line["lines_missed_before"] = self._missed
            try:
                self._write(json.dumps(line, default=str).encode() + b"\n")
            except OSError:
                self._missed += 1
            else:
                self._missed = 0

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _write(self, data: bytes) -> None:
        os.write(self._file.fileno(), data)


def events(path: Path) -> list[dict]:
    """Return the events of a log; a line that a crash cut short is left out."""
    found = []
    for line in Path(path).read_bytes().splitlines():
        try:
            found.append(json.loads(line))
        except ValueError:
            continue
    return found
