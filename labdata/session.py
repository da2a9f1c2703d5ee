"""Session: stacks of frames with their conditions, targets and sensor."""

import hashlib
import os
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from labdata.camera.description import Camera
from labdata.capture import LostFrames
from labdata.conditions import Conditions, conditions_of, flat_conditions
from labdata.errors import BadInput
from labdata.file_io import require_regular
from labdata.frames import FrameStack, LazyStack, View, concatenated
from labdata.sensors import load_camera
from labdata.serialiser import from_toml
from labdata.short_repr import short_repr
from labdata.target import Kind, Target

MANIFEST = "session.toml"

UNUSED = "does not use its target's"  # Text of the note on target fields of another kind

# Settings that determine the black level.
DARK_SETTINGS = ("mcp_v", "camera_gain_db", "gate_ns", "exposure_s")


@dataclass(frozen=True, kw_only=True)
class StackRecord(Conditions):
    """One [[stack]] of a session file; its conditions are keys of the same table."""

    label: str  #: Name of the stack, unique in the session
    kind: Kind  #: Kind of target
    #: File or files of the frames, or a Zarr array, relative to the session's folder
    frames: str | tuple[str, ...]
    #: Number (from 0) or name of the frame axis of the files; by default the first
    axis: str | None = None
    #: Plane to read of colour images, mosaics and files with more axes. Regions, lengths and
    #: frequencies of targets count its own samples
    plane: str | None = None
    extension: str | None = None  #: Picture to read of files that hold several, name or number
    partial: bool | None = None  #: Whether files that end early give their whole frames
    asked: Conditions | None = None  #: Requested conditions, where they differ from those in force
    target: Target = field(default_factory=Target)  #: Target in front of the camera
    #: Its sensor description, where a session has stacks of several; as the session's
    sensor: str | None = None
    bit_depth: int | None = None  #: Bits of its digitiser, in place of the session's
    #: False while the stack is being acquired, and after an interrupted acquisition
    finished: bool | None = None
    #: Number of frames that the camera numbered and that were not recorded
    lost_frames: int | None = None
    lost: tuple[LostFrames, ...] = ()  #: Their numbers and causes, where known
    #: Reason to doubt its frames, such as a bench that went to the safe state while they were
    #: acquired
    doubt: str | None = None
    notes: tuple[str, ...] = ()  #: Remarks


@dataclass(frozen=True, kw_only=True)
class About:
    """What a report states about a specimen and its measurement, none of it measured."""

    serial_number: str | None = None  #: Serial number of the camera or tube
    operator: str | None = None  #: Who took the frames
    date: str | None = None  #: When the frames were taken, as it shall be printed
    remarks: str | None = None  #: Remarks on specimen or measurement
    logo: str | None = None  #: Picture for the head of the report, relative to the session's folder
    #: Unit of frequencies on the report, such as lp/mm; by default lp/mm at the cathode of a
    #: described tube, else cy/px
    units: str | None = None


@dataclass(frozen=True, kw_only=True)
class SessionFile:
    """A session file, session.toml."""

    name: str  #: Name of the session
    about: About | None = None  #: What its report states about the specimen
    #: Name of a shipped sensor description, or the path of one relative to the session's folder
    sensor: str | None = None
    bit_depth: int | None = None  #: Bits of the digitiser; full scale is 2^bits - 1
    #: Whether the two fields of a frame were exposed one after the other
    interlaced: bool | None = None
    notes: tuple[str, ...] = ()  #: Remarks
    stack: tuple[StackRecord, ...] = ()  #: The stacks


# Begins the last line of a manifest that an acquisition or a simulation wrote, a comment of TOML,
# before the SHA-256 of all lines above it; one written by hand has none
DIGEST = b"# sha256 of the lines above: "


def sealed(text: str) -> bytes:
    """Return the text of a manifest with its digest."""
    lines = text.rstrip("\n").encode() + b"\n"
    return lines + DIGEST + hashlib.sha256(lines).hexdigest().encode() + b"\n"


def read_manifest(folder: Path) -> SessionFile:
    """Read the manifest of a session; one that is not what its digest states is BadInput."""
    path = folder / MANIFEST
    require_regular(path, "the manifest of a session")
    # An editor or a transfer may change the ends of lines.
    lines, mark, digest = path.read_bytes().replace(b"\r\n", b"\n").rpartition(DIGEST)
    if mark and hashlib.sha256(lines).hexdigest().encode() != digest.strip():
        raise BadInput(
            f"{path} must be what was written, got lines of another digest than its last one "
            f"states: undo the change, or remove the line that begins with {DIGEST.decode()!r} "
            "if it is meant"
        )
    return from_toml(path, SessionFile)


