"""Zarr arrays: our own stores, of which only acknowledged frames count, and others."""

from pathlib import Path

import numpy as np

from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.importers.axes import named
from labdata.importers.expansion import require_possible
from labdata.importers.recorded import Recorded


def read(path: Path) -> Recorded | FrameStack:
    """Read a whole Zarr array; see `labdata.importers.read_frames`."""
    from labdata import store

    if store.is_ours(path):
        return store.read(path)
    import zarr

    try:
        array = zarr.open_array(path, mode="r")
        require_possible(array.nbytes, sum(part.stat().st_size for part in path.rglob("*")), path.name)
        labels = getattr(array.metadata, "dimension_names", None) or ()
        return Recorded(data=np.asarray(array[...]), names=named(labels, array.shape))
    except (BadInput, MemoryError):
        raise
    except Exception:
        raise BadInput(f"a folder of frames must be a readable Zarr array, got {path}") from None
