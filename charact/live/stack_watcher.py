"""Stacks as they land: what a plan that runs has finished since the last look, and whether more will come."""

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from labdata.errors import BadInput
from labdata.event_log import read_events
from labdata.file_records import SessionFile
from labdata.serialiser import from_toml
from labdata.session import MANIFEST, Session, StackEntry, session_of

LOG = "log.jsonl"
LOOK_S = 0.5
PATIENCE_S = 1800.0


def watch_stacks(
    folder: str | Path, *, once: bool = False, patience_s: float = PATIENCE_S, look_s: float = LOOK_S
) -> Iterator[tuple[Session, StackEntry]]:
    """Hand out each finished stack of a growing session, with the session up to it.

    Parameters
    ----------
    folder
        Folder of the session.
    once
        Whether to end with the stacks that are there now.
    patience_s
        Longest wait for the next stack, s.
    look_s
        Time between two looks, s.

    Raises
    ------
    BadInput
        If there is no session, the run ended before its plan was done, or no stack landed in time.
    """
    folder, seen, since_s = Path(folder), set[str](), time.monotonic()
    if not (folder / MANIFEST).is_file():
        raise BadInput(f"a session must be a folder with a {MANIFEST}, got {folder}")
    while True:
        # How the run ended is read before the stacks: one that lands in between is seen.
        ended = run_outcome(folder)
        for session, entry in _finished_stacks(folder):
            if entry.label not in seen:
                seen.add(entry.label)
                yield session, entry
                since_s = time.monotonic()
        if ended == "" or once:
            return
        if ended is not None:
            raise BadInput(f"the run ended before its plan was done: {ended}")
        if time.monotonic() - since_s > patience_s:
            raise BadInput(f"a stack must land within {patience_s:g} s, got none; `charact acquire --resume` goes on")
        time.sleep(look_s)


def run_outcome(folder: Path) -> str | None:
    """Return None while a plan runs, "" once it is done, else why it ended; a session without a log is done."""
    try:
        told = [event for event in read_events(folder / LOG) if event.get("event") in ("run begins", "run ends")]
    except FileNotFoundError:
        return ""
    if not told or told[-1]["event"] == "run begins":
        return None
    return "" if told[-1].get("whole") else str(told[-1].get("reason", "no reason was logged"))


def _finished_stacks(folder: Path) -> Iterator[tuple[Session, StackEntry]]:
    form = from_toml(folder / MANIFEST, SessionFile)
    if not form.stack:
        return
    session = session_of(folder, form)
    for place, entry in enumerate(session.stacks):
        if entry.finished:
            yield replace(session, stacks=session.stacks[: place + 1]), entry
