"""Frame stacks, in memory or read on demand: pixels (frame, row, col), time stamps and gaps."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.short_repr import short_repr

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
BLOCK_BYTES = 2**26  # Bytes of frames processed in one block
# Largest magnitude of a pixel: up to here doubles count whole numbers, and squares are finite.
LARGEST_PIXEL = 2.0**53


def read_only(array: NDArray) -> NDArray:
    """Return a view of the array that cannot be written through."""
    view = array.view()
    view.flags.writeable = False
    return view


def blocks(data: NDArray) -> Iterator[NDArray]:
    """Yield blocks of at most 64 MB of frames, so that an array on the disk need not fit into
    memory.
    """
    frame_bytes = max(1, data[:1].nbytes)
    run = max(1, BLOCK_BYTES // frame_bytes)
    for first in range(0, len(data), run):
        yield data[first : first + run]


@dataclass(frozen=True, kw_only=True)
class FrameStack:
    """A stack of frames taken under one set of conditions; empty ones, or pixels that are not
    finite, are BadInput.
    """

    #: Pixel values, shape (frame, row, col), DN (or another unit, see `unit`). Made read-only
    data: NDArray
    unit: str = "DN"  #: Unit of the pixel values
    #: Time stamp of each frame, shape (frame,), s; empty if unknown
    time_s: NDArray = field(default_factory=lambda: np.empty(0))
    #: The camera's own number of each frame, shape (frame,); empty if unknown
    frame_number: NDArray = field(default_factory=lambda: np.empty(0, np.int64))
    lost_frames: int = 0  #: Frames numbered by the camera that never arrived
    #: Black level recorded with the frames, DN; None if unknown. Never subtracted on reading
    black_level_dn: float | None = None
    full_scale_dn: float | None = None  #: Full scale of the digitiser, DN; None if unknown
    #: Colour plane of a mosaic ("r", "g1", "g2", "b") or of an RGB image ("r", "g", "b",
    #: "luminance"), or "mono"
    plane: str = "mono"
    #: Distance of neighbouring samples in pixels of the camera: 2 in a plane of a mosaic
    sample_pitch_px: int = 1
    notes: tuple[str, ...] = ()  #: Remarks on how the frames were read
    #: First row and column in the file: a non-finite border is cut off
    origin: tuple[int, int] = 0, 0

    __repr__ = short_repr

    def __post_init__(self) -> None:
        data = np.asarray(self.data)
        if data.ndim != 3:
            raise BadInput(
                f"a frame stack must have the axes (frame, row, col), got shape {data.shape}"
            )
        if data.size == 0:
            raise BadInput(f"a frame stack must hold at least one pixel, got shape {data.shape}")
        if data.dtype.kind == "f" and (
            bad := sum(int(np.count_nonzero(~(np.abs(b) < LARGEST_PIXEL))) for b in blocks(data))
        ):
            raise BadInput(
                f"every pixel must be finite and below {LARGEST_PIXEL:.1e}, got {bad} of "
                f"{data.size} that are NaN, infinite or larger: scale the frames to DN"
            )
        if data.dtype.kind not in "uif":
            raise BadInput(f"pixels must be whole or real numbers, got the type {data.dtype}")
        object.__setattr__(self, "data", read_only(data))
        for name in ("time_s", "frame_number"):
            stamps = np.asarray(getattr(self, name))
            if stamps.shape not in ((0,), (len(data),)):
                raise BadInput(
                    f"{name} must be empty or one for each of {len(data)} frames, got shape "
                    f"{stamps.shape}"
                )
            object.__setattr__(self, name, read_only(stamps))

    def __len__(self) -> int:
        return self.data.shape[0]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Frames, rows and columns."""
        frames, rows, cols = self.data.shape
        return frames, rows, cols

    @property
    def mean_dn(self) -> float:
        """Mean of all pixels of all frames, in the stack's unit."""
        return float(self.data.mean(dtype=np.float64))

    def frames(self, first: int, last: int) -> NDArray:
        """Return the pixels of the frames first..last-1."""
        return self.data[first:last]

    def region(self, row: int, col: int, height: int, width: int) -> "FrameStack":
        """Return the frames cut to a rectangle; one that leaves the image is a BadInput."""
        _, rows, cols = self.shape
        inside = (
            row >= 0
            and col >= 0
            and height > 0
            and width > 0
            and row + height <= rows
            and col + width <= cols
        )
        if not inside:
            raise BadInput(
                f"a region ROW,COL,HEIGHT,WIDTH must lie inside the image of {rows} rows and "
                f"{cols} columns, got {row},{col},{height},{width}"
            )
        first = self.origin[0] + row, self.origin[1] + col
        return replace(self, data=self.data[:, row : row + height, col : col + width], origin=first)


def concatenated(parts: list[FrameStack], label: str) -> FrameStack:
    """Return the stacks of several files as one stack."""
    first = parts[0]
    if len(parts) == 1:
        return first
    if shapes := {part.shape[1:] for part in parts} - {first.shape[1:]}:
        raise BadInput(
            f"all files of a stack must have one picture size, got {first.shape[1:]} and "
            f"{min(shapes)} in {label!r}"
        )
    return replace(
        first,
        data=np.concatenate([part.data for part in parts]),
        time_s=_all_or_none([part.time_s for part in parts], parts),
        frame_number=_all_or_none([part.frame_number for part in parts], parts),
        lost_frames=sum(part.lost_frames for part in parts),
        full_scale_dn=max(
            (known for part in parts if (known := part.full_scale_dn) is not None), default=None
        ),
        notes=tuple(dict.fromkeys(note for part in parts for note in part.notes)),
    )


def _all_or_none(arrays: list[NDArray], parts: list[FrameStack]) -> NDArray:
    complete = all(len(array) == len(part) for array, part in zip(arrays, parts, strict=True))
    return np.concatenate(arrays) if complete else arrays[0][:0]


@dataclass(frozen=True, kw_only=True)
class LazyStack:
    """Frames that are read on demand."""

    label: str  #: As in the session
    shape: tuple[int, int, int]  #: Frames, rows and columns
    dtype: np.dtype  #: Type of the pixels
    time_s: NDArray  #: As in `FrameStack`
    frame_number: NDArray  #: As in `FrameStack`
    #: Full scale where it is stated, DN; None where only the frames could show it
    full_scale_dn: float | None
    block: Callable[
        [int, int], NDArray
    ]  #: Returns the frames first..last-1, shape (frame, row, col)

    @classmethod
    def of(cls, stack: FrameStack, label: str) -> "LazyStack":
        """Return the frames of a stack in memory."""
        return cls(
            label=label,
            shape=stack.shape,
            dtype=stack.data.dtype,
            time_s=stack.time_s,
            frame_number=stack.frame_number,
            full_scale_dn=stack.full_scale_dn,
            block=stack.frames,
        )

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def size_bytes(self) -> int:
        """Bytes that all frames take."""
        return int(np.prod(self.shape)) * self.dtype.itemsize

    def frames(self, first: int, last: int) -> NDArray:
        """Read the frames first..last-1; an invalid pixel, or a frame that differs from its digest,
        is BadInput.
        """
        return self.block(first, last)

    def in_memory(self) -> "LazyStack":
        """Return a copy with all frames in memory."""
        data = self.frames(0, len(self))
        return replace(self, block=lambda first, last: data[first:last])


class View(Protocol):
    """Transformation of the frames of a stack on reading: scaled, or with pixels replaced."""

    def through(self, stack: LazyStack) -> LazyStack:
        """Return the transformed stack."""
        ...
