"""Reader of FITS files, plain or packed by gzip or fpack."""

import gzip
import math
import warnings
from collections import ChainMap
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from io import BufferedIOBase
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from labdata.errors import BadInput
from labdata.file_io import require_picture, require_room
from labdata.importers.axes import (
    COL,
    FRAME,
    ROW,
    UNNAMED,
    Recorded,
    lossy_note,
    meaning,
    optional_module,
)
from labdata.importers.headers import Stated, stated
from labdata.importers.parts import Part, choose

GZIP_MAGIC = b"\x1f\x8b"
BLOCK_BYTES = 2880
# 36,000 cards; the longest headers of observatories have some thousands
MOST_HEADER_BYTES = 1000 * BLOCK_BYTES

# Cards with the number of frames, as written by camera software
FRAME_COUNTS = ("NFRAMES", "NUMFRAME", "NUMFRMS", "FRAMES", "NIMAGES", "NUMKIN")
# Cards of the exposure in seconds, the temperature of the sensor in degrees Celsius, the gain of an
# electron-multiplying register and the number of exposures in one frame, the usual one first
# (SBFITSEXT 1.0 and its followers; Andor Solis)
EXPOSURE_CARDS = ("EXPTIME", "EXPOSURE")
TEMPERATURE_CARDS = ("CCD-TEMP", "CCDTEMP", "DET-TEMP", "TEMP")
EM_GAIN_CARDS = ("EMGAIN", "EM_GAIN", "EM-GAIN")
COMBINED_CARDS = ("NUMACC", "NCOADDS", "COADDS", "NCOMBINE", "STACKCNT", "SNAPSHOT")


def read(path: Path, extension: str | None = None) -> Recorded:
    """Read the first image, or that of an extension; see `labdata.importers.read_frames`."""
    fits = _library(path)
    # Headers out of order are common and harmless; a truncated file is not.
    with warnings.catch_warnings(record=True) as warned, open(path, "rb") as content:
        warnings.simplefilter("always")
        image, notes = _choose(path, extension)
        with fits.open(content, memmap=False) as file:
            unit = file[image.part.number]
            data = np.asarray(unit.data)
    if any("truncated" in str(warning.message) for warning in warned):
        raise BadInput(f"a FITS file must be whole, got {path} without its end")
    packed = getattr(unit, "compression_type", None)
    # Integers are packed without loss; reals are rounded to a fraction of their noise first.
    lossy = (lossy_note(packed),) if packed is not None and unit.header["BITPIX"] < 0 else ()
    return Recorded(
        data=data,
        names=_names(unit.header, unit.header["NAXIS"]),
        pattern=_mosaic(unit.header),
        notes=(*notes, *lossy),
    )


def _library(path: Path) -> Any:
    return optional_module("astropy.io", "fits", path) and import_module("astropy.io.fits")


def header_of(path: Path, extension: str | None = None) -> Mapping[str, Any]:
    """Return the cards of an image, and those of the primary header that it lacks."""
    return _choose(path, extension)[0].cards


def conditions(path: Path, extension: str | None = None) -> Stated:
    """Return exposure, temperature and gain of the electron-multiplying register of an image.

    Notes
    -----
    `GAIN` is a setting in units of the camera, but in files of Andor whose `EMREALGN` is 1; `EGAIN`
    is a conversion gain, e-/ADU, and no setting.
    """
    header = header_of(path, extension)
    multiplies = header.get("EMREALGN") == 1 and "mult" in str(header.get("OUTPTAMP")).lower()
    stated_conditions, _ = stated(
        exposure_s=_first_number(header, EXPOSURE_CARDS),
        temperature_c=_first_number(header, TEMPERATURE_CARDS),
        em_gain=_first_number(header, ("GAIN",) if multiplies else EM_GAIN_CARDS),
    )
    combined = _first_number(header, COMBINED_CARDS) or 1
    note = f"each frame combines {combined:g} exposures by its header: its read noise is theirs"
    return stated_conditions, (note,) if combined > 1 else ()


def _first_number(header: Mapping[str, Any], cards: Sequence[str]) -> float | None:
    """Return the number of the first card that has one."""
    values = (header.get(card) for card in cards)
    numbers = (v for v in values if isinstance(v, int | float) and not isinstance(v, bool))
    return next((float(number) for number in numbers), None)


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


class _Image(NamedTuple):
    """An image of a file, its cards, and the bytes of a value."""

    part: Part
    cards: Mapping[str, Any]
    value_bytes: int


def _choose(path: Path, extension: str | None) -> tuple[_Image, tuple[str, ...]]:
    """Return the image to read, and a note where there are several.

    It must fit into memory, before astropy unpacks it.
    """
    images: list[_Image] = []
    try:
        images.extend(_images(path))
    except BadInput:
        if not images:  # what follows a first image may be no part of the file
            raise
    if not images:
        raise BadInput(f"a FITS file must hold an image, got none in {path}")
    at, notes = choose([image.part for image in images], extension, 0, "the first")
    shape = images[at].part.shape
    require_picture(shape[-2], shape[-1], path.name)
    require_room(path, pixels=math.prod(shape), pixel_bytes=images[at].value_bytes)
    return images[at], notes


def _images(path: Path) -> Iterator[_Image]:
    """Yield the images of a file by their headers.

    Notes
    -----
    A header is a sequence of 2880-byte blocks of 36 cards of 80 bytes; its last card is END. Data
    follow, padded to blocks (FITS Standard 4.0, section 3). An image packed into table rows has its
    sizes under separate names (section 10.1).
    """
    fits = _library(path)
    with open(path, "rb") as plain:
        packed = plain.read(2) == GZIP_MAGIC
    with gzip.open(path) if packed else open(path, "rb") as file:
        at, number, primary = 0, 0, None
        while text := _header_text(file, path):
            header = fits.Header.fromstring(text)
            primary = header if primary is None else primary
            packed_image = header.get("ZIMAGE", False)
            axes, value_bytes = _axes(header, "Z" if packed_image else "")
            kind = str(header.get("XTENSION", "IMAGE")).strip()
            if len(axes) > 1 and (packed_image or kind == "IMAGE") and not header.get("GROUPS"):
                part = Part(number, str(header.get("EXTNAME", "")).strip(), axes[::-1])
                yield _Image(part, ChainMap(header, primary), value_bytes)
            if packed_image:  # its room in the file is that of the table
                axes, value_bytes = _axes(header, "")
            values = (
                _number(header, "GCOUNT", 1) * (_number(header, "PCOUNT", 0) + math.prod(axes))
                if axes
                else 0
            )
            at += len(text) + -(-values * value_bytes // BLOCK_BYTES) * BLOCK_BYTES
            number += 1
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
