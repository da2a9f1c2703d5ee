"""FITS, plain or packed by gzip or fpack: the first image of the file, scaled as its header says."""

import warnings
from pathlib import Path

import numpy as np

from labdata.errors import BadInput
from labdata.importers.axes import COL, FRAME, ROW, UNNAMED, meaning
from labdata.importers.expansion import require_possible
from labdata.importers.recorded import Recorded, lossy_note

FRAME_COUNTS = ("NFRAMES", "NUMFRAME", "NUMFRMS", "FRAMES", "NIMAGES", "NUMKIN")
"""Cards in which camera software states how many frames an image holds."""


def read(path: Path) -> Recorded:
    """Read the first image; see `labdata.importers.read_frames`."""
    try:
        from astropy.io import fits
    except ImportError:
        raise BadInput(f"FITS files need astropy, got {path.name}: pip install 'charact[fits]'") from None
    try:
        # Headers out of order are common and harmless; a file that ends early is neither.
        with warnings.catch_warnings(record=True) as warned, open(path, "rb") as content:
            warnings.simplefilter("always")
            with fits.open(content, memmap=False) as file:
                found = _image_of(file, path)
    except (BadInput, MemoryError):
        raise
    except Exception:
        raise BadInput(f"a FITS file must be whole and readable, got {path}") from None
    if any("truncated" in str(warning.message) for warning in warned):
        raise BadInput(f"a FITS file must be whole, got {path} without its end")
    return found


def _image_of(file, path: Path) -> Recorded:
    for unit in file:
        axes = unit.header.get("NAXIS", 0)
        if not getattr(unit, "is_image", False) or axes < 2:
            continue
        sizes = [unit.header[f"NAXIS{axis}"] for axis in range(1, axes + 1)]
        bits = abs(unit.header["BITPIX"])
        require_possible(int(np.prod(sizes, dtype=object)) * bits // 8, path.stat().st_size, path.name)
        packed = getattr(unit, "compression_type", None)
        # Integers are packed as they are; reals are first rounded to a fraction of their noise.
        lossy = (lossy_note(packed),) if packed is not None and unit.header["BITPIX"] < 0 else ()
        pattern = str(unit.header.get("BAYERPAT", "")).strip().lower()
        return Recorded(
            data=np.asarray(unit.data),
            names=_names(unit.header, axes),
            pattern=pattern if len(pattern) == 4 and set(pattern) <= set("rgb") else None,
            notes=lossy,
        )
    raise BadInput(f"a FITS file must hold an image, got none in {path}")


def _names(header, axes: int) -> tuple[str, ...]:
    """Return what the axes count, slowest first; beyond columns and rows by CTYPE or a card that counts frames."""
    names = [COL, ROW]
    for axis in range(3, axes + 1):
        stated = str(header.get(f"CTYPE{axis}", "")).split("-")[0]
        counted = any(header.get(card) == header[f"NAXIS{axis}"] for card in FRAME_COUNTS)
        names.append(FRAME if counted and meaning(stated) == UNNAMED and FRAME not in names else meaning(stated))
    return tuple(reversed(names))
