"""FITS: the first image of the file, scaled as its header says."""

from pathlib import Path

import numpy as np

from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.importers import planes


def read(path: Path, plane: str | None = None) -> FrameStack:
    """Read the first image as frames; see `labdata.importers.read_frames`."""
    try:
        from astropy.io import fits
    except ImportError:
        raise BadInput(f"FITS files need astropy, got {path.name}: pip install 'charact[fits]'") from None
    data = _first_image(fits, path)
    if data.ndim not in (2, 3):
        raise BadInput(f"a FITS image must have 2 or 3 axes, got the shape {data.shape} in {path}")
    data = np.asarray(data).astype(data.dtype.newbyteorder("="), copy=False)
    return planes.mono(planes.frames_of(data, path.name), plane, path.name)


def _first_image(fits, path: Path) -> np.ndarray:
    import warnings

    try:
        # Headers out of order are common and harmless; a file that ends early is neither.
        with warnings.catch_warnings(record=True) as told, open(path, "rb") as content:
            warnings.simplefilter("always")
            with fits.open(content, memmap=False) as file:
                image = _image_of(file, path)
    except BadInput:
        raise
    except Exception:
        raise BadInput(f"a FITS file must be whole and readable, got {path}") from None
    if any("truncated" in str(warning.message) for warning in told):
        raise BadInput(f"a FITS file must be whole, got {path} without its end")
    return image


def _image_of(file, path: Path) -> np.ndarray:
    for unit in file:
        if getattr(unit, "is_image", False) and unit.header.get("NAXIS", 0) > 0:
            return unit.data
    raise BadInput(f"a FITS file must hold an image, got none in {path}")