def stack_record(conditions: Conditions, **keys: Any) -> StackRecord:
    """Return the record of a stack from its conditions and its other keys."""
    return StackRecord(**flat_conditions(conditions), **keys)


@dataclass(frozen=True, kw_only=True)
class StackEntry:
    """One stack of a session, its frames not yet read."""

    label: str  #: Name, unique in the session
    kind: Kind  #: Kind of target
    #: Path of the frames relative to the session folder: a file, an array of the session's store,
    #: or several
    #: consecutive files
    frames: str | tuple[str, ...]
    #: Conditions in force: read-backs where an instrument can be read, else the set-points
    conditions: Conditions = field(default_factory=Conditions)
    asked: Conditions | None = None  #: Requested conditions; None where there were no set-points
    target: Target = field(default_factory=Target)  #: The target
    finished: bool = True  #: False after an interrupted acquisition; acknowledged frames are kept
    lost_frames: int = 0  #: Number of frames that the camera numbered and that were not recorded
    losses: tuple[LostFrames, ...] = ()  #: Their numbers and causes, where known
    notes: tuple[str, ...] = ()  #: Remarks of the manifest
    record_notes: tuple[str, ...] = ()  #: Damage and gaps in the record of the frames
    header_notes: tuple[str, ...] = ()  #: Contradictions of the headers, and exposures added up
    from_headers: tuple[str, ...] = ()  #: Names of the conditions that the headers state
    bit_depth: int | None = None  #: Bits of the digitiser; None if unknown
    sensor: str | None = (
        #: Name of its sensor description, or a path relative to the folder; None: the session's
        None
    )
    #: Frame axis of the files and plane to read; see `labdata.importers.read_frames`
    axis: str | None = None
    #: Frame axis of the files and plane to read; see `labdata.importers.read_frames`
    plane: str | None = None
    extension: str | None = None  #: Picture to read of files that hold several
    partial: bool = False  #: Whether files that end early give their whole frames
    folder: Path  #: The session's folder
    #: How `labdata.lazy_stack.open_lazy_stack` shows the frames; None: as they are
    view: View | None = None

    __repr__ = short_repr

    @property
    def paths(self) -> tuple[Path, ...]:
        """Paths of the files or arrays that hold the frames."""
        names = (self.frames,) if isinstance(self.frames, str) else self.frames
        return tuple(self.folder / name for name in names)

    def read(self, plane: str | None = None) -> FrameStack:
        """Read the frames as the view shows them, or one colour plane; damaged files, and frames
        that break a rule, are BadInput.
        """
        stack = self.read_files(plane)
        if self.view is None:
            return stack
        seen = self.view.through(LazyStack.of(stack, self.label))
        names = ("time_s", "frame_number", "full_scale_dn")
        shown = {name: getattr(seen, name) for name in names}
        return replace(stack, data=seen.frames(0, len(seen)), **shown)

    def read_files(self, plane: str | None = None) -> FrameStack:
        """Read the frames as they are, without the view."""
        unknown = self.bit_depth is None
        parts = [self._read_file(path, plane or self.plane, unknown) for path in self.paths]
        stack = concatenated(parts, self.label)
        if stack.origin != (0, 0) and self.target.region is not None:
            raise BadInput(
                "a region must count from the first pixel that is read, got frames whose border "
                f"is not finite up to {stack.origin} in stack {self.label!r}: cut the border off "
                "in the files"
            )
        broken_off = (
            () if self.finished else (f"the stack was broken off after {len(stack)} frames",)
        )
        return replace(
            stack,
            # Frames lost in the record were counted when the session was opened.
            lost_frames=max(stack.lost_frames, self.lost_frames),
            full_scale_dn=self._full_scale_dn(stack),
            notes=tuple(dict.fromkeys((*stack.notes, *self.notes, *broken_off))),
        )

    def sampling(self) -> tuple[str, int]:
        """Return the plane that the frames show, and the distance of its samples in pixels of the
        camera.
        """
        if self.plane is None:
            return "mono", 1
        first = self._read_file(self.paths[0], self.plane, find_full_scale=False)
        return first.plane, first.sample_pitch_px

    def _read_file(self, path: Path, plane: str | None, find_full_scale: bool) -> FrameStack:
        from labdata.importers import read_frames

        return read_frames(
            path,
            plane,
            axis=self.axis,
            extension=self.extension,
            partial=self.partial,
            find_full_scale=find_full_scale,
        )

    def _full_scale_dn(self, stack: FrameStack) -> float | None:
        if self.bit_depth is None:
            return stack.full_scale_dn
        full_scale_dn = float(2**self.bit_depth - 1)
        if stack.data.max() > full_scale_dn:
            raise BadInput(
                f"pixels must not exceed the {full_scale_dn:.0f} DN of {self.bit_depth} bits, "
                f"got {stack.data.max()} in stack {self.label!r}"
            )
        return full_scale_dn


