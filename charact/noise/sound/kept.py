"""Frames retained in memory between survey and measurement."""

from dataclasses import dataclass, fields

from charact.noise.stack.parallel_reading import WHOLE_BYTES
from labdata.frames import FrameStack
from labdata.session import StackEntry

# Files and folders that are memory-mapped.
MAPPED = (".npy", ".zarr")


@dataclass(frozen=True, kw_only=True)
class LoadedStackEntry(StackEntry):
    """A stack with its frames in memory.

    Parameters
    ----------
    kept
        The frames.
    """

    kept: FrameStack

    def read(self, plane: str | None = None) -> FrameStack:
        """Return the frames; `plane` has no effect."""
        return self.kept


def load_frames(entries: tuple[StackEntry, ...]) -> tuple[StackEntry, ...]:
    """Return darks and flats with their frames in memory, up to `WHOLE_BYTES`."""
    left, out = WHOLE_BYTES, []
    for entry in entries:
        plain = type(entry) is StackEntry and entry.kind in ("dark", "flat")
        paths = entry.paths if plain else ()
        if not paths or any(path.suffix in MAPPED or path.is_dir() or path.stat().st_size > left for path in paths):
            out.append(entry)
            continue
        frames = entry.read()
        left -= frames.data.nbytes
        whole = {item.name: getattr(entry, item.name) for item in fields(StackEntry)}
        out.append(LoadedStackEntry(**whole, kept=frames) if left >= 0 else entry)
    return tuple(out)
