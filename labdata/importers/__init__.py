"""Frames made elsewhere: one module per format, chosen by what the file is called and checked by what it holds."""

import os
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.importers.emva1288 import import_emva1288
from labdata.importers.full_scale import with_full_scale
from labdata.importers.loose import import_frames

__all__ = ["KINDS", "import_emva1288", "import_frames", "known_kinds", "read_frames"]

# Ending -> module of this package whose function `read(path, plane)` reads it.
KINDS: dict[str, str] = {
    ".tif": "tiff",
    ".tiff": "tiff",
    ".npy": "npy",
    ".fits": "fits",
    ".fit": "fits",
    ".fts": "fits",
    ".png": "png",
    ".dng": "raw",
    ".nef": "raw",
    ".cr2": "raw",
    ".cr3": "raw",
    ".arw": "raw",
    ".orf": "raw",
    ".raf": "raw",
    ".rw2": "raw",
    ".pef": "raw",
    ".zarr": "zarr_array",
}


def known_kinds() -> str:
    """The kinds of file that can be read, in words."""
    return ", ".join(KINDS) + " or a Zarr array"


def read_frames(path: str | Path, plane: str | None = None) -> FrameStack:
    """Read the frames of a file or of a Zarr array.

    Parameters
    ----------
    path
        The file; its ending says what kind it is.
    plane
        Colour plane to read where there are several: "r", "g", "b" or "luminance" of an RGB picture, "r", "g1",
        "g2" or "b" of a mosaic. None: the luminance of an RGB picture (noted); a mosaic must be told.

    Returns
    -------
    FrameStack
        Pixels as they are in the file, shape (frame, row, col); nothing subtracted, scaled or demosaiced.

    Raises
    ------
    BadInput
        If the file is missing, of no known kind, damaged, or holds no frames.
    """
    path = Path(path)
    if not os.path.exists(path):  # Path.exists raises on names that no disk takes
        raise BadInput(f"a file of frames must exist to be read, got {path}")
    try:
        return with_full_scale(reader_of(path)(path, plane))
    except BadInput as error:
        if path.name in str(error):
            raise
        raise BadInput(f"{error}, in {path}") from None


def reader_of(path: Path) -> Callable[[Path, str | None], FrameStack]:
    """Return the function that reads a file or folder; one of no known kind is a BadInput."""
    if (path / "zarr.json").is_file():
        name = "zarr_array"
    elif path.is_dir():
        raise BadInput(f"frames must be a file or a Zarr array, got the folder {path}")
    elif path.suffix.lower() not in KINDS:
        raise BadInput(f"a file of frames must be one of {known_kinds()}, got {path.name!r}")
    else:
        name = KINDS[path.suffix.lower()]
    return import_module(f"labdata.importers.{name}").read
