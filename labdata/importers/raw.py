"""Camera raw and DNG: the active area of the mosaic, its colour planes kept apart, never demosaiced."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.frames import FrameStack


def read(path: Path, plane: str | None = None) -> FrameStack:
    """Read one colour plane of a raw picture; see `labdata.importers.read_frames`.

    Notes
    -----
    A plane of a 2x2 mosaic has half the rows and columns of the sensor, so its column pitch is two of the sensor's.
    The black level is recorded, not subtracted.
    """
    import rawpy

    try:
        with rawpy.imread(str(path)) as raw:
            return _plane(raw, plane, path)
    except (rawpy.LibRawError, NotImplementedError) as error:  # the latter of a mosaic that is told by no pattern
        reason = error.args[0] if error.args else "unknown"
        reason = reason.decode(errors="replace") if isinstance(reason, bytes) else reason
        raise BadInput(f"a raw file must be whole and of a known camera, got {path}: {reason}") from None


def _plane(raw, plane: str | None, path: Path) -> FrameStack:
    if raw.raw_image.ndim != 2:
        raise BadInput(f"a raw file must hold a mosaic or one plane, got {raw.raw_image.shape} in {path}")
    white = float(raw.white_level) if raw.white_level else None
    pattern = raw.raw_pattern
    if pattern is None:
        if plane not in (None, "mono"):
            raise BadInput(f"a plane can only be taken of a colour mosaic, got plane {plane!r} of {path.name}")
        return _stack(raw.raw_image_visible, raw, 0, "mono", white)
    sites = planes_of(pattern, raw.color_desc.decode())
    if plane not in sites:
        raise BadInput(f"the plane of this mosaic must be one of {', '.join(sites)}, got {plane} for {path.name}")
    row, col = sites[plane]
    height, width = pattern.shape
    visible = raw.raw_image_visible[row::height, col::width]
    return _stack(visible, raw, int(pattern[row, col]), plane, white)


def planes_of(pattern: NDArray, description: str) -> dict[str, tuple[int, int]]:
    """Return the planes of a mosaic by name with the row and column of each in the pattern."""
    if pattern.shape != (2, 2):
        raise BadInput(f"the mosaic of a raw file must repeat every 2x2 pixels, got {pattern.shape}")
    names = [description[index].lower() for index in pattern.ravel()]
    sites: dict[str, tuple[int, int]] = {}
    for place, name in enumerate(names):
        several = names.count(name) > 1
        full = f"{name}{names[:place].count(name) + 1}" if several else name
        sites[full] = divmod(place, 2)
    return dict(sorted(sites.items()))


def _stack(data: NDArray, raw, color: int, plane: str, white: float | None) -> FrameStack:
    return FrameStack(
        data=np.array(data)[None],
        plane=plane,
        black_level_dn=float(raw.black_level_per_channel[color]),
        full_scale_dn=white,
        notes=("camera raw: active area, one colour plane, black level recorded and not subtracted",),
    )
