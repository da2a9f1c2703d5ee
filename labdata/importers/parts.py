"""Choice of one picture or array of a file that holds several, and of what remains of a file."""

from collections.abc import Sequence
from dataclasses import dataclass

from labdata.errors import BadInput
from labdata.importers.thresholds import MOST_NAMED


@dataclass(frozen=True)
class Part:
    """One picture or array of a file: an image of FITS, a series of TIFF, an array of HDF5, a
    section of SIF.
    """

    number: int  #: Number in the file, as the documentation of its kind counts
    name: str  #: Its name; "" without one
    shape: Sequence[int]  #: Its length along each axis

    def __str__(self) -> str:
        size = " x ".join(str(length) for length in self.shape)
        return f"{self.number} {self.name}".rstrip() + f" ({size})"


def choose(
    parts: Sequence[Part], extension: str | None, default: int, rule: str
) -> tuple[int, tuple[str, ...]]:
    """Return the index of the chosen part, and a note where there are several.

    Parameters
    ----------
    extension
        Number or name, without regard to case; the last word of a path suffices. None: `default`.
    default, rule
        Index of the part that is read without a choice, and how it was found: "the first".

    Raises
    ------
    BadInput
        If no part, or several, have the name; the message lists all.
    """
    listed = ", ".join(str(part) for part in parts[:MOST_NAMED])
    if len(parts) > MOST_NAMED:
        listed += f" and {len(parts) - MOST_NAMED} more"
    if extension is None:
        if len(parts) == 1:
            return 0, ()
        return default, (
            f"{parts[default]} was read, {rule} of {len(parts)} pictures in the file: {listed}; "
            "`extension` chooses another",
        )
    word = extension.strip().strip("/").lower()
    paths = [part.name.strip("/").lower() for part in parts]
    # A whole name precedes the last word of a path, and both a number
    for names in (paths, [path.split("/")[-1] for path in paths], [str(p.number) for p in parts]):
        if names.count(word) == 1:
            at = names.index(word)
            chosen = f"{parts[at]} was read of {len(parts)} pictures in the file"
            return at, (chosen,) if len(parts) > 1 else ()
    several = ", which several have: choose by number" if word in paths else ""
    raise BadInput(f"`extension` must be one of {listed}, got {extension!r}{several}")


def whole_frames(
    name: str, *, frames: int, start: int, stride: int, frame_bytes: int, size: int, partial: bool
) -> tuple[int, tuple[str, ...]]:
    """Return the number of frames to read of a file of `size` bytes, and a note on missing ones.

    Parameters
    ----------
    frames, start, stride, frame_bytes
        Frames that the header states, position of the first, and bytes from one to the next and of
        the pixels of each.
    partial
        Whether to read what is there; else a file that ends early is BadInput.
    """
    if frames < 1 or frame_bytes < 1 or stride < frame_bytes:
        raise BadInput(
            f"a header must state frames that can be, got {frames} frames of {frame_bytes} bytes, "
            f"{stride} apart, in {name}"
        )
    if start + (frames - 1) * stride + frame_bytes <= size:
        return frames, ()
    readable = max(0, (size - start - frame_bytes) // stride + 1)
    if partial and readable:
        return readable, (
            f"the file ends early: the {readable} whole frames of {frames} were read",
        )
    remedy = f": `partial` reads the {readable} that are whole" if readable else ""
    raise BadInput(
        f"a file must be whole, got {name} of fewer bytes than its {frames} frames{remedy}"
    )
