"""Camera raw and DNG: the active area of the mosaic, its colour planes kept apart, never demosaiced."""

from pathlib import Path

import numpy as np

from labdata.errors import BadInput
from labdata.importers.axes import COL, ROW
from labdata.importers.decompression_limit import require_picture, require_room
from labdata.importers.recorded import Recorded

NOTE = "camera raw: active area, one colour plane, black level recorded and not subtracted"


def read(path: Path) -> Recorded:
    """Read the mosaic of a raw picture; see `labdata.importers.read_frames`.

    Notes
    -----
    A plane of a 2x2 mosaic has half the rows and columns of the sensor, so its column pitch is two of the sensor's.
    The black level is recorded, not subtracted.
    """
    import rawpy

    try:
        with rawpy.RawPy() as raw:
            raw.open_file(str(path))
            require_picture(raw.sizes.raw_height, raw.sizes.raw_width, path.name)
            require_room(path, pixels=raw.sizes.raw_height * raw.sizes.raw_width, pixel_bytes=2)
            raw.unpack()
            return _mosaic(raw, path)
    except (rawpy.LibRawError, NotImplementedError) as error:  # the latter of a mosaic that is told by no pattern
        reason = error.args[0] if error.args else "unknown"
        reason = reason.decode(errors="replace") if isinstance(reason, bytes) else reason
        raise BadInput(f"a raw file must be whole and of a known camera, got {path}: {reason}") from None


def _mosaic(raw, path: Path) -> Recorded:
    if raw.raw_image.ndim != 2:
        raise BadInput(f"a raw file must hold a mosaic or one plane, got {raw.raw_image.shape} in {path}")
    sites = raw.raw_pattern
    if sites is not None and sites.shape != (2, 2):
        raise BadInput(f"the mosaic of a raw file must repeat every 2x2 pixels, got {sites.shape} in {path}")
    colours = [0] if sites is None else sites.ravel().tolist()
    description = raw.color_desc.decode().lower()
    return Recorded(
        data=np.array(raw.raw_image_visible),
        names=(ROW, COL),
        pattern=None if sites is None else "".join(description[colour] for colour in colours),
        black_dn=tuple(float(raw.black_level_per_channel[colour]) for colour in colours),
        full_scale_dn=float(raw.white_level) if raw.white_level else None,
        notes=(NOTE,),
    )
