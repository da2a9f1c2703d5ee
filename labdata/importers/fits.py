"""Reader of FITS files, plain or packed by gzip or fpack."""

import gzip
import math
import warnings
from io import BufferedIOBase
from pathlib import Path

import numpy as np

from labdata.errors import BadInput
from labdata.file_io import require_picture, require_room
from labdata.importers.axes import COL, FRAME, ROW, UNNAMED, Recorded, lossy_note, meaning

GZIP_MAGIC = b"\x1f\x8b"
BLOCK_BYTES = 2880
# 36,000 cards; the longest headers of observatories have some thousands
MOST_HEADER_BYTES = 1000 * BLOCK_BYTES

# Cards with the number of frames, as written by camera software
FRAME_COUNTS = ("NFRAMES", "NUMFRAME", "NUMFRMS", "FRAMES", "NIMAGES", "NUMKIN")


def read(path: Path) -> Recorded:
    """Read the first image; see `labdata.importers.read_frames`."""
    try:
        from astropy.io import fits
    except ImportError:
        raise BadInput(
            f"FITS files need astropy, got {path.name}: pip install 'charact[fits]'"
        ) from None
    # Headers out of order are common and harmless; a truncated file is not.
    with warnings.catch_warnings(record=True) as warned, open(path, "rb") as content:
        warnings.simplefilter("always")
        _check_headers(path)
        with fits.open(content, memmap=False) as file:
            image = _image_of(file, path)
    if any("truncated" in str(warning.message) for warning in warned):
        raise BadInput(f"a FITS file must be whole, got {path} without its end")
    return image


def _image_of(file, path: Path) -> Recorded:
    for unit in file:
        axes = unit.header.get("NAXIS", 0)
        if not getattr(unit, "is_image", False) or axes < 2:
            continue
        packed = getattr(unit, "compression_type", None)
        # Integers are packed without loss; reals are rounded to a fraction of their noise first.
        lossy = (lossy_note(packed),) if packed is not None and unit.header["BITPIX"] < 0 else ()
        return Recorded(
            data=np.asarray(unit.data),
            names=_names(unit.header, axes),
            pattern=_mosaic(unit.header),
            notes=lossy,
        )
    raise BadInput(f"a FITS file must hold an image, got none in {path}")


def _mosaic(header) -> str | None:
    """Return the colours of the first 2x2 pixels of a mosaic; None without one.

    `BAYERPAT` is read from the row and column on that `YBAYROFF` and `XBAYROFF` state, as by Siril
    (free-astro.org, Siril:FITS orientation).
    """
    pattern = str(header.get("BAYERPAT", "")).strip().lower()
    if len(pattern) != 4 or not set(pattern) <= set("rgb"):
        return None
    down, across = (int(header.get(f"{axis}BAYROFF", 0)) for axis in "YX")
    return "".join(
        pattern[2 * ((row + down) % 2) + (col + across) % 2] for row in (0, 1) for col in (0, 1)
    )


def _check_headers(path: Path) -> None:
    """Require a header with an end and an image that fits into memory, before astropy unpacks it.

    Notes
    -----
    A header is a sequence of 2880-byte blocks of 36 cards of 80 bytes; its last card is END. Data
    follow, padded to blocks (FITS Standard 4.0, section 3). An image packed into table rows has its
    sizes under separate names (section 10.1).
    """
    from astropy.io import fits

    with open(path, "rb") as plain:
        packed = plain.read(2) == GZIP_MAGIC
    with gzip.open(path) if packed else open(path, "rb") as file:
        at = 0
        while text := _header_text(file, path):
            header = fits.Header.fromstring(text)
            packed_image = header.get("ZIMAGE", False)
            axes, value_bytes = _axes(header, "Z" if packed_image else "")
            if len(axes) > 1 and (packed_image or header.get("XTENSION") != "BINTABLE"):
                require_picture(axes[1], axes[0], path.name)
                require_room(path, pixels=math.prod(axes), pixel_bytes=value_bytes)
                return
            values = (
                _number(header, "GCOUNT", 1) * (_number(header, "PCOUNT", 0) + math.prod(axes))
                if axes
                else 0
            )
            at += len(text) + -(-values * value_bytes // BLOCK_BYTES) * BLOCK_BYTES
            file.seek(at)


def _axes(header, prefix: str) -> tuple[list[int], int]:
    """Return the length of each axis, and the bytes of a value, from the cards with a prefix."""
    axes = [
        _number(header, f"{prefix}NAXIS{axis}")
        for axis in range(1, _number(header, f"{prefix}NAXIS") + 1)
    ]
    return axes, abs(_number(header, f"{prefix}BITPIX")) // 8


def _number(header, card: str, default: int | None = None) -> int:
    """Return the integer of a card; a missing one without a default is BadInput."""
    if card not in header and default is None:
        raise BadInput(f"a FITS header must have the card {card}, got none")
    return int(header.get(card, default))


def _header_text(file: BufferedIOBase, path: Path) -> bytes:
    """Return the blocks of the next header; none at the end of the file."""
    text = block = file.read(BLOCK_BYTES)
    while block and not any(
        block[card : card + 8] == b"END     " for card in range(0, BLOCK_BYTES, 80)
    ):
        if len(text) >= MOST_HEADER_BYTES:
            raise BadInput(
                f"a FITS header must end within {MOST_HEADER_BYTES} bytes, got none of them in "
                f"{path}"
            )
        block = file.read(BLOCK_BYTES)
        text += block
    return text


def _names(header, axes: int) -> tuple[str, ...]:
    """Return the axes, slowest first; beyond columns and rows from CTYPE or a frame-count card."""
    names = [COL, ROW]
    for axis in range(3, axes + 1):
        stated = str(header.get(f"CTYPE{axis}", "")).split("-")[0]
        counted = any(header.get(card) == header[f"NAXIS{axis}"] for card in FRAME_COUNTS)
        names.append(
            FRAME
            if counted and meaning(stated) == UNNAMED and FRAME not in names
            else meaning(stated)
        )
    return tuple(reversed(names))
