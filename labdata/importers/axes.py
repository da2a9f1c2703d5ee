"""Axes of image arrays, non-finite borders, and the record of a reader.

An axis counts frames if the file or the documented layout of its kind states it. Any other axis
longer than 1 is cut by a plane, renamed by the caller, or refused.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.file_io import require_picture
from labdata.frames import FrameStack, blocks
from labdata.importers import colour_planes
from labdata.importers.thresholds import LEAST_COLOUR_SIDE_PX, MOST_MASKED, MOST_OBLONG


def without_gaps(data: NDArray, name: str) -> tuple[NDArray, tuple[int, int], tuple[str, ...]]:
    """Return frames, shape (frame, row, col, ...), of finite pixels, their first row and column in
    the file, and notes.

    More than 0.5 % of non-finite pixels inside the border are BadInput.
    """
    if data.dtype.kind != "f":
        return data, (0, 0), ()
    gaps = np.zeros(data.shape[1:3], bool)
    for block in blocks(data):
        gaps |= ~np.isfinite(block).all(axis=(0, *range(3, data.ndim)))
    if not gaps.any():
        return data, (0, 0), ()
    first_row, end_row, first_col, end_col = _inside(_gaps_at_border(gaps))
    rows, cols = data.shape[1:3]
    notes = []
    if end_row - first_row < rows or end_col - first_col < cols:
        notes.append(
            f"a border that is not finite was cut off: rows {first_row} to {end_row - 1} of {rows} "
            f"and columns {first_col} to {end_col - 1} of {cols} are measured; regions count "
            "from the file's first row and column"
        )
    data, gaps = (
        data[:, first_row:end_row, first_col:end_col],
        gaps[first_row:end_row, first_col:end_col],
    )
    if not gaps.size:
        raise BadInput("every pixel must be finite, but for a border, got none that is")
    count = int(np.count_nonzero(gaps))
    if count > MOST_MASKED * gaps.size:
        bad = sum(int(np.count_nonzero(~np.isfinite(block))) for block in blocks(data))
        raise BadInput(
            f"every pixel must be finite, but for a border and {100 * MOST_MASKED:g} % inside it, "
            f"got {bad} that are NaN or infinite of {data.size}"
        )
    if count:
        data = _fill_gaps(data, gaps)
        notes.append(
            f"{count} pixels inside the picture are not finite and were filled from their "
            f"neighbours"
        )
    return data, (first_row, first_col), tuple(notes)


def _gaps_at_border(gaps: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the gaps connected to the image border, single pixels excluded."""
    from scipy.ndimage import label

    numbers = np.empty(gaps.shape, np.int32)
    label(gaps, np.ones((3, 3), int), numbers)
    outer = np.unique(np.concatenate([numbers[0], numbers[-1], numbers[:, 0], numbers[:, -1]]))
    sizes = np.bincount(numbers.ravel())
    return np.isin(numbers, outer[(outer > 0) & (sizes[outer] > 1)])


