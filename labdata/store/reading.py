"""Reading the store: the acknowledged frames of an array, compared with what was acknowledged."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.store.journal import Acknowledged, journal, sha256


def read(path: str | Path, *, verify: bool = True) -> FrameStack:
    """Read the acknowledged frames of an array.

    Parameters
    ----------
    path
        The array's folder.
    verify
        Compare each frame with its SHA-256.

    Raises
    ------
    BadInput
        If no frame was acknowledged, or one is not what was acknowledged.
    """
    path = Path(path)
    frames = journal(path)
    if not frames:
        raise BadInput(f"a stack must hold at least one frame, got none in {path}")
    data = _pixels(path, opened(path), 0, len(frames))
    if len(data) < len(frames):
        raise BadInput(f"{path} must hold the {len(frames)} frames of its journal, got {len(data)}")
    if verify:
        _check(path, data, frames)
    return FrameStack(
        data=data,
        time_s=np.array([frame.time_s for frame in frames]),
        frame_number=np.array([frame.frame_number for frame in frames], np.int64),
    )


def lazy(path: str | Path) -> Any:
    """Return the Zarr array itself, unread, with the number of its acknowledged frames."""
    return opened(Path(path)), len(journal(path))


def block(path: Path, array: Any, acknowledged: tuple[Acknowledged, ...]) -> NDArray:
    """Read some frames that follow one another of an array opened by `lazy`; altered or missing ones are a BadInput."""
    data = _pixels(path, array, acknowledged[0].index, acknowledged[-1].index + 1)
    if len(data) < len(acknowledged):
        raise BadInput(f"{path} must hold the frames of its journal, got none from frame {acknowledged[0].index} on")
    _check(path, data, acknowledged)
    return data


def _pixels(path: Path, array: Any, first: int, last: int) -> NDArray:
    """Read frames first..last-1; files of other sizes than the array's description states are a BadInput."""
    try:
        return array[first:last]
    except Exception:  # decoding fails in as many ways as there are codecs
        raise BadInput(f"the frames {first} to {last - 1} of {path} must be as it describes them, got others") from None


def _check(path: Path, data: NDArray, frames: tuple[Acknowledged, ...]) -> None:
    for entry in frames:
        if sha256(data[entry.index - frames[0].index]) != entry.sha256:
            raise BadInput(
                f"every frame must be what was acknowledged, got other pixels in frame {entry.index} of {path}"
            )


def opened(path: Path) -> Any:
    """Return the Zarr array itself, as large as it is now."""
    import zarr

    try:
        return zarr.open_array(path, mode="r")
    except Exception:
        raise BadInput(f"a stack of the store must be a readable Zarr array, got {path}") from None
