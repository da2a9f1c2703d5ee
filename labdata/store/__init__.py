"""Store of acquired frames: a Zarr array with one chunk per frame, and a journal of acknowledged
frames.

A frame is acknowledged when its complete chunk is on the disk under its final name and, after that,
its line is in the journal: number, time stamp, SHA-256 and a checksum. Frames without a line are
not read. Damaged lines are counted and named, and never changed.
"""

from labdata.store.array_reader import ArrayFollower, read
from labdata.store.journal import Acknowledged, Journal, is_ours, read_journal, sha256

__all__ = [
    "Acknowledged",
    "ArrayFollower",
    "Journal",
    "is_ours",
    "read",
    "read_journal",
    "sha256",
]
