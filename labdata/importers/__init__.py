"""Importers of frames: one reader per format, selected by the file name and checked by the
content.
"""

import os
import warnings
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np

from labdata.errors import BadInput
from labdata.file_io import cpu_limit, require_regular
from labdata.frames import FrameStack
from labdata.importers.axes import Recorded, frames_of, names_of_shape
from labdata.importers.colour_planes import planes_of, require_monochrome
from labdata.importers.full_scale import byte_order_note, with_full_scale

__all__ = ["KINDS", "list_kinds", "module_of", "read_array", "read_frames"]

# Endings of files by module and function of this package that reads them
KINDS: dict[str, tuple[str, ...]] = {
    "tiff.read": (".tif", ".tiff"),
    "array_files.read_npy": (".npy",),
    "fits.read": (".fits", ".fit", ".fts", ".fits.gz", ".fit.gz", ".fts.gz", ".fits.fz", ".fz"),
    "image_files.read_image": (".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm", ".pnm"),
    "image_files.read_raw": (
        ".dng",
        ".nef",
        ".cr2",
        ".cr3",
        ".arw",
        ".orf",
        ".raf",
        ".rw2",
        ".pef",
    ),
    "array_files.read_hdf5": (".h5", ".hdf5", ".hdf", ".nxs"),
    "cameras.read": (".spe", ".sif", ".ser"),
    "image_files.read_video": (".avi",),
    "array_files.read_zarr": (".zarr",),
}


_LONG_NAMES = {
    "tif": "TIFF",
    "fit": "FITS",
    "fts": "FITS",
    "gz": "FITS",
    "fz": "FITS",
    "h5": "HDF5",
    "": "Zarr",
}


def list_kinds() -> str:
    """Return the file endings that can be read, as text."""
    return (
        ", ".join(ending for endings in KINDS.values() for ending in endings) + " or a Zarr array"
    )


def read_frames(
    path: str | Path,
    plane: str | None = None,
    *,
    axis: str | None = None,
    find_full_scale: bool = True,
) -> FrameStack:
    """Read the frames of a file, by its ending, or of a Zarr array.

    Parameters
    ----------
    plane
        Colour plane to read where there are several: "r", "g", "b" or "luminance" of an RGB image,
        "r", "g1", "g2" or "b" of a mosaic, with the colours of its first 2x2 pixels before it,
        "rggb:g1", where neither the file nor its pixels show them. None: the luminance of an RGB
        image (noted); a mosaic needs a plane. A number, from 0, is the plane along an axis that
        does not count frames.
    axis
        Number or name of the frame axis, where the file does not state it or states another;
        "frame": the first axis, if the file does not name it.
    find_full_scale
        Whether to find full scale from the data where the file does not state it.

    Returns
    -------
    FrameStack
        Pixels as in the file, shape (frame, row, col); nothing subtracted, scaled or demosaiced. A
        non-finite border is cut off. A file that is damaged, unknown or without a known frame axis
        is BadInput.
    """
    path = Path(path)
    try:
        stack = _stack(_read_recorded(path), plane, axis, path.name)
        return with_full_scale(stack) if find_full_scale else stack
    except BadInput as error:
        if path.name in str(error):
            raise
        raise BadInput(f"{error}, in {path}") from None


def read_array(array: object, plane: str | None = None, *, axis: str | None = None) -> FrameStack:
    """Return the frames of an array in memory, by the rules of a .npy file; see `read_frames`.

    What is no array of real numbers with two to four axes is BadInput.

    Examples
    --------
    >>> import numpy as np
    >>> read_array(np.zeros((4, 60, 80), np.uint16)).shape
    (4, 60, 80)
    """
    try:
        data = np.asarray(array)
    except (ValueError, TypeError):  # rows of unequal length, or an object that refuses
        data = np.empty(0, object)
    if isinstance(array, np.ma.MaskedArray) and np.ma.is_masked(array):
        raise BadInput(
            "an image must have every pixel, got an array with masked pixels: fill them or cut "
            "them off"
        )
    if data.dtype.kind not in "uifb" or data.ndim < 2:
        raise BadInput(
            "an image must be an array of numbers with at least rows and columns, got "
            f"{type(array).__name__} of type {data.dtype} and shape {data.shape}"
        )
    data = data.astype(np.uint8) if data.dtype.kind == "b" else data
    recorded = Recorded(data=data, names=names_of_shape(data.shape))
    return with_full_scale(_stack(recorded, plane, axis, "the array"))


