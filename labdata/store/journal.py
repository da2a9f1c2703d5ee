"""The journal of an array: one line for each acknowledged frame, and what damaged lines still
prove.

Each line ends in a checksum of its own, so that one changed byte anywhere in it is noticed; lines
written before there were checksums have none. A frame is read if its line is complete. If a line is
damaged, but one changed, inserted or removed byte explains it, the checksum is met again and the
frame's chunk has the digest of the line, it is read too.
"""

import hashlib
import json
import os
import re
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.file_io import require_regular

METADATA = "zarr.json"


def metadata(frames: int, shape: tuple[int, int], dtype: np.dtype) -> bytes:
    """Return the metadata of an array of `frames` frames of a shape (row, col) and type of
    pixel.
    """
    bytes_codec: dict = {"name": "bytes"}
    if dtype.itemsize > 1:
        bytes_codec["configuration"] = {"endian": "little"}
    document = {
        "zarr_format": 3,
        "node_type": "array",
        "shape": [frames, *shape],
        "data_type": dtype.name,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [1, *shape]}},
        # One flat folder: subfolders would need syncs of their own.
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "."}},
        "fill_value": 0.0 if dtype.kind == "f" else 0,
        "codecs": [bytes_codec],
        "attributes": {},
        "storage_transformers": [],
    }
    return json.dumps(document, indent=1).encode()


def read_metadata(path: Path) -> tuple[int, tuple[int, ...], str]:
    """Return frames, shape of a frame and name of the pixel type from an array's metadata."""
    if (path / METADATA).exists():
        require_regular(path / METADATA, "the metadata of an array")
    try:
        document = json.loads((path / METADATA).read_bytes())
        frames, *shape = map(int, document["shape"])
        return frames, tuple(shape), str(document["data_type"])
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        raise BadInput(f"a stack of the store must be a readable Zarr array, got {path}") from None


def chunk(path: Path, index: int) -> Path:
    """Return the file of a frame."""
    return path / f"c.{index}.0.0"


def frame_bytes(frame: NDArray) -> memoryview:
    """Return a frame's bytes as they lie in its file: rows first, little-endian."""
    return np.ascontiguousarray(frame, dtype=frame.dtype.newbyteorder("<")).data.cast("B")


JOURNAL = "journal.jsonl"

# Largest number of damaged lines to restore; each takes about 10 ms, and more are not single-byte
# errors
MAX_RESTORED_LINES = 8

MAX_LINE_BYTES = 320  # Longest text to restore; a line has at most 200 bytes
MAX_NAMED = 5  # Largest number of lines or frames listed in a message

RECORD = re.compile(
    rb'(?P<body>\{"index": (?P<index>\d{1,18}), "frame_number": (?P<frame_number>-?\d{1,19}), '
    rb'"time_s": (?P<time_s>-?(?:\d+(?:\.\d+)?(?:e[+-]?\d+)?|Infinity)|NaN), '
    rb'"sha256": "(?P<sha256>[0-9a-f]{64})")'
    rb'(?:, "checksum": "(?P<checksum>[0-9a-f]{16})")?\}'
)
BEGINNING = re.compile(rb'\{"index": \d+, "frame_number": ')
END = re.compile(rb'", "checksum": "[0-9a-f]{16}"\}$')
EDGE_BYTES = 48  # Longest match of either of the two, bytes

VALUE_BYTES = tuple(bytes([byte]) for byte in b"0123456789abcdef.-+")
LINE_BYTES = tuple(
    bytes([byte])
    for byte in sorted({*b'{}"_:, -+.0123456789indexframe_numbertime_ssha256checksum'})
)
NUMBERS = range(-(2**63), 2**63)  # Frame numbers of 64 bits


@dataclass(frozen=True, kw_only=True)
class Acknowledged:
    """One line of the journal."""

    index: int  #: Index of the frame in the array
    frame_number: int  #: The camera's own number
    time_s: float  #: Time stamp, s
    sha256: str  #: SHA-256 of the frame's bytes, rows first, little-endian

    def line(self) -> bytes:
        """Return the line as written, with checksum and line end."""
        body = json.dumps(asdict(self)).encode()[:-1]
        return body + b', "checksum": "%s"}\n' % _checksum(body)


@dataclass(frozen=True, kw_only=True)
class Journal:
    """Content of a journal and its array."""

    path: Path  #: Folder of the array
    frames: tuple[
        Acknowledged, ...
    ]  #: Acknowledged frames that can be read, by index; indices may be missing
    array_frames: int  #: Number of frames in the metadata of the array
    damaged_lines: tuple[
        int, ...
    ]  #: Numbers, from 1, of the lines that are not one complete record

    @property
    def end(self) -> int:
        """One after the last index in the journal."""
        return self.frames[-1].index + 1 if self.frames else 0

    @property
    def lost_frames(self) -> int:
        """Number of frames counted by the array or its journal that cannot be read."""
        return max(self.end, self.array_frames) - len(self.frames)

    @property
    def notes(self) -> tuple[str, ...]:
        """One sentence if lines are damaged or missing, else empty."""
        if not self.damaged_lines and not self.lost_frames:
            return ()
        lines = f": {_subject('line', self.damaged_lines)} damaged" if self.damaged_lines else ""
        indices = {frame.index for frame in self.frames}
        missing = [index for index in range(self.end) if index not in indices]
        if (behind := max(self.end, self.array_frames) - self.end) > 0:
            missing += range(self.end, self.end + min(behind, MAX_NAMED + 1))
        frames = f"; {_subject('frame', missing, self.lost_frames)} not read" if missing else ""
        return (
            f"{self.path / JOURNAL} must have a whole line for each of the "
            f"{max(self.end, self.array_frames)} frames of its array, got "
            f"{len(self.frames)}{lines}{frames}",
        )

    def require_frames(self) -> None:
        """Require at least one readable frame."""
        if not self.frames:
            note = self.notes[0] if self.notes else f"got none in {self.path}"
            raise BadInput(f"a stack must hold at least one frame, {note}")


