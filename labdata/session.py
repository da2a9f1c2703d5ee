"""A session: stacks of frames, the conditions they were taken under, and the sensor that took them."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.sensor import Sensor
from labdata.target import Target

Kind = Literal["dark", "flat", "edge", "bars", "point", "scene"]


@dataclass(frozen=True, kw_only=True)
class StackEntry:
    """One stack of a session, its frames not yet read.

    Parameters
    ----------
    label
        Name, unique in the session.
    kind
        What it shows.
    frames
        Path of the frames relative to the session's folder: a file, or an array of the session's store.
    conditions
        Conditions in force: what was read back where an instrument can be read, else what was asked.
    asked
        Conditions asked for; None where nothing was asked of an instrument.
    target
        The target.
    """

    label: str
    kind: Kind
    frames: str
    conditions: Conditions = field(default_factory=Conditions)
    asked: Conditions | None = None
    target: Target = field(default_factory=Target)
    folder: Path

    def read(self) -> FrameStack:
        """Read the frames."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class Session:
    """A session as its manifest describes it.

    Parameters
    ----------
    folder
        The session's folder.
    name
        Its name.
    stacks
        Its stacks in the order of the manifest.
    sensor
        The sensor description it names, or None.
    bit_depth
        Bits of the digitiser; None if unknown.
    interlaced
        Whether the two fields of a frame were exposed one after the other; None: as the sensor says, else not.
    """

    folder: Path
    name: str
    stacks: tuple[StackEntry, ...]
    sensor: Sensor | None = None
    bit_depth: int | None = None
    interlaced: bool | None = None
    notes: tuple[str, ...] = ()

    def of_kind(self, *kinds: Kind) -> tuple[StackEntry, ...]:
        """Stacks of the given kinds."""
        return tuple(stack for stack in self.stacks if stack.kind in kinds)

    def stack(self, label: str) -> StackEntry:
        """The stack with a label; an unknown label is a BadInput."""
        for entry in self.stacks:
            if entry.label == label:
                return entry
        raise BadInput(f"a stack must be one of {[s.label for s in self.stacks]}, got {label!r}")

    @property
    def is_interlaced(self) -> bool:
        """Whether frames hold two fields exposed one after the other."""
        if self.interlaced is not None:
            return self.interlaced
        return self.sensor is not None and self.sensor.video.interlaced


def open_session(path: str | Path) -> Session:
    """Open the session in a folder (or the folder of its session.toml)."""
    raise NotImplementedError
