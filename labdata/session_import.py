"""Sessions that refer to existing frames: an EMVA 1288 series, or separate files with conditions in
their names.
"""

import os
import re
from collections.abc import Iterable
from dataclasses import fields, replace
from pathlib import Path

from labdata.conditions import SWITCHES, Conditions
from labdata.errors import BadInput
from labdata.file_io import require_regular, write_atomically
from labdata.serialiser import from_mapping, to_mapping, to_toml
from labdata.session import (
    MANIFEST,
    Session,
    SessionFile,
    StackRecord,
    read_manifest,
    session_of,
    stack_record,
)
from labdata.target import Kind

KINDS: dict[str, Kind] = {"b": "flat", "d": "dark"}
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


def import_emva1288(file: str | Path, out: str | Path) -> Session:
    """Make a session that refers to the images of an EMVA 1288 descriptor file.

    The descriptor has the lines `v` version, `n` bits width height, `b` exposure photons, `d`
    exposure (ns), `i` image. One that breaks its format, lacks an image, or a folder with a session
    is BadInput.
    """
    from labdata.importers import read_frames

    file, out = Path(file), Path(out)
    version, (bits, columns, rows), levels = _read_descriptor(file)
    for image in levels[0][1][:1]:
        _, there, across = read_frames(file.parent / image).shape
        if (across, there) != (columns, rows):
            raise BadInput(
                f"images must be the {columns}x{rows} px of {file.name}, got {across}x{there} px "
                f"in {image}"
            )
    stacks = []
    for number, (stack, images) in enumerate(levels):
        if len(images) < 2:
            raise BadInput(
                f"every exposure of an EMVA 1288 descriptor must have two images or more, "
                f"got {len(images)} at {1e9 * (stack.exposure_s or 0.0):g} ns in {file.name}"
            )
        label = f"{stack.kind}-{number:03d}{'-spatial' if len(images) > 2 else ''}"
        frames = tuple(_relative(file.parent / image, out) for image in images)
        stacks.append(replace(stack, label=label, frames=frames))
    form = SessionFile(
        name=f"EMVA 1288 series {file.resolve().parent.name}",
        bit_depth=bits,
        interlaced=False,
        notes=(f"imported from an EMVA 1288 descriptor of version {version}",),
        stack=tuple(stacks),
    )
    return _write_session(form, out)


def _read_descriptor(
    file: Path,
) -> tuple[str, tuple[int, ...], list[tuple[StackRecord, list[str]]]]:
    """Return version, bits and size of the images, and stacks with the names of their images."""
    require_regular(file, "a descriptor file")
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        raise BadInput(f"a descriptor file must be a text file, got {file}") from None
    version, size = "unknown", ()
    levels: list[tuple[StackRecord, list[str]]] = []
    for number, line in enumerate(lines, 1):
        key, *values = line.split() or ("#",)
        try:
            if key == "v":
                version = values[0]
            elif key == "n":
                size = tuple(int(value) for value in values[:3])
            elif key in KINDS:
                photons = float(values[1]) if key == "b" else None
                conditions = Conditions(exposure_s=float(values[0]) * 1e-9, photons_per_px=photons)
                levels.append((stack_record(conditions, label="", kind=KINDS[key], frames=""), []))
            elif key == "i" and values and "\0" not in line:
                # Descriptors written on Windows have backslashes.
                levels[-1][1].append(" ".join(values).replace("\\", "/"))
            elif not key.startswith("#"):
                raise ValueError
        except BadInput:
            raise
        except (ValueError, IndexError):
            raise BadInput(
                f"a line of an EMVA 1288 descriptor must be v, n, b, d or i with its values, "
                f"got {' '.join((key, *values))!r} in line {number} of {file.name}"
            ) from None
    if len(size) < 3 or not levels:
        raise BadInput(
            f"an EMVA 1288 descriptor must hold a line n and at least one of b or d, got {file}"
        )
    return version, size, levels


