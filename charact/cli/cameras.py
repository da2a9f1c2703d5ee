"""The camera that a plan's wires name: through Aravis, through the kernel's video interface, or a recorded session."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

from charact.cli.output import print_message
from labdata.errors import BadInput

if TYPE_CHECKING:
    from drivers.interface import Camera


def camera_named(name: str | None, *, tell: Callable[[str], None] = print_message) -> "AbstractContextManager[Camera]":
    """Return the camera of a name, not yet open.

    Parameters
    ----------
    name
        "v4l2:/dev/video0", "v4l2:/dev/video0#1" (input 1 of a capture card); "replay:FOLDER" (each capture plays the
        session's next stack), "replay:FOLDER#LABEL" (every capture plays that stack); anything else is an Aravis
        identifier or an IP address. None: the only camera that Aravis finds.
    tell
        Told, in a sentence, what takes long or is lacking.

    Raises
    ------
    BadInput
        If the name lacks its file or folder, or its input is no number.
    """
    kind, colon, rest = (name or "").partition(":")
    if not colon or kind not in ("v4l2", "replay"):
        from drivers.cameras.aravis.camera import AravisCamera

        return AravisCamera(name, say=tell)
    place, _, part = rest.partition("#")
    if not place:
        raise BadInput(f"a camera {kind}: must name its {'file' if kind == 'v4l2' else 'folder'}, got {name!r}")
    if kind == "replay":
        from drivers.cameras.replay import ReplayCamera

        return ReplayCamera(place, label=part or None, say=tell)
    from drivers.cameras.v4l2 import V4l2Camera

    if part and not part.isdigit():
        raise BadInput(f"the input of a capture card must be a whole number, got {part!r} in {name!r}")
    return V4l2Camera(place, input_number=int(part) if part else None)
