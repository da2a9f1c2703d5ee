"""Reader of TIFF files: integer and real pixels of 1 to 64 bits, many pages."""

import logging
import math
from pathlib import Path

import numpy as np

from labdata.errors import BadInput
from labdata.file_io import require_picture, require_room
from labdata.importers.axes import (
    COL,
    COLOUR,
    FRAME,
    ROW,
    UNNAMED,
    Recorded,
    lossy_note,
    meaning,
    names_of_shape,
)
from labdata.importers.parts import Part, choose
from labdata.importers.thresholds import THUMBNAIL

NUMERALS = {2: "two", 3: "three", 4: "four"}
LOSSY = ("JPEG", "WEBP", "JETRAW")


def read(path: Path, extension: str | None = None) -> Recorded:
    """Read the images of a TIFF file; see `labdata.importers.read_frames`."""
    import tifffile

    logger = logging.getLogger("tifffile")
    silent, logger.disabled = logger.disabled, True  # its warnings become messages here
    try:
        with tifffile.TiffFile(path) as file:
            return _read_series(file, path, extension)
    finally:
        logger.disabled = silent


def _read_series(file, path: Path, extension: str | None) -> Recorded:
    _check_whole(file, path)
    _check_possible(file, path)
    series, notes = _choose(file, path, extension)
    page = series.keyframe
    notes += _check_meaning(page, path)
    packing = getattr(page.compression, "name", str(page.compression))
    if any(word in packing for word in LOSSY):
        notes += (lossy_note(packing),)
    names = _names(file, series)
    planar = COLOUR in names and names[-1] != COLOUR and FRAME not in names
    planes = series.shape[names.index(COLOUR)] if planar else 0
    bits = int(page.bitspersample)
    data = series.asarray()
    return Recorded(
        data=data,
        names=names,
        pattern=_pattern(page),
        full_scale_dn=float(2**bits - 1)
        if data.dtype.kind == "u" and 8 < bits < 8 * data.itemsize
        else None,
        notes=notes,
        doubts=(
            f"its writer marked the {NUMERALS.get(planes, planes)} planes of the file as colours"
            f"{' and alpha' if planes > 3 else ''}; if they are frames: `axis` 0",
        )
        * planar,
        may_be_frames=planar and _is_array(file, series.shape),
    )


def _is_array(file, shape: tuple[int, ...]) -> bool:
    """Whether a file is an array of this shape, written by a library that guesses what planes are.

    Tifffile marks three and four planes as red, green, blue and alpha unless the caller states
    `photometric`; it keeps the shape of the array with them.
    """
    return any(
        tuple(described.get("shape", ())) == shape for described in file.shaped_metadata or ()
    )


def _choose(file, path: Path, extension: str | None) -> tuple:
    """Return the chosen series, by default that of the largest images, and a note on others."""
    sizes = [math.prod(series.keyframe.shape[:2]) for series in file.series]
    largest = int(np.argmax(sizes))
    parts = [Part(at, series.name, series.shape) for at, series in enumerate(file.series)]
    others = sizes[:largest] + sizes[largest + 1 :]
    if extension is None and any(size > THUMBNAIL * max(sizes) for size in others):
        raise BadInput(
            f"the pages of a TIFF file must have one shape, got {', '.join(map(str, parts))} in "
            f"{path}: `extension` 0 takes the first"
        )
    at, notes = choose(parts, extension, largest, "the largest")
    return file.series[at], notes


def _names(file, series) -> tuple[str, ...]:
    """Return the axes from the letters of the series.

    Pages without a description are frames, unless their shape excludes it. ImageJ labels every
    stack as slices; only in a hyperstack these are focus positions.
    """
    names = [meaning(letter) for letter in series.axes]
    plain = (file.imagej_metadata or {}).get("hyperstack") is None and series.kind == "imagej"
    names = [UNNAMED if plain and name == "focus" else name for name in names]
    if len(names) == 3 and names[1:] == [ROW, COL] and series.axes[0] in "QI":
        guessed = names_of_shape(series.shape)
        names = list(guessed) if guessed[0] == ROW else [FRAME, ROW, COL]
    return tuple(names)


def _pattern(page) -> str | None:
    """Return the colours of a mosaic's sites where the file states them."""
    # Tag of the mosaic colours, 0 red, 1 green, 2 blue (TIFF/EP, ISO 12234-2)
    tag = page.tags.get(33422)
    if tag is None or len(sites := bytes(tag.value)) != 4 or not set(sites) <= {0, 1, 2}:
        return None
    return "".join("rgb"[site] for site in sites)


def _check_whole(file, path: Path) -> None:
    """Require pages that end, and all strips within the file, since the decoder fills missing data
    silently.
    """
    if not file.pages:
        raise BadInput(f"a TIFF file must hold at least one page, got none in {path}")
    size, offsets = path.stat().st_size, set()
    for page in file.pages:
        page = page.aspage()
        if page.offset in offsets:
            raise BadInput(
                "the pages of a TIFF file must end, got one that leads back to an earlier one in "
                f"{path}"
            )
        offsets.add(page.offset)
        end = max(
            (o + n for o, n in zip(page.dataoffsets, page.databytecounts, strict=True)), default=0
        )
        if end > size:
            raise BadInput(
                f"a TIFF file must be whole, got {path} of {size} bytes where its pixels end at "
                f"{end}"
            )


def _check_possible(file, path: Path) -> None:
    """Require a possible number of pixels; strips and tiles are unpacked completely."""
    pixels, pixel_bytes = 0, 1
    for page in file.pages:
        page = page.aspage()
        require_picture(page.imagelength, page.imagewidth, path.name)
        pixels += max(math.prod(page.shape), math.prod(page.chunks or (0,)))
        pixel_bytes = max(pixel_bytes, page.dtype.itemsize if page.dtype else 1)
    require_room(path, pixels=pixels, pixel_bytes=pixel_bytes)


def _check_meaning(page, path: Path) -> tuple[str, ...]:
    """Require pixel values to increase with light: no colour indices, no inverted scale."""
    photometric = getattr(page.photometric, "name", "")
    if photometric == "PALETTE":
        table = np.asarray(page.colormap, np.int64)
        # A monotonic table, grey or of one colour as in ImageJ, keeps the order of the stored
        # values.
        if (np.diff(table) >= 0).all() and (table[:, -1] > table[:, 0]).any():
            return (
                (
                    "the look-up table of the file rises with the stored values, which are "
                    "measured as they are"
                ),
            )
        raise BadInput(
            "the pixels of a TIFF file must rise with light, got a look-up table of colours that "
            f"fall in {path}: choose a grey look-up table before saving (ImageJ: Image > Lookup "
            "Tables > Grays)"
        )
    if photometric == "MINISWHITE":
        raise BadInput(
            f"the pixels of a TIFF file must rise with light, got the type MINISWHITE in {path}: "
            "invert it before saving (ImageJ: Edit > Invert)"
        )
    return ()