def import_frames(
    files: Iterable[str | Path],
    out: str | Path,
    *,
    kind: Kind | None = None,
    name_pattern: str | None = None,
    label: str | None = None,
    axis: str | None = None,
    plane: str | None = None,
    extension: str | None = None,
    partial: bool = False,
    add: bool = False,
) -> Session:
    """Make a session that refers to files of frames where they are.

    Parameters
    ----------
    kind
        Kind of the stacks. None: as the header of a FITS file states, else scene.
    name_pattern
        Pattern of the file names, such as "{mcp_v}V_{gate_ns}ns_*": a condition in braces matches a
        number,
        * anything. Files of equal conditions become one stack.
    label
        Label of one stack that has all files in the order of their names.
    axis, plane, extension, partial
        Settings of `labdata.importers.read_frames`, kept in the session.
    add
        Whether to add the stacks to the session that is there.

    Notes
    -----
    Without pattern and label each file is a stack, but FITS files of one frame whose headers state
    kind or exposure: those alike become one stack (`labdata.header_conditions`).
    """
    from labdata.header_conditions import require_one_camera
    from labdata.importers import reader_of

    paths, out = sorted({Path(file) for file in files}), Path(out)
    if not paths:
        raise BadInput("a session needs at least one file of frames, got none")
    for path in paths:
        reader_of(path)
    if label is not None and name_pattern is not None:
        raise BadInput(
            "`label` gathers all files, `name_pattern` those of equal conditions: give one of them"
        )
    if label is not None:
        groups = [(label, kind or "scene", Conditions(), paths)]
    elif name_pattern is not None:
        groups = _group_files(paths, kind or "scene", name_pattern)
    else:
        groups = _group_headers(paths, kind, plane, extension)
    stacks = tuple(
        stack_record(
            conditions,
            label=name,
            kind=of,
            frames=_frames_of(files, out),
            axis=axis,
            plane=plane,
            extension=extension,
            partial=partial or None,
        )
        for name, of, conditions, files in groups
    )
    form = _session_to_add_to(out) if add else SessionFile(name=out.resolve().name)
    notes = (*form.notes, *_findings(stacks, out))
    form = replace(form, stack=(*form.stack, *stacks), notes=notes)
    require_one_camera(
        [
            ((out / name).resolve(), stack.extension)
            for stack in form.stack
            for name in _names_of(stack)
        ]
    )
    return _write_session(form, out, add=add)


Group = tuple[str, Kind, Conditions, list[Path]]


def _session_to_add_to(out: Path) -> SessionFile:
    """Return the manifest of a session; a folder without one, or one whose acquisition wrote it, is
    BadInput.
    """
    if not (out / MANIFEST).is_file():
        raise BadInput(f"`add` needs the folder of a session, got {out} without a {MANIFEST}")
    return read_manifest(out)


def _group_headers(
    paths: list[Path], kind: Kind | None, plane: str | None, extension: str | None
) -> list[Group]:
    """Return the stacks of files by their FITS headers; a file of another form is one of its
    own.
    """
    from labdata.header_conditions import group_stated, read_stated_frame

    stated = [read_stated_frame(path, plane, extension) for path in paths]
    alone = [path for path, one in zip(paths, stated, strict=True) if one is None]
    stems = [path.stem for path in alone]
    single_stacks = [
        (path.stem if stems.count(path.stem) == 1 else path.name, path) for path in alone
    ]
    known = [one for one in stated if one is not None]
    return [
        *((name, kind or "scene", Conditions(), [path]) for name, path in single_stacks),
        *(group_stated(known, kind) if known else []),
    ]


def _names_of(stack: StackRecord) -> tuple[str, ...]:
    """Return the files of a stack, relative to the session's folder."""
    return (stack.frames,) if isinstance(stack.frames, str) else stack.frames


def _frames_of(paths: list[Path], out: Path) -> str | tuple[str, ...]:
    """Return the frames of a stack for the manifest: a name, or several."""
    names = tuple(_relative(path, out) for path in paths)
    return names[0] if len(names) == 1 else names


