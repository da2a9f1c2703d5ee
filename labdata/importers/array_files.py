"""Readers of array files: NumPy, Zarr and HDF5."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from labdata.errors import BadInput
from labdata.file_io import require_regular, require_regular_parts, require_room
from labdata.frames import FrameStack
from labdata.importers.axes import Recorded, axes_of_labels, names_of_shape, optional_module
from labdata.importers.parts import Part, choose


def read_npy(path: Path) -> Recorded:
    """Map a .npy array into memory; see `labdata.importers.read_frames`."""
    try:
        # An empty file cannot be mapped.
        data = np.load(path, mmap_mode="r" if path.stat().st_size else None, allow_pickle=False)
    except (ValueError, EOFError):
        data = None
    if not isinstance(data, np.ndarray):
        raise BadInput(
            "a .npy file must hold one whole array of numbers, got something else, or fewer "
            f"pixels than its header states, in {path}"
        )
    return Recorded(data=data, names=names_of_shape(data.shape))


def read_zarr(path: Path) -> Recorded | FrameStack:
    """Read a Zarr array; see `labdata.importers.read_frames`."""
    from labdata import store

    if store.is_ours(path):
        return store.read(path)
    import zarr

    require_regular_parts(path, "a Zarr array")
    array = zarr.open_array(path, mode="r")
    require_room(path, pixels=array.size, pixel_bytes=array.dtype.itemsize)
    labels = getattr(array.metadata, "dimension_names", None) or ()
    return Recorded(data=np.asarray(array[...]), names=axes_of_labels(labels, array.shape))


def read_hdf5(path: Path, extension: str | None = None) -> Recorded:
    """Read an array of two axes or more; see `labdata.importers.read_frames`."""
    h5py = optional_module("h5py", "hdf5", path)
    with h5py.File(path, "r") as file:
        arrays: list = []
        file.visititems(lambda _, item: _collect(item, arrays, h5py.Dataset))
        if not arrays:
            raise BadInput(f"an HDF5 file must hold an array of pictures, got none in {path}")
        parts = [Part(number, array.name, array.shape) for number, array in enumerate(arrays)]
        largest = max(range(len(arrays)), key=lambda number: arrays[number].size)
        at, notes = choose(parts, extension, largest, "the largest")
        chosen = arrays[at]
        for other in _other_files(chosen):
            require_regular(path.parent / other, f"a file to which {path.name} refers")
        require_room(path, pixels=chosen.size, pixel_bytes=chosen.dtype.itemsize)
        names = axes_of_labels([dimension.label for dimension in chosen.dims], chosen.shape)
        return Recorded(data=np.asarray(chosen[()]), names=names, notes=notes)


def _other_files(array) -> Iterator[str]:
    """Yield the external files, if any, that contain the pixels of an array."""
    yield from (name for name, *_ in array.external or ())
    yield from (
        source.file_name for source in (array.virtual_sources() if array.is_virtual else ())
    )


def _collect(item, arrays: list, kind: type) -> None:
    """Collect arrays of numbers with at least two axes."""
    if isinstance(item, kind) and item.ndim >= 2 and item.dtype.kind in "uif":
        arrays.append(item)
