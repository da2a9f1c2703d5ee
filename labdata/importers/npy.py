"""NumPy arrays in .npy files: (row, col), (frame, row, col) or (row, col, colour)."""

import warnings
from pathlib import Path

import numpy as np

from labdata.errors import BadInput
from labdata.importers.axes import names_of_shape
from labdata.importers.recorded import Recorded


def read(path: Path) -> Recorded:
    """Map an array into memory, its pixels read as they are needed; see `labdata.importers.read_frames`."""
    try:
        with warnings.catch_warnings(action="ignore"):
            # A file without pixels cannot be mapped.
            data = np.load(path, mmap_mode="r" if path.stat().st_size else None, allow_pickle=False)
    except MemoryError:
        raise
    except Exception:  # a damaged header is read as Python, and fails in as many ways
        data = None
    if not isinstance(data, np.ndarray):
        raise BadInput(
            "a .npy file must hold one whole array of numbers, got something else, or fewer pixels than its header "
            f"states, in {path}"
        )
    return Recorded(data=data, names=names_of_shape(data.shape))
