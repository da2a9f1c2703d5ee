"""PNG pictures, 8 or 16 bits, unchanged."""

from pathlib import Path

import numpy as np

from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.importers import planes

SIGNATURE = b"\x89PNG\r\n\x1a\n"


def read(path: Path, plane: str | None = None) -> FrameStack:
    """Read a picture as a stack of one frame; see `labdata.importers.read_frames`."""
    import cv2

    content = path.read_bytes()
    if not content.startswith(SIGNATURE):
        raise BadInput(f"a .png file must be a PNG picture, got something else in {path}")
    # Every PNG ends with this empty chunk; the decoder would fill a truncated picture with zeros.
    if b"IEND" not in content[-16:]:
        raise BadInput(f"a PNG file must be whole, got {path} without its end")
    try:
        data = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        data = None
    if data is None:
        raise BadInput(f"a PNG file must be readable, got {path}")
    if data.ndim == 2:
        return planes.mono(data[None], plane, path.name)
    return planes.chosen(data[None, ..., [2, 1, 0]], plane, path.name)
