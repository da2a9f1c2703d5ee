"""HDF5: the only or the largest array of pictures in the file, its axes by their labels."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from labdata.errors import BadInput
from labdata.importers.axes import axes_of_labels
from labdata.importers.decompression_limit import require_room
from labdata.importers.recorded import Recorded
from labdata.regular_file import require_regular


def read(path: Path) -> Recorded:
    """Read an array of two axes or more; see `labdata.importers.read_frames`."""
    try:
        import h5py  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise BadInput(f"HDF5 files need h5py, got {path.name}: pip install 'charact[hdf5]'") from None
    try:
        with h5py.File(path, "r") as file:
            arrays: list = []
            file.visititems(lambda _, item: _collect(item, arrays, h5py.Dataset))
            if not arrays:
                raise BadInput(f"an HDF5 file must hold an array of pictures, got none in {path}")
            largest = max(arrays, key=lambda array: array.size)
            for other in _other_files(largest):
                require_regular(path.parent / other, f"a file to which {path.name} refers")
            require_room(path, pixels=largest.size, pixel_bytes=largest.dtype.itemsize)
            labels = [dimension.label for dimension in largest.dims]
            names = axes_of_labels(labels, largest.shape)
            others = [array.name for array in arrays if array.name != largest.name]
            notes = (f"the largest of {len(arrays)} arrays was read, {largest.name}",) if others else ()
            return Recorded(data=np.asarray(largest[()]), names=names, notes=notes)
    except (BadInput, MemoryError):
        raise
    except Exception:
        raise BadInput(f"an HDF5 file must be whole and readable, got {path}") from None


def _other_files(array) -> Iterator[str]:
    """Yield the files, if any, in which the pixels of an array lie instead of its own."""
    yield from (name for name, *_ in array.external or ())
    yield from (source.file_name for source in (array.virtual_sources() if array.is_virtual else ()))


def _collect(item, arrays: list, kind: type) -> None:
    """Add an array of numbers with two axes or more."""
    if isinstance(item, kind) and item.ndim >= 2 and item.dtype.kind in "uif":
        arrays.append(item)
