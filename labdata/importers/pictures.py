"""Single pictures of common kinds: PNG, JPEG, BMP, PGM and PPM, 8 or 16 bits, unchanged."""

import io
import struct
import warnings
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.importers.axes import COL, COLOUR, ROW
from labdata.importers.decompression_limit import require_memory, require_picture, require_room
from labdata.importers.recorded import Recorded, lossy_note

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
SIGNATURES = {"PNG": (PNG_SIGNATURE,), "JPEG": (b"\xff\xd8",), "BMP": (b"BM",), "PPM": (b"P2", b"P3", b"P5", b"P6")}
"""First bytes by the kind's name in Pillow; bilevel pictures (P1, P4) measure no light."""

KINDS = {".jpg": "JPEG", ".jpeg": "JPEG", ".bmp": "BMP", ".png": "PNG"}


def read(path: Path) -> Recorded:
    """Read a picture; see `labdata.importers.read_frames`."""
    kind = KINDS.get(path.suffix.lower(), "PPM")
    require_memory(path.stat().st_size, 1, path.name)
    content = path.read_bytes()
    if not content.startswith(SIGNATURES[kind]):
        raise BadInput(f"a {path.suffix} file must be a {kind} picture, got something else in {path}")
    if kind == "PNG":
        _check_png(content, path)
    data = _decode(content, kind, path)
    if data is None or data.ndim not in (2, 3):
        raise BadInput(f"a {kind} file must be whole and readable, got {path}")
    names = (ROW, COL) if data.ndim == 2 else (ROW, COL, COLOUR)
    return Recorded(data=data, names=names, notes=(lossy_note("JPEG"),) if kind == "JPEG" else ())


def _decode(content: bytes, kind: str, path: Path) -> NDArray | None:
    """Return the pixels, red first; None of a file that is cut or damaged.

    Pillow finds the ends of JPEG and BMP that OpenCV fills in silence; OpenCV keeps 16 bits of colour.
    """
    from PIL import Image

    try:
        Image.init()
        # Its own bound on sizes, which Image.open holds to, is below that of large cameras.
        with warnings.catch_warnings(action="ignore"), Image.OPEN[kind][0](io.BytesIO(content), "") as picture:
            columns, rows = picture.size
            require_picture(rows, columns, path.name)
            require_room(path, pixels=rows * columns * len(picture.getbands()), pixel_bytes=2)
            if kind in ("JPEG", "BMP"):
                grey = picture.mode in ("1", "L")
                return np.asarray(picture.convert("L" if grey else "RGB"))
    except (BadInput, MemoryError):
        raise
    except Exception:
        return None
    import cv2

    try:
        data = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None
    return data[..., [2, 1, 0]] if data is not None and data.ndim == 3 else data


def _check_png(content: bytes, path: Path) -> None:
    """Refuse a picture whose chunks are not what was written: the decoder would fill in what it lacks in silence.

    Notes
    -----
    A chunk is its length, its type, its data and the CRC-32 of type and data; IHDR comes first and IEND last (W3C,
    Portable Network Graphics, section 5).
    """
    at, kind = len(PNG_SIGNATURE), b""
    while kind != b"IEND":
        if at + 12 > len(content):
            raise BadInput(f"a PNG file must be whole, got {path} without its end")
        length, kind = struct.unpack_from(">I4s", content, at)
        checked = content[at + 4 : at + 8 + length]
        if struct.pack(">I", zlib.crc32(checked)) != content[at + 8 + length : at + 12 + length]:
            raise BadInput(f"a PNG file must be whole, got {path} whose part at byte {at} is damaged")
        at += 12 + length
