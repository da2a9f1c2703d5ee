"""TIFF: whole and real pixels of 8 to 64 bits, both byte orders, many pages, colour planes kept apart."""

import logging
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.importers import planes
from labdata.importers.expansion import require_possible


def read(path: Path, plane: str | None = None) -> FrameStack:
    """Read all pages of a TIFF file as frames; see `labdata.importers.read_frames`."""
    data, axes = _pixels(path)
    if not data.size:
        raise BadInput(f"a TIFF file must hold pixels, got the shape {data.shape} in {path}")
    if axes.endswith("S"):
        frames = data.reshape((-1, *data.shape[-3:]))
        if frames.shape[-1] >= 3:
            return planes.chosen(frames, plane, path.name)
        return planes.mono(frames[..., 0], plane, path.name)
    return planes.mono(data.reshape((-1, *data.shape[-2:])), plane, path.name)


def _pixels(path: Path) -> tuple[NDArray, str]:
    """Return the pixels with the colour samples, if any, on the last axis, and the names of the axes."""
    import tifffile

    logger = logging.getLogger("tifffile")
    silent, logger.disabled = logger.disabled, True  # it logs what we turn into a sentence
    try:
        with tifffile.TiffFile(path) as file:
            _check_whole(file, path)
            _check_meaning(file, path)
            _check_possible(file, path)
            series = file.series[0]
            if len(file.series) > 1:
                shapes = {one.shape for one in file.series}
                raise BadInput(f"the pages of a TIFF file must have one shape, got {sorted(shapes)} in {path}")
            data = _unpacked(path, series)
            axes = series.axes
    except BadInput:
        raise
    except tifffile.TiffFileError:
        raise BadInput(f"a .tif file must be a TIFF picture, got something else in {path}") from None
    except Exception as error:
        raise BadInput(f"a TIFF file must be whole and readable, got {path}: {_one_line(error)}") from None
    finally:
        logger.disabled = silent
    if "S" in axes and not axes.endswith("S"):
        place = axes.index("S")
        data, axes = np.moveaxis(data, place, -1), axes.replace("S", "") + "S"
    if data.ndim < 2:
        raise BadInput(f"a TIFF file must hold pictures of rows and columns, got the shape {data.shape} in {path}")
    return data.astype(data.dtype.newbyteorder("="), copy=False), axes


def _unpacked(path: Path, series) -> NDArray:
    """Return the pixels of a series; OpenCV unpacks LZW, which it writes by default, where no codec is here."""
    try:
        return series.asarray()
    except ValueError as error:
        if "imagecodecs" not in str(error):
            raise
    import cv2

    packing = series.keyframe.compression
    lzw = getattr(packing, "name", packing) == "LZW" and series.axes.endswith(("YX", "YXS"))
    read, pages = cv2.imreadmulti(str(path), flags=cv2.IMREAD_UNCHANGED) if lzw else (False, ())
    data = np.array(pages)
    if not read or data.size != series.size or data.dtype != series.dtype:
        raise BadInput(f"a TIFF file must be plain, deflated or packed by LZW, got {packing!s} in {path}")
    if series.axes.endswith("S"):
        # OpenCV hands over blue first.
        data = np.concatenate([data[..., 2::-1], data[..., 3:]], axis=-1)
    return data.reshape(series.shape)


def _check_whole(file, path: Path) -> None:
    """Refuse a file that ends before its last strip: the decoder would fill the rest in silence."""
    if not file.pages:
        raise BadInput(f"a TIFF file must hold at least one page, got none in {path}")
    size = path.stat().st_size
    for page in file.pages:
        page = page.aspage()
        end = max((o + n for o, n in zip(page.dataoffsets, page.databytecounts, strict=True)), default=0)
        if end > size:
            raise BadInput(f"a TIFF file must be whole, got {path} of {size} bytes where its pixels end at {end}")


def _check_possible(file, path: Path) -> None:
    """Refuse pages of more pixels than the file can hold; strips and tiles are unpacked whole, however few are used."""
    stated = 0
    for page in file.pages:
        page = page.aspage()
        segment = math.prod(page.chunks or (0,)) * page.dtype.itemsize if page.dtype else 0
        stated += max(page.nbytes, segment)
    require_possible(stated, path.stat().st_size, path.name)


def _check_meaning(file, path: Path) -> None:
    """Refuse pixels that are no measure of light: indices of a palette, or counts that fall with light."""
    photometric = getattr(file.pages[0].photometric, "name", "")
    if photometric in ("PALETTE", "MINISWHITE"):
        raise BadInput(f"the pixels of a TIFF file must rise with light, got the type {photometric} in {path}")


def _one_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
