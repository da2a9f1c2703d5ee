"""NumPy arrays in .npy files: (row, col) or (frame, row, col)."""

import warnings
from pathlib import Path

import numpy as np

from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.importers import planes


def read(path: Path, plane: str | None = None) -> FrameStack:
    """Read an array as frames; see `labdata.importers.read_frames`."""
    try:
        with warnings.catch_warnings(action="ignore"):
            data = np.load(path, allow_pickle=False)
    except Exception:  # a damaged header is read as Python, and fails in as many ways
        raise BadInput(f"a .npy file must hold one whole array of numbers, got {path}") from None
    if not isinstance(data, np.ndarray):
        raise BadInput(f"a .npy file must hold one array, got an archive in {path}")
    if data.ndim not in (2, 3):
        raise BadInput(f"an array of frames must have 2 or 3 axes, got the shape {data.shape} in {path}")
    data = data.astype(data.dtype.newbyteorder("="), copy=False)
    return planes.mono(planes.frames_of(data, path.name), plane, path.name)