def _inside(gaps: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Return the rows and columns left after border lines with gaps are removed, the worst
    first.
    """
    first_row, first_col = 0, 0
    end_row, end_col = gaps.shape
    while (
        first_row < end_row
        and first_col < end_col
        and (inner := gaps[first_row:end_row, first_col:end_col]).any()
    ):
        lines = (inner[0].mean(), inner[-1].mean(), inner[:, 0].mean(), inner[:, -1].mean())
        worst = int(np.argmax(lines))
        if lines[worst] == 0.0:  # gaps inside, connected to the border only by a removed line
            break
        first_row, end_row = first_row + (worst == 0), end_row - (worst == 1)
        first_col, end_col = first_col + (worst == 2), end_col - (worst == 3)
    return first_row, end_row, first_col, end_col


def _fill_gaps(data: NDArray, gaps: NDArray[np.bool_]) -> NDArray:
    """Return a copy with each gap set to the median of the finite pixels in the smallest window
    around it.
    """
    data = np.array(data)
    rows, cols = gaps.shape
    for row, col in np.argwhere(gaps):
        half_width = 1
        while True:
            where = np.s_[
                max(0, row - half_width) : row + half_width + 1,
                max(0, col - half_width) : col + half_width + 1,
            ]
            if np.count_nonzero(~gaps[where]) >= 4 or half_width > max(rows, cols):
                break
            half_width += 1
        around = data[(slice(None), *where)][:, ~gaps[where]]
        data[:, row, col] = np.median(around, axis=1)
    return data


FRAME, ROW, COL, COLOUR, UNNAMED = "frame", "row", "col", "colour", "unnamed"
KNOWN = (FRAME, ROW, COL, COLOUR)

# Axis by tifffile letter, label of other formats, or word of --axis; any other word is kept
MEANINGS = {
    **dict.fromkeys(("t", "i", "time", "frame", "frames", "page"), FRAME),
    **dict.fromkeys(("y", "row", "rows", "height"), ROW),
    **dict.fromkeys(("x", "col", "cols", "column", "columns", "width"), COL),
    **dict.fromkeys(("s", "colour", "color", "rgb"), COLOUR),
    **dict.fromkeys(("c", "channel", "channels"), "channel"),
    **dict.fromkeys(("z", "focus", "slice", "depth"), "focus"),
    **dict.fromkeys(("w", "wave", "awav", "freq", "velo", "wavelength"), "wavelength"),
    **dict.fromkeys(("p", "position", "scene", "tile"), "position"),
    **dict.fromkeys(("q", "", "unnamed"), UNNAMED),
}


def meaning(word: str) -> str:
    """Return the meaning of an axis from its letter or name in a file."""
    return MEANINGS.get(word.strip().lower(), word.strip().lower())


def axes_of_labels(labels: Sequence[str | None], shape: Sequence[int]) -> tuple[str, ...]:
    """Return the axes of a labelled array; rows and columns are the last two unless labelled
    otherwise.
    """
    if not any(labels):
        return names_of_shape(shape)
    names = [meaning(label or "") for label in labels]
    if ROW not in names and COL not in names and len(names) > 1:
        names[-2:] = ROW, COL
    return tuple(names)


def names_of_shape(shape: Sequence[int]) -> tuple[str, ...]:
    """Return the axes of an array without labels: (row, col), (frame, row, col), colours last.

    Three planes may be colours or frames and stay unnamed, as does a last axis so short that the
    array may be (row, col, frame).
    """
    leading = len(shape) - 2
    if leading > 0 and shape[-1] in (3, 4) and min(shape[-3:-1]) >= LEAST_COLOUR_SIDE_PX:
        outer = names_of_shape((*shape[:-3], *shape[-3:-1]))
        return (*outer, COLOUR)
    if leading == 1 and MOST_OBLONG * shape[2] <= min(shape[:2]):
        return ROW, COL, UNNAMED
    if leading == 1 and shape[0] != 3:
        return FRAME, ROW, COL
    return (UNNAMED,) * leading + (ROW, COL)


def frames_of(
    data: NDArray,
    names: Sequence[str],
    *,
    plane: str | None,
    axis: str | None,
    name: str,
    pattern: str | None = None,
) -> FrameStack:
    """Return an array of images as a stack.

    Parameters
    ----------
    data, names
        Pixels, any number of axes, and what each is: "frame", "row", "col", "colour", "unnamed", or
        another word.
    plane, axis
        As in `labdata.importers.read_frames`; an axis longer than 1 that is neither frames nor
        colours needs a plane.
    pattern
        Colours of a mosaic's 2x2 sites in reading order, such as "rggb"; None: no mosaic.
    """
    if not data.size:
        raise BadInput(f"an array of frames must hold pixels, got the shape {data.shape} in {name}")
    if data.ndim < 2:
        raise BadInput(
            f"an array of frames must have rows and columns, got the shape {data.shape} in {name}"
        )
    names = [
        UNNAMED if what in KNOWN and what in names[:at] else what for at, what in enumerate(names)
    ]
    names = _with_frame_axis(names, data.shape, axis, name)
    if ROW not in names or COL not in names:
        raise BadInput(
            "an array of frames must have rows and columns, got the axes "
            f"{_describe_axes(names, data.shape)} in {name}"
        )
    further_axes = [at for at, what in enumerate(names) if data.shape[at] > 1 and what not in KNOWN]
    if (
        len(further_axes) == 1
        and data.shape[further_axes[0]] in (3, 4)
        and plane in ("r", "g", "b", "luminance")
    ):
        names[further_axes[0]], further_axes = COLOUR, []
    index: list[int | slice] = [
        slice(None) if size > 1 or what in (ROW, COL) else 0
        for size, what in zip(data.shape, names, strict=True)
    ]
    for at, number in zip(
        further_axes, _plane_index(data.shape, names, further_axes, plane, name), strict=True
    ):
        index[at] = number
    kept_axes = [what for what, at in zip(names, index, strict=True) if isinstance(at, slice)]
    data = data[tuple(index)].transpose(
        [kept_axes.index(what) for what in KNOWN if what in kept_axes]
    )
    data = data if FRAME in kept_axes else data[None]
    require_picture(data.shape[1], data.shape[2], name)
    data, origin, notes = without_gaps(data, name)
    if COLOUR in kept_axes and data.shape[-1] >= 3:
        stack = colour_planes.select_plane(data, plane, name)
    else:
        data = data[..., 0] if COLOUR in kept_axes else data
        stack = (
            FrameStack(data=data, plane=f"plane {plane}")
            if further_axes
            else colour_planes.require_monochrome(data, plane, name, pattern, origin)
        )
    return replace(stack, origin=origin, notes=(*notes, *stack.notes))


def _with_frame_axis(
    names: list[str], shape: Sequence[int], axis: str | None, name: str
) -> list[str]:
    """Return the axis names with the requested axis as the frame axis."""
    if axis is None:
        return names
    if axis == FRAME:
        return [FRAME, *names[1:]] if names[0] == UNNAMED and FRAME not in names else names
    at = _index(names, axis)
    if at is None or len(names) < 3:
        raise BadInput(
            f"`axis` must be one of the axes of {name}, {_describe_axes(names, shape)}, got "
            f"{axis!r}"
        )
    names = [UNNAMED if what == FRAME else what for what in names]
    names[at] = FRAME
    unassigned = [where for where, what in enumerate(names) if what not in (FRAME, COLOUR)]
    if len(unassigned) == 2:
        names[unassigned[0]], names[unassigned[1]] = ROW, COL
    return names


def _index(names: list[str], axis: str) -> int | None:
    """Return the index of an axis given by number or name."""
    if axis.isdecimal():
        return int(axis) if int(axis) < len(names) else None
    return names.index(meaning(axis)) if meaning(axis) in names else None


def _plane_index(
    shape: Sequence[int], names: list[str], further_axes: list[int], plane: str | None, name: str
) -> list[int]:
    """Return the plane index along every other axis; BadInput where none was selected."""
    chosen = [] if plane is None else plane.split(",")
    if not further_axes:
        return []
    if len(chosen) == len(further_axes) and all(
        word.isdecimal() and int(word) < shape[at]
        for word, at in zip(chosen, further_axes, strict=True)
    ):
        return [int(word) for word in chosen]
    first = further_axes[0]
    colours = (
        " (or r, g, b, luminance if they are colours)"
        if shape[first] in (3, 4) and len(further_axes) == 1
        else ""
    )
    frames = "" if FRAME in names else f"`axis` {first} takes axis {first} for frames, "
    raise BadInput(
        f"an axis must be known to count frames, got the axes {_describe_axes(names, shape)} in "
        f"{name}: {frames}`plane` {','.join('0' for _ in further_axes)} takes one plane, counted "
        f"from 0{colours}" + ("" if plane is None else f"; got `plane` {plane}")
    )


def _describe_axes(names: Sequence[str], shape: Sequence[int]) -> str:
    """Return the axes as text: (0 unnamed of 16, 1 row of 512, 2 col of 640)."""
    return (
        "("
        + ", ".join(
            f"{at} {what} of {size}"
            for at, (what, size) in enumerate(zip(names, shape, strict=True))
        )
        + ")"
    )


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """Pixels of a file before the choice of axes and plane."""

    data: NDArray  #: Pixels, any number of axes
    names: Sequence[str]  #: Meaning of each axis
    #: Colours of a mosaic's 2x2 sites in reading order, such as "rggb"; None: no mosaic
    pattern: str | None = None
    #: Black level, DN: one value, or one per site of the mosaic in reading order; empty: unknown
    black_dn: tuple[float, ...] = ()
    full_scale_dn: float | None = None  #: Full scale, DN; None: not stated
    notes: tuple[str, ...] = ()  #: Notes on the storage of the pixels
    doubts: tuple[str, ...] = ()  #: Notes on the axes, omitted if the frame axis is selected
    #: Whether the first axis, marked as colours, may count frames for all that the file states
    may_be_frames: bool = False


def lossy_note(how: str) -> str:
    """Return the note of a lossy compression."""
    return (
        f"{how} compression is lossy: it alters fine detail and noise, so MTF, noise and their "
        f"intervals may be off"
    )


def optional_module(name: str, extra: str, path: Path) -> Any:
    """Import the library of an extra; where it is missing, a file that needs it is BadInput."""
    try:
        return import_module(name)
    except ImportError:
        library = name.split(".")[0]
        raise BadInput(
            f"{extra.upper()} files need {library}, got {path.name}: pip install 'charact[{extra}]'"
        ) from None
