"""Event log: a file of JSON lines, written by its own thread."""

import json
import os
import stat
import time
from datetime import UTC, datetime
from pathlib import Path

from labdata.background import BackgroundWriter
from labdata.errors import BadInput
from labdata.file_io import ends_mid_line

OPENING_S = 1.0  # Longest wait for the file to open, s; commands to the tube wait for it


class EventLog:
    """A log, open for appending; an incomplete last line is ended first.

    A file that blocks, or a full disk, delays no caller. Lines that could not be written are
    counted, and the next line that can be written carries the count as `lines_missed_before`. A
    file that cannot be opened is BadInput; one that is still opening after `OPENING_S` is no error.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = path
        self._file: int | None = None
        self._mid_line = False
        self._reported = 0
        self._writer = BackgroundWriter(
            self._write, name="event log", begin=self._open, finish=self._close_file
        )
        self._writer.flush(OPENING_S)
        if (failure := self._writer.failure) is not None:
            self._writer.close(0.0)
            why = getattr(failure, "strerror", None) or failure
            raise BadInput(f"an event log must be a file that can be written, got {path}: {why}")

    def __call__(self, event: str, **details: object) -> None:
        """Record an event with its times, s, without waiting or raising. The details must not
        change after the call.
        """
        line = {
            "time": datetime.now(UTC),
            "monotonic_s": round(time.monotonic(), 4),
            "event": event,
            **details,
        }
        self._writer.enqueue((line, self._writer.dropped))

    def flush(self, timeout_s: float = 1.0) -> bool:
        """Wait at most `timeout_s` until all lines are written; return whether they are."""
        return self._writer.flush(timeout_s)

    def close(self, timeout_s: float = 1.0) -> int:
        """Write what waits, for at most `timeout_s`, and close the file; return the number of lines
        never written.
        """
        return self._writer.close(timeout_s)

    # In the thread

    def _open(self) -> int:
        """Open the file for appending and find out whether its last line is incomplete."""
        file = os.open(self._path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
        try:
            if stat.S_ISREG(os.fstat(file).st_mode):
                with open(self._path, "rb") as content:
                    self._mid_line = ends_mid_line(content.fileno())
        except BaseException:
            os.close(file)
            raise
        self._file = file
        return file

    def _write(self, item: tuple[dict, int]) -> None:
        """Write a line, with the number of lines that found no room before it."""
        line, dropped = item
        file = self._open() if self._file is None else self._file
        line["time"] = line["time"].isoformat(timespec="milliseconds")
        missed = dropped + self._writer.failed
        if missed > self._reported:
            line["lines_missed_before"] = missed - self._reported
        data = json.dumps(line, default=str).encode() + b"\n"
        if self._mid_line:
            data = b"\n" + data
        # A disk that accepts only part of a line raises at the next attempt.
        while data:
            written = os.write(file, data)
            self._mid_line = not data[:written].endswith(b"\n")
            data = data[written:]
        self._reported = missed

    def _close_file(self) -> None:
        if self._file is not None:
            os.close(self._file)


def read_events(path: str | Path) -> list[dict]:
    """Return the events of a log; incomplete lines are omitted."""
    events = []
    for line in Path(path).read_bytes().splitlines():
        try:
            events.append(json.loads(line))
        except ValueError:
            continue
    return events
