"""Input of scripts: frames from arrays and files, and sessions of stacks in memory."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Unpack

from charact.api.settings import BlackDn, Frames, SourceFrames
from labdata.conditions import StackConditions
from labdata.errors import BadInput
from labdata.settings import (
    Argument,
    CameraDescription,
    Extension,
    FrameAxis,
    Partial,
    Plane,
    documented,
)

if TYPE_CHECKING:
    from labdata import Camera, FrameStack, Kind, Session, StackEntry, Target


@documented
def frames_of(
    source: SourceFrames,
    *,
    plane: Plane = None,
    axis: FrameAxis = None,
    extension: Extension = None,
    partial: Partial = False,
    black_dn: BlackDn = None,
) -> "FrameStack":
    """Return the frames of an array, a file or a stack.

    Raises
    ------
    BadInput
        If the source is no image, or the black level is not below the largest pixel.

    Examples
    --------
    >>> import numpy as np
    >>> frames_of(np.zeros((4, 60, 80))).shape
    (4, 60, 80)
    """
    from labdata import FrameStack, read_array, read_frames

    plane, axis, extension = map(_text, (plane, axis, extension))
    if extension is not None and not isinstance(source, str | Path | FrameStack):
        raise BadInput(f"`extension` chooses a picture of a file, got {extension!r} for an array")
    if isinstance(source, FrameStack):
        frames = source
    elif isinstance(source, str | Path):
        frames = read_frames(source, plane=plane, axis=axis, extension=extension, partial=partial)
    else:
        frames = read_array(source, plane=plane, axis=axis)
    if black_dn is None:
        return frames
    highest = float(frames.data.max())
    if black_dn >= highest:
        raise BadInput(
            f"`black_dn` must be below the largest grey value of the frames, {highest:g} DN, got "
            f"{black_dn:g}"
        )
    return replace(frames, black_level_dn=black_dn)


def _text(number: str | int | None) -> str | None:
    """Return a plane, axis or extension as the readers take it."""
    return None if number is None else str(number)


@documented
def stack(
    frames: SourceFrames,
    kind: Annotated["Kind", Argument('"dark", "flat", "edge", "bars", "point" or "scene".')],
    *,
    label: Annotated[str, Argument("Name of the stack (default: the kind).")] = "",
    target: Annotated[
        "Target | None", Argument("The target, for bars with frequency and number.")
    ] = None,
    **conditions: Unpack[StackConditions],
) -> "StackEntry":
    """Return a stack of a session, with its frames in memory.

    Examples
    --------
    >>> import numpy as np
    >>> stack(np.zeros((4, 60, 80), np.uint16), "dark", exposure_s=0.01).conditions.exposure_s
    0.01
    """
    from labdata import Conditions, LoadedStackEntry, Target
    from labdata.header_conditions import with_headers
    from labdata.target import kind_of

    kind = kind_of(kind)
    files = [Path(frames)] if isinstance(frames, str | Path) else []
    in_force, from_headers, _ = with_headers(Conditions(**conditions), files, label=label or kind)
    return LoadedStackEntry(
        label=label or kind,
        kind=kind,
        frames=(),
        folder=Path(),
        kept=frames_of(frames),
        conditions=in_force,
        from_headers=from_headers,
        target=target or Target(),
    )


@documented
def session(
    stacks: Annotated["Iterable[StackEntry]", Argument("Stacks of `stack`.")],
    *,
    sensor: CameraDescription = None,
    bit_depth: Annotated[
        int | None, Argument("Bits of the digitiser (default: found from the data).")
    ] = None,
    interlaced: Annotated[
        bool | None,
        Argument(
            "Whether the two fields of a frame are exposed one after the other (default: as the "
            "camera description says)."
        ),
    ] = None,
    name: Annotated[str, Argument("Name in reports.")] = "arrays",
) -> "Session":
    """Return a session of stacks in memory; labels that repeat are numbered.

    Examples
    --------
    >>> import numpy as np
    >>> [entry.label for entry in session([stack(np.zeros((2, 60, 80)), "dark")] * 2).stacks]
    ['dark-1', 'dark-2']
    """
    from labdata.session import Session

    unnumbered = tuple(stacks)
    labels = [entry.label for entry in unnumbered]
    repeated = {label for label in labels if labels.count(label) > 1}
    counts = dict.fromkeys(repeated, 0)
    entries = []
    for entry in unnumbered:
        if entry.label in repeated:
            counts[entry.label] += 1
            entry = replace(entry, label=f"{entry.label}-{counts[entry.label]}")
        entries.append(_with_bit_depth(entry, bit_depth))
    if not entries:
        raise BadInput("a session must have at least one stack, got none")
    return Session(
        folder=Path(),
        name=name,
        stacks=tuple(entries),
        camera=camera_of(sensor),
        bit_depth=bit_depth,
        interlaced=interlaced,
    )


def _with_bit_depth(entry: "StackEntry", bit_depth: int | None) -> "StackEntry":
    """Return a stack in memory whose frames have the full scale of a digitiser."""
    from labdata.session import LoadedStackEntry

    if bit_depth is None or not isinstance(entry, LoadedStackEntry):
        return entry
    full_scale_dn = float(2**bit_depth - 1)
    if (highest := entry.kept.data.max()) > full_scale_dn:
        raise BadInput(
            f"pixels must not exceed the {full_scale_dn:.0f} DN of {bit_depth} bits, got "
            f"{highest} in stack {entry.label!r}"
        )
    return replace(
        entry, bit_depth=bit_depth, kept=replace(entry.kept, full_scale_dn=full_scale_dn)
    )


def camera_of(sensor: CameraDescription) -> "Camera | None":
    """Return a camera description, or load it by name or file."""
    from labdata.sensors import load_camera

    return load_camera(sensor) if isinstance(sensor, str | Path) else sensor


def sensor_of(sensor: CameraDescription) -> "Camera | None":
    """Return the description of an intensified camera, or load it by name or file."""
    from labdata.sensors import load_sensor

    return load_sensor(sensor) if isinstance(sensor, str | Path) else sensor


def is_session(source: object) -> bool:
    """Whether a source is a session or the folder of one."""
    from labdata.session import MANIFEST, Session

    if isinstance(source, Session):
        return True
    return isinstance(source, str | Path) and (
        Path(source).name == MANIFEST or (Path(source) / MANIFEST).is_file()
    )


def session_of(source: "str | Path | Session", sensor: CameraDescription = None) -> "Session":
    """Return a session, or open that of a folder, with the description of its camera replaced."""
    from labdata.session import Session, open_session

    opened = source if isinstance(source, Session) else open_session(source)
    return opened if sensor is None else replace(opened, camera=camera_of(sensor))


def flats_of(
    source: "Frames | Session",
    *,
    sensor: CameraDescription = None,
    plane: Plane = None,
    axis: FrameAxis = None,
    extension: Extension = None,
    partial: Partial = False,
) -> "Session":
    """Return a session, or the session of one stack of flats."""
    from labdata import MANIFEST, Conditions, Session, StackEntry

    if is_session(source):
        return session_of(source, sensor)
    if not isinstance(source, str | Path):
        flats = frames_of(source, plane=plane, axis=axis, extension=extension)
        return session([stack(flats, "flat")], sensor=sensor)
    file = Path(source)
    if not file.exists() or (file.is_dir() and not (file / "zarr.json").is_file()):
        raise BadInput(
            f"flats must be a session folder with a {MANIFEST}, or a file of frames, got {file}"
        )
    entry = StackEntry(
        label=file.stem,
        kind="flat",
        frames=file.name,
        conditions=Conditions(),
        folder=file.parent,
        axis=_text(axis),
        plane=_text(plane),
        extension=_text(extension),
        partial=partial,
    )
    return Session(folder=file.parent, name=file.name, stacks=(entry,), camera=camera_of(sensor))
