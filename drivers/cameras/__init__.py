"""Camera drivers: V4L2, Aravis (GigE Vision, USB3 Vision) and replayed sessions."""

from collections.abc import Callable
from contextlib import AbstractContextManager

from drivers.interface import Camera
from labdata.errors import BadInput


def camera_named(
    name: str | None, *, say: Callable[[str], None] = lambda sentence: None
) -> AbstractContextManager[Camera]:
    """Return the camera of a name, not opened.

    "v4l2:/dev/video0", "v4l2:/dev/video0#1" (input 1 of a capture card); "replay:FOLDER" (each
    capture replays the session's next stack), "replay:FOLDER#LABEL" (every capture replays that
    stack); anything else is an Aravis identifier or an IP address; None: the only camera that
    Aravis lists. `say` is called with a sentence on what the camera awaits.
    """
    kind, colon, address = (name or "").partition(":")
    if not colon or kind not in ("v4l2", "replay"):
        from drivers.cameras.aravis.camera import AravisCamera

        return AravisCamera(name, say=say)
    source, _, part = address.partition("#")
    if not source:
        raise BadInput(
            f"a camera {kind}: must name its {'file' if kind == 'v4l2' else 'folder'}, got {name!r}"
        )
    if kind == "replay":
        from drivers.cameras.replay import ReplayCamera

        return ReplayCamera(source, label=part or None, say=say)
    from drivers.cameras.v4l2 import V4l2Camera

    if part and not part.isdigit():
        raise BadInput(
            f"the input of a capture card must be a whole number, got {part!r} in {name!r}"
        )
    return V4l2Camera(source, input_number=int(part) if part else None)
