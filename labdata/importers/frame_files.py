"""Session from separate files of frames; a name pattern gives the conditions."""

import re
from collections.abc import Iterable
from dataclasses import fields, replace
from pathlib import Path

from labdata.conditions import SWITCHES, Conditions
from labdata.errors import BadInput
from labdata.file_records import SessionFile, StackRecord, stack_record
from labdata.importers.emva1288 import relative, write_session
from labdata.session import Kind, Session

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


def import_frames(
    files: Iterable[str | Path],
    out: str | Path,
    *,
    kind: Kind = "scene",
    name_pattern: str | None = None,
    axis: str | None = None,
    plane: str | None = None,
) -> Session:
    """Make a session that refers to files of frames where they are.

    Parameters
    ----------
    name_pattern
        Pattern of the file names, such as "{mcp_v}V_{gate_ns}ns_*": a condition in braces matches a number,
        * anything. Files of equal conditions become one stack. None: one stack per file.
    axis, plane
        Frame axis of the files and plane to read, kept in the session.
    """
    from labdata.importers import reader_of

    paths = sorted({Path(file) for file in files})
    if not paths:
        raise BadInput("a session needs at least one file of frames, got none")
    for path in paths:
        reader_of(path)
    out = Path(out)
    stacks = _single(paths, out, kind) if name_pattern is None else _group_files(paths, out, kind, name_pattern)
    stacks = tuple(replace(stack, axis=axis, plane=plane) for stack in stacks)
    return write_session(SessionFile(name=out.resolve().name, stack=stacks, notes=_findings(stacks, out)), out)


def _findings(stacks: tuple[StackRecord, ...], out: Path) -> tuple[str, ...]:
    """Read every file once; return notes of the readers and on stacks of different sizes. A stack has one size."""
    from labdata.importers import read_frames

    found: dict[tuple[int, int], str] = {}
    notes: dict[str, list[str]] = {}
    for stack in stacks:
        sizes: dict[tuple[int, int], str] = {}
        for name in _names(stack):
            frames = read_frames((out / name).resolve(), stack.plane, axis=stack.axis, find_full_scale=False)
            sizes[frames.shape[1:]] = name
            for note in frames.notes:
                notes.setdefault(note, []).append(Path(name).name)
        if len(sizes) > 1:
            shown = " and ".join(f"{size[0]} x {size[1]} in {Path(name).name}" for size, name in sizes.items())
            raise BadInput(f"all files of a stack must have one picture size, got {shown} for {stack.label!r}")
        found |= {size: stack.label for size in sizes if size not in found}
    said = [f"{files[0]}{f' and {len(files) - 1} more' if files[1:] else ''}: {note}" for note, files in notes.items()]
    if len(found) > 1:
        shown = ", ".join(f"{rows} x {cols} ({label})" for (rows, cols), label in found.items())
        said.append(f"pictures of several sizes, rows x columns: {shown}")
    return tuple(said)


def _names(stack: StackRecord) -> tuple[str, ...]:
    return (stack.frames,) if isinstance(stack.frames, str) else stack.frames


def _single(paths: list[Path], out: Path, kind: Kind) -> tuple[StackRecord, ...]:
    stems = [path.stem for path in paths]
    labels = [path.stem if stems.count(path.stem) == 1 else path.name for path in paths]
    return tuple(
        stack_record(Conditions(), label=label, kind=kind, frames=relative(path, out))
        for label, path in zip(labels, paths, strict=True)
    )


def _group_files(paths: list[Path], out: Path, kind: Kind, pattern: str) -> tuple[StackRecord, ...]:
    expression = name_expression(pattern)
    groups: dict[tuple[tuple[str, float], ...], list[Path]] = {}
    for path in paths:
        match = expression.fullmatch(path.stem) or expression.fullmatch(path.name)
        if match is None:
            raise BadInput(f"every file name must match the pattern {pattern!r}, got {path.name!r}")
        conditions = tuple((name, float(text)) for name, text in match.groupdict().items())
        groups.setdefault(conditions, []).append(path)
    return tuple(
        stack_record(
            replace(Conditions(), **dict(conditions)),
            label=f"{kind} " + " ".join(f"{name}={value:g}" for name, value in conditions),
            kind=kind,
            frames=tuple(relative(path, out) for path in members),
        )
        for conditions, members in sorted(groups.items())
    )


def name_expression(pattern: str) -> re.Pattern[str]:
    """Return the regular expression of a name pattern; an unknown condition is a BadInput."""
    known = [item.name for item in fields(Conditions) if item.name not in SWITCHES]
    parts = re.split(r"(\{[^{}]*\}|\*)", pattern)
    names = [part[1:-1] for part in parts if part.startswith("{")]
    if unknown := [name for name in names if name not in known]:
        raise BadInput(f"a name in the braces of a pattern must be one of {', '.join(known)}, got {unknown[0]!r}")
    if not names or len(set(names)) < len(names):
        raise BadInput(f"a pattern must name one condition or more, each once, in braces, got {pattern!r}")
    return re.compile("".join(_expression(part) for part in parts))


def _expression(part: str) -> str:
    if part == "*":
        return ".*?"
    return f"(?P<{part[1:-1]}>{NUMBER})" if part.startswith("{") else re.escape(part)
