"""Input of scripts: frames from arrays and files, and sessions of stacks in memory."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from labdata.camera.description import Camera
from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.importers import read_array, read_frames
from labdata.sensors import load_camera, load_sensor
from labdata.session import Kind, LoadedStackEntry, Session, StackEntry, open_session
from labdata.target import Target

#: An array (row, col), (frame, row, col) or with colours last, a file of frames, or a stack
Frames = Any


def frames_of(
    source: Frames,
    *,
    plane: str | None = None,
    axis: str | None = None,
    black_dn: float | None = None,
) -> FrameStack:
    """Return the frames of an array, a file or a stack.

    Parameters
    ----------
    source
        Array of shape (row, col), (frame, row, col) or with colours last, DN; path of a file of
        frames; or a stack.
    plane, axis
        Colour plane and frame axis, as for `labdata.importers.read_frames`.
    black_dn
        Black level, DN; None: as the file states.

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
    if isinstance(source, FrameStack):
        stack = source
    elif isinstance(source, str | Path):
        stack = read_frames(source, plane=plane, axis=axis)
    else:
        stack = read_array(source, plane=plane, axis=axis)
    if black_dn is None:
        return stack
    highest = float(stack.data.max())
    if not -float("inf") < black_dn < highest:
        raise BadInput(
            f"--black-dn must be below the largest grey value of the frames, {highest:g} DN, got "
            f"{black_dn:g}"
        )
    return replace(stack, black_level_dn=black_dn)


def stack(
    frames: Frames, kind: Kind, *, label: str = "", target: Target | None = None, **conditions: Any
) -> StackEntry:
    """Return a stack of a session, with its frames in memory.

    Parameters
    ----------
    frames
        Frames as for `frames_of`.
    kind
        "dark", "flat", "edge", "bars", "point" or "scene".
    label
        Name of the stack; "": the kind.
    target
        The target, for bars with frequency and number.
    conditions
        Fields of `labdata.conditions.Conditions`, such as `exposure_s` and `photons_per_px`.

    Examples
    --------
    >>> import numpy as np
    >>> stack(np.zeros((4, 60, 80), np.uint16), "dark", exposure_s=0.01).conditions.exposure_s
    0.01
    """
    known = set(Conditions.__dataclass_fields__)
    if unknown := sorted(set(conditions) - known):
        raise BadInput(f"a condition must be one of {', '.join(sorted(known))}, got {unknown[0]!r}")
    return LoadedStackEntry(
        label=label or kind,
        kind=kind,
        frames=(),
        folder=Path(),
        kept=frames_of(frames),
        conditions=Conditions(**conditions),
        target=target or Target(),
    )


def session(
    stacks: Iterable[StackEntry],
    *,
    sensor: str | Path | Camera | None = None,
    bit_depth: int | None = None,
    interlaced: bool | None = None,
    name: str = "arrays",
) -> Session:
    """Return a session of stacks in memory; labels that repeat are numbered.

    Parameters
    ----------
    stacks
        Stacks of `stack`.
    sensor
        Description of the camera: a shipped name, a TOML file or a `Camera`; None: unknown.
    bit_depth
        Bits of the digitiser; None: found from the data.
    interlaced
        Whether the two fields of a frame are exposed one after the other; None: as the sensor
        description says.
    name
        Name in reports.

    Examples
    --------
    >>> import numpy as np
    >>> [one.label for one in session([stack(np.zeros((2, 60, 80)), "dark")] * 2).stacks]
    ['dark-1', 'dark-2']
    """
    given = tuple(stacks)
    labels = [one.label for one in given]
    repeated = {label for label in labels if labels.count(label) > 1}
    counts = dict.fromkeys(repeated, 0)
    entries = []
    for one in given:
        if one.label in repeated:
            counts[one.label] += 1
            one = replace(one, label=f"{one.label}-{counts[one.label]}")
        entries.append(_with_bit_depth(one, bit_depth))
    if not entries:
        raise BadInput("a session must have at least one stack, got none")
    camera = load_camera(sensor) if isinstance(sensor, str | Path) else sensor
    return Session(
        folder=Path(),
        name=name,
        stacks=tuple(entries),
        camera=camera,
        bit_depth=bit_depth,
        interlaced=interlaced,
    )


def _with_bit_depth(entry: StackEntry, bit_depth: int | None) -> StackEntry:
    """Return a stack in memory whose frames have the full scale of a digitiser."""
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


def session_of(source: str | Path | Session) -> Session:
    """Return a session, or open that of a folder."""
    return source if isinstance(source, Session) else open_session(source)


def sensor_of(sensor: str | Path | Camera | None) -> Camera | None:
    """Return a sensor description, or load it by name or file."""
    return load_sensor(sensor) if isinstance(sensor, str | Path) else sensor
