"""The journal of an array: a frame that it does not hold was never promised."""

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from numpy.typing import NDArray

from labdata.store.layout import frame_bytes

JOURNAL = "journal.jsonl"


@dataclass(frozen=True, kw_only=True)
class Acknowledged:
    """One line of the journal.

    Parameters
    ----------
    index
        Place of the frame in the array.
    frame_number
        The camera's own number.
    time_s
        Time stamp, s.
    sha256
        SHA-256 of the frame's bytes, rows first, little-endian.
    """

    index: int
    frame_number: int
    time_s: float
    sha256: str


def is_ours(path: Path) -> bool:
    """Whether a folder is an array of this store."""
    return (path / JOURNAL).is_file()


def journal(path: str | Path) -> tuple[Acknowledged, ...]:
    """Return the acknowledged frames of an array in order; a last line cut short by a crash is not one."""
    return acknowledged((Path(path) / JOURNAL).read_bytes().splitlines(keepends=True))


def acknowledged(lines: Iterable[bytes], *, first: int = 0) -> tuple[Acknowledged, ...]:
    """Return the frames that lines of a journal promise, up to the first line that is cut short or out of order.

    Parameters
    ----------
    lines
        Lines with their ends.
    first
        Place of the first line's frame in the array.
    """
    frames = []
    for line in lines:
        try:
            entry = Acknowledged(**json.loads(line))
        except (ValueError, TypeError, RecursionError):
            break
        if not line.endswith(b"\n") or entry.index != first + len(frames):
            break
        frames.append(entry)
    return tuple(frames)


def sha256(frame: NDArray) -> str:
    """Return the SHA-256 of a frame's bytes, rows first, little-endian."""
    return hashlib.sha256(frame_bytes(frame)).hexdigest()
