"""Zarr arrays: our own stores, of which only acknowledged frames count, and anyone's."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.importers import planes
from labdata.importers.expansion import require_possible


def read(path: Path, plane: str | None = None) -> FrameStack:
    """Read a whole Zarr array as frames; see `labdata.importers.read_frames`."""
    from labdata import store

    if store.is_ours(path):
        if plane not in (None, "mono"):
            raise BadInput(f"a plane can only be taken of a colour picture, got plane {plane!r} of {path.name}")
        return store.read(path)
    return planes.mono(_foreign(path), plane, path.name)


def _foreign(path: Path) -> NDArray:
    import zarr

    try:
        array = zarr.open_array(path, mode="r")
        require_possible(array.nbytes, sum(part.stat().st_size for part in path.rglob("*")), path.name)
        data = np.asarray(array[...])
    except BadInput:
        raise
    except Exception:
        raise BadInput(f"a folder of frames must be a readable Zarr array, got {path}") from None
    if array.ndim not in (2, 3):
        raise BadInput(f"an array of frames must have 2 or 3 axes, got the shape {array.shape} in {path}")
    return planes.frames_of(data, path.name)
