"""Size limits of frames, checked before memory is allocated.

A file of a megabyte may unpack to gigabytes, and a header of a few bytes may state any size.
"""

import os
from pathlib import Path

from labdata.errors import BadInput
from labdata.importers.thresholds import MOST_EXPANSION, MOST_OF_MEMORY, MOST_PICTURE_PX


def require_picture(rows: int, cols: int, name: str) -> None:
    """Require an image to have no more pixels than a camera can have."""
    if rows * cols > MOST_PICTURE_PX:
        raise BadInput(
            f"a picture must have at most {MOST_PICTURE_PX} pixels, got {rows} rows x {cols} columns = {rows * cols} "
            f"in {name}: cut out the part that is to be measured"
        )


def require_memory(pixels: int, pixel_bytes: int, name: str) -> None:
    """Require pixels of all frames and colours, of `pixel_bytes` each, to fit into memory."""
    most_bytes = memory_bytes() * MOST_OF_MEMORY
    if pixels * pixel_bytes > most_bytes:
        raise BadInput(
            f"the frames of a file must take at most {most_bytes / 1e9:.3g} GB, {MOST_OF_MEMORY:.0%} of this machine's "
            f"memory, got {pixels} pixels of {pixel_bytes} bytes in {name}: write fewer frames to a file, or save them "
            "as .npy, which is read part by part"
        )


def require_room(path: Path, *, pixels: int, pixel_bytes: int) -> None:
    """Require the pixels that a header states to fit into memory and to be possible for the size of the file."""
    require_memory(pixels, pixel_bytes, path.name)
    files = [path] if path.is_file() else path.rglob("*")
    if pixels * pixel_bytes > MOST_EXPANSION * sum(file.stat().st_size for file in files):
        raise BadInput(
            f"a picture must fit into its file, got {pixels * pixel_bytes} bytes of pixels stated by {path.name}"
        )


def memory_bytes() -> int:
    """Return the memory of this machine, bytes."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
