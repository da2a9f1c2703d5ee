"""The store of acquired frames: a Zarr array, one chunk a frame, and a journal in which each frame is acknowledged.

A frame is acknowledged when its chunk lies whole on the disk under its final name and, after that, its line lies in
the journal: number, time stamp, SHA-256. What the journal does not hold was never promised and is not read.
"""

from labdata.store.following import Following
from labdata.store.journal import Acknowledged, is_ours, journal, sha256
from labdata.store.reading import lazy, read
from labdata.store.session_writer import SessionWriter
from labdata.store.stack_writer import StackWriter

__all__ = ["Acknowledged", "Following", "SessionWriter", "StackWriter", "is_ours", "journal", "lazy", "read", "sha256"]
