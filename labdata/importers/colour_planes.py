"""Colour planes of an RGB image or of a mosaic."""

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.importers.thresholds import MOSAIC_LEVEL, MOSAIC_SIGNIFICANCE

LUMINANCE_NOTE = "colour picture: the luminance 0.2125 R + 0.7154 G + 0.0721 B was taken"
PLANE_NOTE = (
    "one plane of a mosaic: lengths and frequencies count its samples, which lie two pixels of "
    "the camera apart; its pitch is twice that of the pixels"
)
SITES = ("r", "g1", "g2", "b")


def require_monochrome(
    data: NDArray,
    plane: str | None,
    name: str,
    pattern: str | None = None,
    origin: tuple[int, int] = (0, 0),
) -> FrameStack:
    """Return frames of one sample per pixel, shape (frame, row, col), or one plane of a mosaic.

    `pattern` is the file's; `plane` may state one before its name, "rggb:g1". With neither the
    mosaic is detected from the data. `origin`: row and column of the pattern at which the data
    begin.
    """
    stated, _, plane = (plane or "").rpartition(":")
    if stated and pattern not in (None, stated):
        raise BadInput(
            f"the mosaic of {name} is {pattern} by the file itself, got the plane {stated}:{plane}"
        )
    if pattern := pattern or stated:
        row, col = site_of(pattern, plane or None, name)
        return _of_mosaic(data, plane, ((row - origin[0]) % 2, (col - origin[1]) % 2))
    greens = green_diagonal(data)
    if plane in SITES:
        if greens is None:
            raise BadInput(
                f"a plane can only be taken of a colour picture or a mosaic, got plane {plane!r} "
                f"of {name}; a mosaic that does not show is stated with the colours of its first "
                f"2x2 pixels, `plane` rggb:{plane}"
            )
        return _of_mosaic(
            data,
            plane,
            site_of(("grbg", "rggb")[greens], plane, name),
            (
                "the greens of the mosaic are those of its alike diagonal; red is taken to lie in "
                "its first row, which the file does not say",
            ),
        )
    if plane not in ("", "mono"):
        raise BadInput(
            f"a plane can only be taken of a colour picture or a mosaic, got plane {plane!r} of "
            f"{name}"
        )
    notes = (
        ()
        if greens is None
        else (
            "the pixels alternate in a 2x2 pattern like a colour mosaic that was taken for grey: "
            "`plane` r, g1, g2 or b measures one colour; its frequencies count its own pixels, "
            "which are twice as wide",
        )
    )
    return FrameStack(data=data, notes=notes)


def _of_mosaic(
    data: NDArray, plane: str, site: tuple[int, int], notes: tuple[str, ...] = ()
) -> FrameStack:
    """Return every second row and column from a site on."""
    row, col = site
    return FrameStack(
        data=data[:, row::2, col::2], plane=plane, sample_pitch_px=2, notes=(PLANE_NOTE, *notes)
    )


def site_of(pattern: str, plane: str | None, name: str) -> tuple[int, int]:
    """Return the row and column of a plane in a mosaic's first 2x2 pixels; a mosaic needs a
    plane.
    """
    sites = planes_of(pattern)
    if plane not in sites:
        raise BadInput(
            f"the plane of this mosaic must be one of {', '.join(sites)}, got {plane} for {name}"
        )
    return sites[plane]


def planes_of(pattern: str) -> dict[str, tuple[int, int]]:
    """Return the planes of a mosaic by name with the row and column of each in its first 2x2
    pixels.
    """
    if not (len(pattern) == 4 and pattern.isalpha() and pattern.islower()):
        raise BadInput(
            f"a mosaic must be stated by the colours of its first 2x2 pixels, as rggb, got "
            f"{pattern!r}"
        )
    sites: dict[str, tuple[int, int]] = {}
    for index, name in enumerate(pattern):
        full = f"{name}{pattern[:index].count(name) + 1}" if pattern.count(name) > 1 else name
        sites[full] = divmod(index, 2)
    return dict(sorted(sites.items()))


def green_diagonal(data: NDArray) -> int | None:
    """Return the diagonal of the green sites of a mosaic: 0 main, 1 other; None if there is no
    mosaic.

    Notes
    -----
    The checkerboard amplitude (p00 + p11 - p01 - p10) / 4 of the brighter half of all 2x2 cells is
    compared with its standard error over the cells and with the mean signal. Row and column gains,
    as of two taps or two fields, do not contribute. The green sites are the diagonal with the
    smaller difference.
    """
    if min(data.shape[1:]) < 16:
        return None
    some = data[:: max(1, len(data) // 4)][:4]
    picture = some.mean(axis=0, dtype=np.float64) if len(some) > 1 else some[0].astype(np.float64)
    rows, cols = (size // 2 * 2 for size in picture.shape)
    planes = [picture[row:rows:2, col:cols:2] for row in (0, 1) for col in (0, 1)]
    main, other = planes[0] + planes[3], planes[1] + planes[2]
    level = main + other
    half = level.size // 2
    chosen = level >= np.partition(level, half, axis=None)[half]
    board = 0.25 * (main - other)[chosen]
    if board.size < 64:
        return None
    middle = float(np.median(board))
    spread = 1.4826 * float(np.median(np.abs(board - middle)))
    if abs(middle) <= MOSAIC_SIGNIFICANCE * 1.2533 * spread / np.sqrt(board.size):
        return None
    bright = np.array([plane[chosen] for plane in planes])
    if abs(middle) <= MOSAIC_LEVEL * abs(float(np.median(bright))):
        return None
    sites = np.median(bright, axis=1)
    return 0 if abs(sites[0] - sites[3]) < abs(sites[1] - sites[2]) else 1


def select_plane(data: NDArray, plane: str | None, name: str) -> FrameStack:
    """Return one plane, or the luminance, of colour frames of the shape (frame, row, col, 3 or
    4).
    """
    if plane in (None, "luminance"):
        # Weights of red, green and blue in luminance (ISO 12233)
        luminance = data[..., :3].astype(np.float64) @ np.asarray((0.2125, 0.7154, 0.0721))
        # The mean of 8-bit planes has their full scale; the bits used in wider planes are unknown.
        full_scale_dn = 255.0 if data.dtype == np.uint8 else None
        return FrameStack(
            data=luminance, full_scale_dn=full_scale_dn, plane="luminance", notes=(LUMINANCE_NOTE,)
        )
    if plane not in ("r", "g", "b", "0", "1", "2"):
        raise BadInput(
            f"the plane of an RGB picture must be r, g, b or luminance, got {plane!r} for {name}"
        )
    at = int(plane) if plane.isdecimal() else "rgb".index(plane)
    return FrameStack(data=data[..., at], plane="rgb"[at])
