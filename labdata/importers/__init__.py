"""Importers of frames: one reader per format, selected by the file name and checked by the
content.
"""

import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from labdata.errors import BadInput
from labdata.file_io import cpu_limit, require_regular
from labdata.frames import FrameStack
from labdata.importers.axes import FRAME, Recorded, frames_of, names_of_shape
from labdata.importers.colour_planes import planes_of, require_monochrome
from labdata.importers.full_scale import byte_order_note, with_full_scale
from labdata.importers.headers import NOTHING, Stated

__all__ = ["KINDS", "list_kinds", "module_of", "read_array", "read_conditions", "read_frames"]

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
    "cameras.read_spe": (".spe",),
    "sif.read": (".sif",),
    "cameras.read_ser": (".ser",),
    "cameras.read_img": (".img",),
    "image_files.read_video": (".avi",),
    "array_files.read_zarr": (".zarr",),
}


# Settings of `read_frames` that readers have, by their functions
SETTINGS = {
    "tiff.read": ("extension",),
    "fits.read": ("extension",),
    "array_files.read_hdf5": ("extension",),
    "sif.read": ("extension", "partial"),
    "cameras.read_spe": ("partial",),
    "cameras.read_ser": ("partial",),
}
# Functions that return the conditions of a file, by its reader
CONDITIONS = {
    "fits.read": "fits.conditions",
    "cameras.read_spe": "cameras.spe_conditions",
    "sif.read": "sif.conditions",
    "cameras.read_img": "cameras.img_conditions",
    "image_files.read_image": "image_files.conditions",
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
    extension: str | None = None,
    partial: bool = False,
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
    extension
        Name or number of one picture of a file that holds several: an image of FITS (0 is the
        primary one), a series of TIFF, an array of HDF5, a section of SIF. None: the first, of TIFF
        and HDF5 the largest; a note lists the others.
    partial
        Whether to read the whole frames of a SIF, SPE or SER file that ends early.
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
        stack = _stack(_read_recorded(path, extension, partial), plane, axis, path.name)
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


def read_conditions(path: str | Path, extension: str | None = None) -> Stated:
    """Return the conditions that the header of a file states, and notes; none of most kinds.

    Pixels are not read. A damaged file is BadInput.

    Parameters
    ----------
    extension
        As of `read_frames`.
    """
    path = Path(path)
    function = CONDITIONS.get(module_of(path) or "")
    if function is None or path.is_dir():
        return NOTHING
    require_regular(path, "a file of frames")
    return _protected(path, lambda: _function(function)(path, extension))


def _read_recorded(path: Path, extension: str | None, partial: bool) -> Recorded | FrameStack:
    """Read a file with those of the settings that its reader has."""
    reader, known = reader_of(path), SETTINGS.get(module_of(path) or "", ())
    if extension is not None and "extension" not in known:
        raise BadInput(
            f"`extension` chooses a picture of a FITS, TIFF, HDF5 or SIF file, got {extension!r} "
            f"for {path.name}, which holds one"
        )
    settings = {"extension": extension, "partial": partial}
    return _protected(path, lambda: reader(path, **{name: settings[name] for name in known}))


def _protected(path: Path, read: Callable[[], Any]) -> Any:
    """Read a file; whatever the library of its kind raises on a damaged one is BadInput."""
    try:
        with warnings.catch_warnings(action="ignore"), cpu_limit(path):
            return read()
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
    names, assumed = _names_in_stack(recorded, plane, axis)
    stack = frames_of(data, names, plane=plane, axis=axis, name=name, pattern=recorded.pattern)
    black_dn = _black_dn(recorded, stack.plane)
    swapped = byte_order_note(stack.data)
    return replace(
        stack,
        black_level_dn=stack.black_level_dn if black_dn is None else black_dn,
        full_scale_dn=recorded.full_scale_dn
        if stack.full_scale_dn is None
        else stack.full_scale_dn,
        notes=(*recorded.notes, *assumed, *stack.notes, *swapped),
    )


def _names_in_stack(
    recorded: Recorded, plane: str | None, axis: str | None
) -> tuple[Sequence[str], tuple[str, ...]]:
    """Return the axes of a file, and notes on planes that its writer marked as colours.

    In a stack of frames four such planes of an array are frames if the last one is an image, which
    alpha is not. Of three the file does not show what they are.
    """
    names, doubts = recorded.names, recorded.doubts
    if axis is None or not doubts:
        return names, doubts
    if axis != FRAME or plane is not None or not recorded.may_be_frames:
        return names, doubts if axis == FRAME else ()
    last = recorded.data[-1]
    if len(recorded.data) > 3 and last.min() != last.max():
        return (FRAME, *names[1:]), (
            "the planes of the file, marked as colours and alpha, are the frames of the stack: its "
            "last plane is an image; `plane` luminance takes them for colours",
        )
    raise BadInput(
        f"a stack must know its frames, got {len(recorded.data)} planes that their file marks as "
        'colours: `axis` 0 if they are frames (tifffile: photometric="minisblack" writes them so), '
        "`plane` luminance, r, g or b if they are colours"
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


def reader_of(path: Path) -> Callable[..., Recorded | FrameStack]:
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
    return _function(module)


def _function(name: str) -> Callable[..., Any]:
    """Return a function of this package by the name of its module and its own."""
    module, function = name.split(".")
    return getattr(import_module(f"labdata.importers.{module}"), function)