def _read_recorded(path: Path) -> Recorded | FrameStack:
    """Read a file; whatever the library of its kind raises on a damaged one is BadInput."""
    reader = reader_of(path)
    try:
        with warnings.catch_warnings(action="ignore"), cpu_limit(path):
            return reader(path)
    except (BadInput, MemoryError):
        raise
    except Exception as error:
        why = (str(error).strip().splitlines() or [type(error).__name__])[0]
        kind = _LONG_NAMES.get(path.suffix.lower()[1:], path.suffix[1:].upper())
        raise BadInput(f"a {kind} file must be whole and readable, got {path}: {why}") from None


def _stack(
    recorded: Recorded | FrameStack, plane: str | None, axis: str | None, name: str
) -> FrameStack:
    """Return the frames of a reader's result."""
    if isinstance(recorded, FrameStack):
        if plane in (None, "mono"):
            return recorded
        selected = require_monochrome(recorded.data, plane, name)
        return replace(
            recorded,
            data=selected.data,
            plane=selected.plane,
            sample_pitch_px=selected.sample_pitch_px,
            notes=(*recorded.notes, *selected.notes),
        )
    data = recorded.data.astype(recorded.data.dtype.newbyteorder("="), copy=False)
    stack = frames_of(
        data, recorded.names, plane=plane, axis=axis, name=name, pattern=recorded.pattern
    )
    black_dn = _black_dn(recorded, stack.plane)
    swapped = byte_order_note(stack.data)
    return replace(
        stack,
        black_level_dn=stack.black_level_dn if black_dn is None else black_dn,
        full_scale_dn=recorded.full_scale_dn
        if stack.full_scale_dn is None
        else stack.full_scale_dn,
        notes=(*recorded.notes, *(() if axis else recorded.doubts), *stack.notes, *swapped),
    )


def _black_dn(recorded: Recorded, plane: str) -> float | None:
    """Return the black level of the selected plane."""
    if len(recorded.black_dn) < 2 or recorded.pattern is None:
        return recorded.black_dn[0] if recorded.black_dn else None
    row, col = planes_of(recorded.pattern)[plane]
    return recorded.black_dn[2 * row + col]


def module_of(path: Path) -> str | None:
    """Return the reader of a file by its ending; None for an unknown ending."""
    name = path.name.lower()
    return next((module for module, endings in KINDS.items() if name.endswith(endings)), None)


def reader_of(path: Path) -> Callable[[Path], Recorded | FrameStack]:
    """Return the function that reads a file or folder; an unknown kind is a BadInput."""
    if not os.path.isdir(path):  # Path.is_dir raises on names that no file system accepts
        require_regular(path, "a file of frames")
    if (path / "zarr.json").is_file():
        module = "array_files.read_zarr"
    elif path.is_dir() and module_of(path) != "array_files.read_zarr":
        raise BadInput(f"frames must be a file or a Zarr array, got the folder {path}")
    elif (module := module_of(path)) is None:
        raise BadInput(
            f"a file of frames must be one of {list_kinds()}, got {path.name!r}: save it as TIFF "
            "or FITS with the camera's own software or ImageJ (File > Save As > Tiff), video "
            f"with ffmpeg -i {path.name} -c:v ffv1 x.avi"
        )
    name, function = module.split(".")
    return getattr(import_module(f"labdata.importers.{name}"), function)