@dataclass(frozen=True, kw_only=True)
class LoadedStackEntry(StackEntry):
    """A stack with its frames in memory."""

    kept: FrameStack  #: The frames

    __repr__ = short_repr

    def read_files(self, plane: str | None = None) -> FrameStack:
        """Return the frames; `plane` has no effect."""
        return self.kept

    def sampling(self) -> tuple[str, int]:
        """Return the plane of the frames, and the distance of its samples in pixels of the
        camera.
        """
        return self.kept.plane, self.kept.sample_pitch_px


def _agreeing(first: Conditions, other: Conditions) -> tuple[str, ...]:
    """Return the dark-relevant settings in which two conditions agree."""
    return tuple(name for name in DARK_SETTINGS if getattr(first, name) == getattr(other, name))


@dataclass(frozen=True, kw_only=True)
class Session:
    """A session as described by its manifest."""

    folder: Path  #: The session's folder
    name: str  #: Its name
    stacks: tuple[StackEntry, ...]  #: Its stacks in the order of the manifest
    #: Description of the camera named in the manifest; None without a name
    camera: Camera | None = None
    bit_depth: int | None = None  #: Bits of the digitiser; None if unknown
    #: Whether the two fields of a frame were exposed one after the other; None: as in the sensor
    #: description
    interlaced: bool | None = None
    notes: tuple[str, ...] = ()
    about: About = field(default_factory=About)  #: What its report states about the specimen

    __repr__ = short_repr

    def of_kind(self, *kinds: Kind) -> tuple[StackEntry, ...]:
        """Return the stacks of the given kinds."""
        return tuple(stack for stack in self.stacks if stack.kind in kinds)

    def stack(self, label: str) -> StackEntry:
        """Return the stack with a label; an unknown label is a BadInput."""
        for entry in self.stacks:
            if entry.label == label:
                return entry
        raise BadInput(f"a stack must be one of {[s.label for s in self.stacks]}, got {label!r}")

    @cached_property
    def sampling(self) -> tuple[str, int]:
        """Plane that all stacks show, and distance of its samples in pixels of the camera.

        Stacks of several planes are a BadInput, and so is a plane of a mosaic behind an image tube.
        """
        label_of_sampling: dict[tuple[str, int], str] = {}
        for entry in self.stacks:
            if entry.kind != "scene":
                plane, pitch_px = entry.sampling()
                label_of_sampling.setdefault(
                    ("mono" if plane == "luminance" else plane, pitch_px), entry.label
                )
        if len(label_of_sampling) > 1:
            shown = " and ".join(
                f"{plane} in {label!r}" for (plane, _), label in label_of_sampling.items()
            )
            raise BadInput(
                f"one camera description is of one colour plane, got {shown} of session "
                f"{self.name!r}"
            )
        plane, pitch_px = next(iter(label_of_sampling), ("mono", 1))
        if pitch_px > 1 and self.camera is not None and self.camera.silicon is None:
            raise BadInput(
                f"a plane of a mosaic must be that of a camera without an image tube, got {plane} "
                f"of session {self.name!r}, camera {self.camera.name!r}"
            )
        return plane, pitch_px

    def dark_like(self, conditions: Conditions) -> StackEntry | None:
        """Return the dark whose settings agree best with some conditions; None without darks."""
        darks = self.of_kind("dark")
        return (
            max(darks, key=lambda dark: len(_agreeing(dark.conditions, conditions)))
            if darks
            else None
        )

    def black_dn(self, entry: StackEntry) -> float | None:
        """Return the mean of the dark with the settings of a stack, DN; None where there is
        none.
        """
        dark = self.dark_like(entry.conditions)
        if dark is None or len(_agreeing(dark.conditions, entry.conditions)) < len(DARK_SETTINGS):
            return None
        return dark.read().mean_dn

    @property
    def is_interlaced(self) -> bool:
        """Whether frames have two fields exposed one after the other."""
        if self.interlaced is not None:
            return self.interlaced
        return self.camera is not None and self.camera.interlaced


def open_session(path: str | Path) -> Session:
    """Open the session of a folder, or of its session.toml; frames are read on demand.

    Raises
    ------
    BadInput
        If there is no session, it has no stacks, a key is unknown, a condition breaks a rule, or
        frames are missing.
    """
    path = Path(path)
    folder = path.parent if path.name == MANIFEST else path
    if not (folder / MANIFEST).is_file():
        raise BadInput(f"a session must be a folder with a {MANIFEST}, got {path}")
    return session_of(folder, read_manifest(folder))


