"""Zarr arrays: our own stores, of which only acknowledged frames count, and others."""

from pathlib import Path

import numpy as np

from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.importers.axes import axes_of_labels
from labdata.importers.decompression_limit import require_room
from labdata.importers.recorded import Recorded
from labdata.regular_file import require_regular_parts


def read(path: Path) -> Recorded | FrameStack:
    """Read a whole Zarr array; see `labdata.importers.read_frames`."""
    from labdata import store

    if store.is_ours(path):
        return store.read(path)
    import zarr

    require_regular_parts(path, "a Zarr array")
    try:
        array = zarr.open_array(path, mode="r")
        require_room(path, pixels=array.size, pixel_bytes=array.dtype.itemsize)
        labels = getattr(array.metadata, "dimension_names", None) or ()
        return Recorded(data=np.asarray(array[...]), names=axes_of_labels(labels, array.shape))
    except (BadInput, MemoryError):
        raise
    except Exception:
        raise BadInput(f"a folder of frames must be a readable Zarr array, got {path}") from None
