"""How an array lies on the disk: Zarr v3, uncompressed, one chunk a frame, so that a chunk's file is the frame's bytes.

Written by hand from the specification (https://zarr-specs.readthedocs.io/en/latest/v3/core/), because a chunk is then
one plain write that can be forced to the disk in groups; read back by Zarr itself.
"""

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput

METADATA = "zarr.json"


def metadata(frames: int, shape: tuple[int, int], dtype: np.dtype) -> bytes:
    """Return the metadata of an array of `frames` frames of a shape (row, col) and type of pixel."""
    bytes_codec: dict = {"name": "bytes"}
    if dtype.itemsize > 1:
        bytes_codec["configuration"] = {"endian": "little"}
    document = {
        "zarr_format": 3,
        "node_type": "array",
        "shape": [frames, *shape],
        "data_type": dtype.name,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [1, *shape]}},
        # One flat folder: folders of their own would each have to be forced to the disk as well.
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "."}},
        "fill_value": 0.0 if dtype.kind == "f" else 0,
        "codecs": [bytes_codec],
        "attributes": {},
        "storage_transformers": [],
    }
    return json.dumps(document, indent=1).encode()


def read_metadata(path: Path) -> tuple[int, tuple[int, ...], str]:
    """Return frames, shape of a frame and name of the pixel's type that an array's metadata state."""
    try:
        document = json.loads((path / METADATA).read_bytes())
        frames, *shape = map(int, document["shape"])
        return frames, tuple(shape), str(document["data_type"])
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        raise BadInput(f"a stack of the store must be a readable Zarr array, got {path}") from None


def chunk(path: Path, index: int) -> Path:
    """Return the file of a frame."""
    return path / f"c.{index}.0.0"


def frame_bytes(frame: NDArray) -> memoryview:
    """Return a frame's bytes as they lie in its file: rows first, little-endian."""
    return np.ascontiguousarray(frame, dtype=frame.dtype.newbyteorder("<")).data.cast("B")
