"""Frames as files of other programs: TIFF, FITS, HDF5, .npy, and PNG pictures."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.importers.axes import optional_module

# Percentiles shown as black and white in a picture.
BLACK, WHITE = 0.5, 99.8


def write_frames(stack: FrameStack, path: str | Path) -> Path:
    """Write the frames of a stack to one file; the ending states the format.

    Parameters
    ----------
    stack
        Frames, written with their values and type: .tif, .npy, .fits (axes col, row, frame) or .h5
        (data set "frames"). Their unit is in the description of a .tif, the card BUNIT of a .fits
        and the attribute "unit" of the data set. A .png holds the mean frame as a picture of 8 bits
        between two percentiles, for looking at only.
    path
        The file.

    Raises
    ------
    BadInput
        If the ending is unknown, or a library of an extra is missing.

    Examples
    --------
    >>> import tempfile
    >>> stack = FrameStack(data=np.zeros((2, 8, 8), np.uint16))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     print(write_frames(stack, f"{folder}/a.npy").name)
    a.npy
    """
    path = Path(path)
    write = WRITERS.get(path.suffix.lower())
    if write is None:
        raise BadInput(f"a file of frames must end in {', '.join(WRITERS)}, got {path.name!r}")
    # a full disk leaves no half a file under the name
    half = path.with_name(f".{path.stem}.half{path.suffix}")
    try:
        write(stack, half)
        half.replace(path)
    finally:
        half.unlink(missing_ok=True)
    return path


def picture_of(frame: NDArray) -> NDArray[np.uint8]:
    """Return a frame (row, col) as a grey picture of 8 bits between percentiles `BLACK` and
    `WHITE`.
    """
    low, high = np.percentile(frame, (BLACK, WHITE))
    scaled = (np.asarray(frame, float) - low) / max(high - low, 1e-12)
    return np.clip(255.0 * scaled + 0.5, 0, 255).astype(np.uint8)


def _tiff(stack: FrameStack, path: Path) -> None:
    import tifffile

    metadata = {"axes": "TYX", "unit": stack.unit}
    tifffile.imwrite(path, stack.data, photometric="minisblack", metadata=metadata)


def _png(stack: FrameStack, path: Path) -> None:
    from PIL import Image

    Image.fromarray(picture_of(stack.data.mean(axis=0, dtype=np.float64))).save(path)


def _fits(stack: FrameStack, path: Path) -> None:
    fits = optional_module("astropy.io.fits", "fits", path)
    file = fits.PrimaryHDU(stack.data)
    file.header["BUNIT"] = stack.unit
    file.writeto(path, overwrite=True)


def _hdf5(stack: FrameStack, path: Path) -> None:
    h5py = optional_module("h5py", "hdf5", path)
    with h5py.File(path, "w") as file:
        frames = file.create_dataset("frames", data=stack.data, compression="gzip")
        frames.attrs["unit"] = stack.unit


WRITERS: dict[str, Callable[[FrameStack, Path], None]] = {
    ".tif": _tiff,
    ".tiff": _tiff,
    ".npy": lambda stack, path: np.save(path, stack.data),
    ".fits": _fits,
    ".h5": _hdf5,
    ".png": _png,
}