def is_ours(path: Path) -> bool:
    """Whether a folder is an array of this store."""
    return os.path.isfile(path / JOURNAL)  # Path.is_file raises on invalid names


def read_journal(path: str | Path) -> Journal:
    """Read the journal of an array; a folder that is none, or has unreadable metadata, is BadInput.

    A last line without line end was interrupted by a crash: its frame is not acknowledged, unless
    only the line end is missing and the checksum is valid.
    """
    path = Path(path)
    array_frames, _, _ = read_metadata(path)
    try:
        *lines, last = (path / JOURNAL).read_bytes().split(b"\n")
    except OSError as error:
        raise BadInput(
            f"an array of the store must have a readable journal, got {path}: {error.strerror}"
        ) from None
    frames: dict[int, Acknowledged] = {}
    damaged: dict[int, bytes] = {}
    for line_index, line in enumerate((*lines, last)):
        records = records_of(line, line_index, path)
        frames |= {frame.index: frame for frame in records}
        if line_index < len(lines) and (len(records) != 1 or not RECORD.fullmatch(line)):
            damaged[line_index] = line
    for frame in _restore_frames(damaged, frames, path):
        frames[frame.index] = frame
    return Journal(
        path=path,
        frames=tuple(frames[index] for index in sorted(frames)),
        array_frames=array_frames,
        damaged_lines=tuple(line_index + 1 for line_index in damaged),
    )


def records_of(line: bytes, line_index: int, path: Path) -> tuple[Acknowledged, ...]:
    """Return the complete records of a line; one with a damaged line end includes the next's.

    `line_index`: index of the line, from 0.

    A record without checksum must be at its index, or its frame's chunk must have its digest.
    """
    records = []
    for match in RECORD.finditer(line):
        frame = Acknowledged(
            index=int(match["index"]),
            frame_number=int(match["frame_number"]),
            time_s=float(match["time_s"]),
            sha256=match["sha256"].decode(),
        )
        if match["checksum"] is None:
            is_valid = frame.index == line_index or _has_chunk(path, frame)
        else:
            is_valid = match["checksum"] == _checksum(match["body"])
        if is_valid and frame.frame_number in NUMBERS:
            records.append(frame)
    return tuple(records)


def sha256(frame: NDArray) -> str:
    """Return the SHA-256 of a frame's bytes, rows first, little-endian."""
    return hashlib.sha256(frame_bytes(frame)).hexdigest()


def _checksum(body: bytes) -> bytes:
    """Return the checksum of a line: the first 64 bits of the SHA-256 of its body."""
    return hashlib.sha256(body).hexdigest()[:16].encode()


def _has_chunk(path: Path, frame: Acknowledged) -> bool:
    """Return whether the chunk of a frame exists and has its digest."""
    try:
        with open(chunk(path, frame.index), "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest() == frame.sha256
    except OSError:
        return False


def _restore_frames(
    damaged: Mapping[int, bytes], known_indices: Container[int], path: Path
) -> Iterator[Acknowledged]:
    """Yield missing frames whose damaged line has exactly one single-byte correction."""
    if len(damaged) > MAX_RESTORED_LINES:
        return
    for line_index, line in damaged.items():
        # The byte may have become a line end, or be an inserted line end.
        for text in (
            (line, line + b"\n" + damaged[line_index + 1]) if line_index + 1 in damaged else (line,)
        ):
            candidates = {
                frame
                for restored in _one_byte_from(text)
                if RECORD.fullmatch(restored) and b"checksum" in restored
                for frame in records_of(restored, line_index, path)
                if frame.index not in known_indices and _has_chunk(path, frame)
            }
            if len(candidates) == 1:
                yield candidates.pop()


def _one_byte_from(text: bytes) -> Iterator[bytes]:
    """Yield candidate records at a distance of one changed, inserted or removed byte."""
    if len(text) > MAX_LINE_BYTES:
        return
    begins, ends = BEGINNING.match(text), END.search(text)
    positions, alphabet = range(len(text) + 1), LINE_BYTES
    if RECORD.fullmatch(text):
        alphabet = VALUE_BYTES
    elif not begins:
        positions = range(min(EDGE_BYTES, len(text)) + 1)
    elif not ends:
        positions = range(max(0, len(text) - EDGE_BYTES), len(text) + 1)
    for at in positions:
        before, after = text[:at], text[at:]
        yield before + after[1:]
        for byte in alphabet:
            yield before + byte + after[1:]
            yield before + byte + after


def _subject(word: str, numbers: Sequence[int], total: int = 0) -> str:
    """Return lines or frames by number as subject and verb of a sentence."""
    total = max(total, len(numbers))
    named = ", ".join(map(str, numbers[:MAX_NAMED])) + (
        f" and {total - MAX_NAMED} more" if total > MAX_NAMED else ""
    )
    return f"{word} {named} is" if total == 1 else f"{word}s {named} are"