def _group_files(paths: list[Path], kind: Kind, pattern: str) -> list[Group]:
    """Return the stacks of files by the conditions in their names."""
    expression = _name_expression(pattern)
    groups: dict[tuple[tuple[str, float], ...], list[Path]] = {}
    for path in paths:
        match = expression.fullmatch(path.stem) or expression.fullmatch(path.name)
        if match is None:
            raise BadInput(f"every file name must match the pattern {pattern!r}, got {path.name!r}")
        groups.setdefault(
            tuple((name, float(text)) for name, text in match.groupdict().items()), []
        ).append(path)
    return [
        (
            f"{kind} " + " ".join(f"{name}={value:g}" for name, value in key),
            kind,
            replace(Conditions(), **dict(key)),
            members,
        )
        for key, members in sorted(groups.items())
    ]


def _name_expression(pattern: str) -> re.Pattern[str]:
    """Return the regular expression of a name pattern; an unknown condition is a BadInput."""
    known = [item.name for item in fields(Conditions) if item.name not in SWITCHES]
    parts = re.split(r"(\{[^{}]*\}|\*)", pattern)
    names = [part[1:-1] for part in parts if part.startswith("{")]
    if unknown := [name for name in names if name not in known]:
        raise BadInput(
            f"a name in the braces of a pattern must be one of {', '.join(known)}, got "
            f"{unknown[0]!r}"
        )
    if not names or len(set(names)) < len(names):
        raise BadInput(
            f"a pattern must name one condition or more, each once, in braces, got {pattern!r}"
        )
    forms = {"*": ".*?", **{f"{{{name}}}": f"(?P<{name}>{NUMBER})" for name in names}}
    return re.compile("".join(forms.get(part, re.escape(part)) for part in parts))


def _findings(stacks: tuple[StackRecord, ...], out: Path) -> tuple[str, ...]:
    """Read every file once; return notes of the readers and on stacks of different sizes. A stack
    has one size.
    """
    from labdata.importers import read_frames

    label_of_size: dict[tuple[int, int], str] = {}
    notes: dict[str, list[str]] = {}
    for stack in stacks:
        sizes: dict[tuple[int, int], str] = {}
        for name in _names_of(stack):
            frames = read_frames(
                (out / name).resolve(),
                stack.plane,
                axis=stack.axis,
                extension=stack.extension,
                partial=bool(stack.partial),
                find_full_scale=False,
            )
            sizes[frames.shape[1:]] = name
            for note in frames.notes:
                notes.setdefault(note, []).append(Path(name).name)
        if len(sizes) > 1:
            shown = " and ".join(
                f"{size[0]} x {size[1]} in {Path(name).name}" for size, name in sizes.items()
            )
            raise BadInput(
                f"all files of a stack must have one picture size, got {shown} for {stack.label!r}"
            )
        label_of_size |= {size: stack.label for size in sizes if size not in label_of_size}
    sentences = [
        f"{files[0]}{f' and {len(files) - 1} more' if files[1:] else ''}: {note}"
        for note, files in notes.items()
    ]
    if len(label_of_size) > 1:
        shown = ", ".join(
            f"{rows} x {cols} ({label})" for (rows, cols), label in label_of_size.items()
        )
        sentences.append(f"pictures of several sizes, rows x columns: {shown}")
    return tuple(sentences)


def _write_session(form: SessionFile, out: Path, *, add: bool = False) -> Session:
    """Check a session, write its manifest and return it; one that is there is only replaced to add
    to it.
    """
    if (out / MANIFEST).exists() and not add:
        raise BadInput(f"a new session needs a folder without one, got {out}")
    form = from_mapping(to_mapping(form), SessionFile, where=MANIFEST)
    try:
        out.mkdir(parents=True, exist_ok=True)
        session = session_of(out, form)
        write_atomically(out / MANIFEST, to_toml(form).encode())
    except OSError as error:
        raise BadInput(
            f"a session must be a folder that can be written, got {out}: {error.strerror}"
        ) from None
    return session


def _relative(path: Path, folder: Path) -> str:
    """Return a path for the manifest of a folder: relative inside the parent folder, absolute
    elsewhere.
    """
    path, folder = path.resolve(), folder.resolve()
    return os.path.relpath(path, folder) if path.is_relative_to(folder.parent) else str(path)
