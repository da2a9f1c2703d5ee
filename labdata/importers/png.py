"""PNG pictures, 8 or 16 bits, unchanged."""

import struct
import zlib
from pathlib import Path

import numpy as np

from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.importers import planes
from labdata.importers.expansion import require_possible

SIGNATURE = b"\x89PNG\r\n\x1a\n"
SAMPLES = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""Samples of a pixel by the colour type of the header."""


def read(path: Path, plane: str | None = None) -> FrameStack:
    """Read a picture as a stack of one frame; see `labdata.importers.read_frames`."""
    import cv2

    content = path.read_bytes()
    if not content.startswith(SIGNATURE):
        raise BadInput(f"a .png file must be a PNG picture, got something else in {path}")
    _check_whole(content, path)
    try:
        data = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        data = None
    if data is None:
        raise BadInput(f"a PNG file must be readable, got {path}")
    if data.ndim == 2:
        return planes.mono(data[None], plane, path.name)
    return planes.chosen(data[None, ..., [2, 1, 0]], plane, path.name)


def _check_whole(content: bytes, path: Path) -> None:
    """Refuse a picture whose chunks are not what was written: the decoder would fill in what it lacks in silence.

    Notes
    -----
    A chunk is its length, its type, its data and the CRC-32 of type and data; IHDR comes first and IEND last (W3C,
    Portable Network Graphics, section 5).
    """
    at, kind = len(SIGNATURE), b""
    while kind != b"IEND":
        if at + 12 > len(content):
            raise BadInput(f"a PNG file must be whole, got {path} without its end")
        length, kind = struct.unpack_from(">I4s", content, at)
        checked = content[at + 4 : at + 8 + length]
        if struct.pack(">I", zlib.crc32(checked)) != content[at + 8 + length : at + 12 + length]:
            raise BadInput(f"a PNG file must be whole, got {path} whose part at byte {at} is damaged")
        if at == len(SIGNATURE):
            _check_size(kind, checked[4:], len(content), path)
        at += 12 + length


def _check_size(kind: bytes, header: bytes, size_bytes: int, path: Path) -> None:
    """Refuse a header that states more than the file can hold."""
    if kind != b"IHDR" or len(header) != 13:
        raise BadInput(f"a PNG file must begin with its header, got {path}")
    columns, rows, bits, colour = struct.unpack_from(">IIBB", header)
    require_possible(rows * columns * SAMPLES.get(colour, 4) * max(1, bits // 8), size_bytes, path.name)
