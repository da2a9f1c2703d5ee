"""Readers of image files: PNG, JPEG, BMP, PGM and PPM, camera raw, and AVI video."""

import io
import struct
import warnings
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.file_io import require_memory, require_picture, require_room
from labdata.importers.axes import COL, COLOUR, FRAME, ROW, Recorded, lossy_note
from labdata.importers.headers import Stated, stated_in_text

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
# First bytes by Pillow's name of the kind; bilevel images (P1, P4) are refused
SIGNATURES = {
    "PNG": (PNG_SIGNATURE,),
    "JPEG": (b"\xff\xd8",),
    "BMP": (b"BM",),
    "PPM": (b"P2", b"P3", b"P5", b"P6"),
}

IMAGE_KINDS = {".jpg": "JPEG", ".jpeg": "JPEG", ".bmp": "BMP", ".png": "PNG"}


def read_image(path: Path) -> Recorded:
    """Read an image; see `labdata.importers.read_frames`."""
    kind = IMAGE_KINDS.get(path.suffix.lower(), "PPM")
    require_memory(path.stat().st_size, 1, path.name)
    content = path.read_bytes()
    if not content.startswith(SIGNATURES[kind]):
        raise BadInput(
            f"a {path.suffix} file must be a {kind} picture, got something else in {path}"
        )
    if kind == "PNG":
        _check_png(content, path)
    data = _decode(content, kind, path)
    if data is None or data.ndim not in (2, 3):
        raise BadInput(f"a {kind} file must be whole and readable, got {path}")
    names = (ROW, COL) if data.ndim == 2 else (ROW, COL, COLOUR)
    return Recorded(data=data, names=names, notes=(lossy_note("JPEG"),) if kind == "JPEG" else ())


def _decode(content: bytes, kind: str, path: Path) -> NDArray | None:
    """Return the pixels, red first; None for a truncated or damaged file.

    Pillow detects truncated JPEG and BMP files, which OpenCV completes silently; OpenCV keeps 16
    bits of colour.
    """
    from PIL import Image

    try:
        Image.init()
        # The size limit of Image.open is below the size of large cameras.
        with (
            warnings.catch_warnings(action="ignore"),
            Image.OPEN[kind][0](io.BytesIO(content), "") as picture,
        ):
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


def conditions(path: Path, extension: str | None = None) -> Stated:
    """Return the conditions that the texts before the pixels of a PNG file state."""
    from PIL import Image

    with Image.open(path) as picture:
        texts = {str(key): text for key, text in picture.info.items() if isinstance(text, str)}
    return stated_in_text(texts)


def _check_png(content: bytes, path: Path) -> None:
    """Require intact PNG chunks, since the decoder fills missing data silently.

    Notes
    -----
    A chunk has length, type, data and the CRC-32 of type and data; IHDR is the first and IEND the
    last (W3C, Portable Network Graphics, section 5).
    """
    at, kind = len(PNG_SIGNATURE), b""
    while kind != b"IEND":
        if at + 12 > len(content):
            raise BadInput(f"a PNG file must be whole, got {path} without its end")
        length, kind = struct.unpack_from(">I4s", content, at)
        checked = content[at + 4 : at + 8 + length]
        if struct.pack(">I", zlib.crc32(checked)) != content[at + 8 + length : at + 12 + length]:
            raise BadInput(
                f"a PNG file must be whole, got {path} whose part at byte {at} is damaged"
            )
        at += 12 + length


RAW_NOTE = "camera raw: active area, one colour plane, black level recorded and not subtracted"


def read_raw(path: Path) -> Recorded:
    """Read the mosaic of a raw image; see `labdata.importers.read_frames`.

    Notes
    -----
    A plane of a 2x2 mosaic has half the rows and columns of the sensor, so its column pitch is two
    sensor pitches. The black level is recorded, not subtracted.
    """
    import rawpy

    try:
        with rawpy.RawPy() as raw:
            raw.open_file(str(path))
            require_picture(raw.sizes.raw_height, raw.sizes.raw_width, path.name)
            require_room(path, pixels=raw.sizes.raw_height * raw.sizes.raw_width, pixel_bytes=2)
            raw.unpack()
            return _mosaic(raw, path)
    except (
        rawpy.LibRawError,
        NotImplementedError,
    ) as error:  # the latter: a mosaic without a pattern
        reason = error.args[0] if error.args else "unknown"
        reason = reason.decode(errors="replace") if isinstance(reason, bytes) else reason
        raise BadInput(
            f"a raw file must be whole and of a known camera, got {path}: {reason}"
        ) from None


def _mosaic(raw, path: Path) -> Recorded:
    if raw.raw_image.ndim != 2:
        raise BadInput(
            f"a raw file must hold a mosaic or one plane, got {raw.raw_image.shape} in {path}"
        )
    sites = raw.raw_pattern
    if sites is not None and sites.shape != (2, 2):
        raise BadInput(
            f"the mosaic of a raw file must repeat every 2x2 pixels, got {sites.shape} in {path}"
        )
    colours = [0] if sites is None else sites.ravel().tolist()
    description = raw.color_desc.decode().lower()
    return Recorded(
        data=np.array(raw.raw_image_visible),
        names=(ROW, COL),
        pattern=None if sites is None else "".join(description[colour] for colour in colours),
        black_dn=tuple(float(raw.black_level_per_channel[colour]) for colour in colours),
        full_scale_dn=float(raw.white_level) if raw.white_level else None,
        notes=(RAW_NOTE,),
    )


# FourCC of lossless codecs
LOSSLESS = ("", "DIB ", "RGB ", "RAW ", "Y800", "GREY", "Y8  ", "FFV1", "HFYU", "FFVH", "MPNG")


def read_video(path: Path) -> Recorded:
    """Read all frames of a video; see `labdata.importers.read_frames`."""
    import cv2

    with path.open("rb") as file:
        start = file.read(4)
    if start != b"RIFF":
        raise BadInput(f"a .avi file must be an AVI video, got something else in {path}")
    video = cv2.VideoCapture(str(path))
    try:
        code = int(video.get(cv2.CAP_PROP_FOURCC)) if video.isOpened() else 0
        rows, columns = (
            int(video.get(size)) for size in (cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FRAME_WIDTH)
        )
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
    if (
        data.ndim == 4 and (data == data[..., :1]).all()
    ):  # OpenCV returns grey as three equal colours
        data = data[..., 0]
    if data.ndim == 3:
        return Recorded(data=data, names=(FRAME, ROW, COL), notes=notes)
    return Recorded(data=data[..., ::-1], names=(FRAME, ROW, COL, COLOUR), notes=notes)
