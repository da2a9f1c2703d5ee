"""AVI video by OpenCV: each frame a picture, grey where its three colours are equal."""

from pathlib import Path

import numpy as np

from labdata.errors import BadInput
from labdata.importers.axes import COL, COLOUR, FRAME, ROW
from labdata.importers.decompression_limit import require_memory, require_picture
from labdata.importers.recorded import Recorded, lossy_note

LOSSLESS = ("", "DIB ", "RGB ", "RAW ", "Y800", "GREY", "Y8  ", "FFV1", "HFYU", "FFVH", "MPNG")
"""FourCC codes of pixels stored as they are or packed without loss."""


def read(path: Path) -> Recorded:
    """Read all frames of a video; see `labdata.importers.read_frames`."""
    import cv2

    with path.open("rb") as file:
        start = file.read(4)
    if start != b"RIFF":
        raise BadInput(f"a .avi file must be an AVI video, got something else in {path}")
    video = cv2.VideoCapture(str(path))
    try:
        code = int(video.get(cv2.CAP_PROP_FOURCC)) if video.isOpened() else 0
        rows, columns = (int(video.get(size)) for size in (cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FRAME_WIDTH))
        require_picture(rows, columns, path.name)
        frames = []
        while True:
            read, frame = video.read()
            if not read:
                break
            frames.append(frame)
            require_memory(len(frames) * frame.size, frame.itemsize, path.name)
    finally:
        video.release()
    if not frames or len({frame.shape for frame in frames}) > 1:
        raise BadInput(f"an AVI file must be whole and of a known codec, got {path}")
    packing = code.to_bytes(4, "little").decode("latin-1").strip("\0").upper()
    notes = () if packing in LOSSLESS else (lossy_note(f"the video's {packing}"),)
    data = np.stack(frames)
    if data.ndim == 4 and (data == data[..., :1]).all():  # OpenCV hands grey over three times
        data = data[..., 0]
    if data.ndim == 3:
        return Recorded(data=data, names=(FRAME, ROW, COL), notes=notes)
    return Recorded(data=data[..., ::-1], names=(FRAME, ROW, COL, COLOUR), notes=notes)
