"""What a reader finds in a file: pixels as they are stored, and what the file says of their axes and colours."""

from collections.abc import Sequence
from dataclasses import dataclass

from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """Pixels of a file before axes and planes are chosen.

    Parameters
    ----------
    data
        Pixels, any number of axes.
    names
        What each axis counts, see `labdata.importers.axes`.
    pattern
        Colours of a mosaic's 2x2 sites in reading order, such as "rggb"; None: no mosaic is stated.
    black_dn
        Black level, DN: one of all pixels, or one of each site of the mosaic in reading order; empty: unknown.
    full_scale_dn
        Highest code, DN; None: not stated.
    notes
        What a reader should know of how the pixels were stored.
    doubts
        What a reader should know of the axes, unless the one of frames is chosen.
    """

    data: NDArray
    names: Sequence[str]
    pattern: str | None = None
    black_dn: tuple[float, ...] = ()
    full_scale_dn: float | None = None
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


def lossy_note(how: str) -> str:
    """Return the note of a lossy compression."""
    return f"{how} compression is lossy: it alters fine detail and noise, so MTF, noise and their intervals may be off"