def session_of(folder: Path, form: SessionFile) -> Session:
    """Return the session of a manifest, checked as by `open_session`."""
    _check(form, folder)
    camera = None if form.sensor is None else load_camera(form.sensor, relative_to=folder)
    stacks = tuple(_entry(stack, form, folder) for stack in form.stack)
    for entry in stacks:
        for path in entry.paths:
            if not os.path.isdir(path):  # Path.is_dir raises on invalid names
                require_regular(path, f"the frames of stack {entry.label!r}")
    return Session(
        folder=folder,
        name=form.name,
        stacks=stacks,
        camera=camera,
        bit_depth=form.bit_depth,
        interlaced=form.interlaced,
        about=form.about or About(),
        notes=(
            *form.notes,
            *_superfluous_targets(stacks),
            *_conditions_of_headers(stacks),
            *dict.fromkeys(
                note for entry in stacks for note in (*entry.record_notes, *entry.header_notes)
            ),
        ),
    )


def _conditions_of_headers(stacks: tuple[StackEntry, ...]) -> tuple[str, ...]:
    """Return a note on the conditions that are those of headers."""
    names = dict.fromkeys(name for entry in stacks for name in entry.from_headers)
    count = sum(1 for entry in stacks if entry.from_headers)
    of = f"{count} of {len(stacks)} stacks" if len(stacks) > 1 else "the stack"
    return (f"{', '.join(names)} of {of}: by the headers of the files",) if names else ()


def _superfluous_targets(stacks: tuple[StackEntry, ...]) -> tuple[str, ...]:
    """Return notes on target fields that do not apply: a wrong kind, or a target of another
    stack.
    """
    superfluous = (
        (entry, " and ".join(entry.target.superfluous_names(entry.kind))) for entry in stacks
    )
    return tuple(
        f"stack {entry.label!r} of kind {entry.kind!r} {UNUSED} {them}"
        for entry, them in superfluous
        if them
    )


def _check(form: SessionFile, folder: Path) -> None:
    labels = [stack.label for stack in form.stack]
    if not labels:
        raise BadInput(f"a session must have at least one stack, got none in {folder}")
    if repeated := {label for label in labels if labels.count(label) > 1}:
        raise BadInput(
            f"every stack's label must be its own, got {min(repeated)!r} twice in {folder}"
        )
    if form.bit_depth is not None and not 1 <= form.bit_depth <= 32:
        raise BadInput(f"bit_depth must lie between 1 and 32, got {form.bit_depth} in {folder}")
    if empty := [stack.label for stack in form.stack if not stack.frames]:
        raise BadInput(f"a stack must name its frames, got none for {empty[0]!r} in {folder}")


def _entry(stack: StackRecord, form: SessionFile, folder: Path) -> StackEntry:
    from labdata.header_conditions import with_headers

    lost_frames, record_notes = _record(stack, folder)
    names = (stack.frames,) if isinstance(stack.frames, str) else stack.frames
    conditions, from_headers, header_notes = with_headers(
        conditions_of(stack),
        [folder / name for name in names],
        label=stack.label,
        extension=stack.extension,
    )
    return StackEntry(
        label=stack.label,
        kind=stack.kind,
        frames=stack.frames,
        conditions=conditions,
        from_headers=from_headers,
        asked=stack.asked,
        target=stack.target,
        finished=stack.finished is not False,
        lost_frames=(stack.lost_frames or 0) + lost_frames,
        losses=stack.lost,
        notes=stack.notes if stack.doubt is None else (*stack.notes, stack.doubt),
        record_notes=record_notes,
        header_notes=header_notes,
        bit_depth=form.bit_depth if stack.bit_depth is None else stack.bit_depth,
        sensor=stack.sensor,
        # The stacks of a manifest are frames by definition.
        axis=stack.axis or "frame",
        plane=stack.plane,
        extension=stack.extension,
        partial=bool(stack.partial),
        folder=folder,
    )


def _record(stack: StackRecord, folder: Path) -> tuple[int, tuple[str, ...]]:
    """Return the number of frames lost by the journal of a stack's array, and its notes."""
    from labdata.store.journal import is_ours, read_journal

    if not isinstance(stack.frames, str) or not is_ours(folder / stack.frames):
        return 0, ()
    try:
        journal = read_journal(folder / stack.frames)
    except BadInput as error:  # the other stacks can be read
        return 0, (str(error),)
    return journal.lost_frames, journal.notes


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file, or of the `sha256sum` output for a folder's files, sorted by
    relative name.
    """
    if not path.is_dir():
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    files = sorted(
        (part.relative_to(path).as_posix(), part) for part in path.rglob("*") if part.is_file()
    )
    lines = "".join(f"{sha256_of(part)}  {name}\n" for name, part in files)
    return hashlib.sha256(lines.encode()).hexdigest()
