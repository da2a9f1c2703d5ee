"""Opening of a stack whose frames are read on demand, so that it may be larger than memory."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.file_io import require_regular, require_regular_parts
from labdata.frames import LazyStack
from labdata.session import StackEntry
from labdata.store import is_ours, read_journal
from labdata.store.array_reader import open_array, read_frames


def open_lazy_stack(entry: StackEntry) -> LazyStack:
    """Open a stack: a Zarr array or .npy file lazily, any other file or plane read completely; then
    apply its view.
    """
    stack = _as_they_are(entry)
    return stack if entry.view is None else entry.view.through(stack)


def _as_they_are(entry: StackEntry) -> LazyStack:
    """Return the frames of a stack without its view."""
    from labdata.file_io import require_picture
    from labdata.importers.axes import FRAME, UNNAMED, names_of_shape

    path = entry.paths[0] if isinstance(entry.frames, str) else None
    chosen = entry.plane is not None or entry.extension is not None
    if path is not None and is_ours(path) and not chosen:
        return _of_store(entry, path)
    plain = not chosen and entry.axis in (None, FRAME)
    array = _map_array(path) if plain and path is not None else None
    if (
        array is not None
        and array.ndim == 3
        and names_of_shape(array.shape)[0] in (FRAME, UNNAMED)
        and (array.dtype.kind in "uif" and array.size and array.dtype.isnative)
    ):
        require_picture(array.shape[1], array.shape[2], entry.label)
        return _lazy_stack(entry, array, lambda first, last: np.asarray(array[first:last]))
    return LazyStack.of(entry.read_files(), entry.label)


def _of_store(entry: StackEntry, path: Path) -> LazyStack:
    journal = read_journal(path)
    journal.require_frames()
    array, frames = open_array(path), journal.frames
    stamps = {
        "time_s": np.array([frame.time_s for frame in frames]),
        "frame_number": np.array([frame.frame_number for frame in frames], np.int64),
    }
    stack = _lazy_stack(
        entry, array, lambda first, last: read_frames(path, array, frames[first:last]), **stamps
    )
    return replace(stack, shape=(len(frames), *stack.shape[1:]))


def _lazy_stack(
    entry: StackEntry, array, block: Callable[[int, int], NDArray], **stamps: NDArray
) -> LazyStack:
    stated = None if entry.bit_depth is None else float(2**entry.bit_depth - 1)
    return LazyStack(
        label=entry.label,
        shape=tuple(array.shape),
        dtype=np.dtype(array.dtype),
        time_s=stamps.get("time_s", np.empty(0)),
        frame_number=stamps.get("frame_number", np.empty(0, np.int64)),
        full_scale_dn=255.0 if stated is None and array.dtype == np.uint8 else stated,
        block=lambda first, last: _require_valid(entry, block(first, last)),
    )


def _require_valid(entry: StackEntry, data: NDArray) -> NDArray:
    """Return frames whose pixels are finite and within full scale."""
    if data.dtype.kind == "f" and not np.isfinite(data).all():
        bad = int(data.size - np.count_nonzero(np.isfinite(data)))
        raise BadInput(
            f"every pixel must be finite, got {bad} that are NaN or infinite in stack "
            f"{entry.label!r}"
        )
    if entry.bit_depth is not None and data.max() > 2**entry.bit_depth - 1:
        raise BadInput(
            f"pixels must not exceed the {2**entry.bit_depth - 1} DN of {entry.bit_depth} bits, "
            f"got {data.max()} in stack {entry.label!r}"
        )
    return data


def _map_array(path: Path):
    """Return the unread array of a Zarr folder or a .npy file; None for anything else."""
    try:
        if (path / "zarr.json").is_file():
            import zarr

            require_regular_parts(path, "a Zarr array")
            return zarr.open_array(path, mode="r")
        require_regular(path)
        return (
            np.load(path, mmap_mode="r", allow_pickle=False)
            if path.suffix.lower() == ".npy"
            else None
        )
    except (OSError, ValueError, EOFError):  # BadInput too: the reader reports it
        return None
