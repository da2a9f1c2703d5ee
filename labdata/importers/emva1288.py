"""EMVA 1288 descriptor files: a session from a photon-transfer series."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.file_io import require_regular, write_atomically
from labdata.file_records import SessionFile, StackRecord, stack_record
from labdata.serialiser import from_mapping, to_mapping, to_toml
from labdata.session import MANIFEST, Kind, Session, session_of

KINDS: dict[str, Kind] = {"b": "flat", "d": "dark"}


@dataclass(frozen=True, kw_only=True)
class DescriptorBlock:
    """One block of the descriptor: a bright or dark exposure and its images."""

    kind: Kind  # "flat" for bright, "dark" for dark
    exposure_ns: float  # Exposure, ns
    photons_per_px: float | None  # Mean number of photons per pixel and exposure; None for darks
    # Paths of the images relative to the descriptor: two are a temporal pair, more a spatial series
    images: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Descriptor:
    """Content of a descriptor file."""

    version: str  # Release of the standard
    bit_depth: int  # Bits of the digitiser
    columns: int  # Size of an image, px
    rows: int  # Size of an image, px
    levels: tuple[DescriptorBlock, ...]  # The blocks in order


def import_emva1288(file: str | Path, out: str | Path) -> Session:
    """Make a session that refers to the images of an EMVA 1288 descriptor file.

    The descriptor has the lines `v` version, `n` bits width height, `b` exposure photons, `d` exposure (ns), `i` image.
    One that breaks its format, lacks an image, or a folder with a session is BadInput.
    """
    file, out = Path(file), Path(out)
    descriptor = read_descriptor(file)
    _check_size(descriptor, file)
    stacks = tuple(_stack(number, level, file, out) for number, level in enumerate(descriptor.levels))
    form = SessionFile(
        name=f"EMVA 1288 series {file.resolve().parent.name}",
        bit_depth=descriptor.bit_depth,
        interlaced=False,
        notes=(f"imported from an EMVA 1288 descriptor of version {descriptor.version}",),
        stack=stacks,
    )
    return write_session(form, out)


def write_session(form: SessionFile, out: Path) -> Session:
    """Check a new session, write its manifest and return it."""
    if (out / MANIFEST).exists():
        raise BadInput(f"a new session needs a folder without one, got {out}")
    form = from_mapping(to_mapping(form), SessionFile, where=MANIFEST)
    try:
        out.mkdir(parents=True, exist_ok=True)
        session = session_of(out, form)
        write_atomically(out / MANIFEST, to_toml(form).encode())
    except OSError as error:
        raise BadInput(f"a session must be a folder that can be written, got {out}: {error.strerror}") from None
    return session


def relative(path: Path, folder: Path) -> str:
    """Return a path for the manifest of a folder: relative inside the parent folder, absolute elsewhere."""
    path, folder = path.resolve(), folder.resolve()
    near = os.path.relpath(path, folder)
    return near if path.is_relative_to(folder.parent) else str(path)


def read_descriptor(file: str | Path) -> Descriptor:
    """Read an EMVA 1288 descriptor file."""
    file = Path(file)
    require_regular(file, "a descriptor file")
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        raise BadInput(f"a descriptor file must be a text file, got {file}") from None
    lines = [(number, line.split()) for number, line in enumerate(text.splitlines(), 1)]
    return _descriptor([(n, words) for n, words in lines if words and not words[0].startswith("#")], file)


def _descriptor(lines: Sequence[tuple[int, list[str]]], file: Path) -> Descriptor:
    version, size, levels = "unknown", None, []
    for number, (key, *values) in lines:
        try:
            if key == "v":
                version = values[0]
            elif key == "n":
                size = tuple(int(value) for value in values[:3])
            elif key in KINDS:
                levels.append(_level(key, values))
            elif key == "i":
                levels[-1] = _with_image(levels[-1], " ".join(values))
            else:
                raise ValueError
        except (ValueError, IndexError):
            raise BadInput(
                f"a line of an EMVA 1288 descriptor must be v, n, b, d or i with its values, "
                f"got {' '.join((key, *values))!r} in line {number} of {file.name}"
            ) from None
    if size is None or len(size) < 3 or not levels:
        raise BadInput(f"an EMVA 1288 descriptor must hold a line n and at least one of b or d, got {file}")
    return Descriptor(version=version, bit_depth=size[0], columns=size[1], rows=size[2], levels=tuple(levels))


def _level(key: str, values: Sequence[str]) -> DescriptorBlock:
    photons = float(values[1]) if key == "b" else None
    return DescriptorBlock(kind=KINDS[key], exposure_ns=float(values[0]), photons_per_px=photons, images=())


def _with_image(level: DescriptorBlock, image: str) -> DescriptorBlock:
    # Descriptors written on Windows have backslashes.
    name = image.replace("\\", "/")
    if not name or "\0" in name:
        raise ValueError
    return DescriptorBlock(
        kind=level.kind,
        exposure_ns=level.exposure_ns,
        photons_per_px=level.photons_per_px,
        images=(*level.images, name),
    )


def _check_size(descriptor: Descriptor, file: Path) -> None:
    """Require the size of the first image to match the descriptor."""
    from labdata.importers import read_frames

    for image in descriptor.levels[0].images[:1]:
        _, rows, columns = read_frames(file.parent / image).shape
        if (columns, rows) != (descriptor.columns, descriptor.rows):
            raise BadInput(
                f"images must be the {descriptor.columns}x{descriptor.rows} px of {file.name}, "
                f"got {columns}x{rows} px in {image}"
            )


def _stack(number: int, level: DescriptorBlock, file: Path, out: Path) -> StackRecord:
    if len(level.images) < 2:
        raise BadInput(
            f"every exposure of an EMVA 1288 descriptor must have two images or more, "
            f"got {len(level.images)} at {level.exposure_ns:g} ns in {file.name}"
        )
    spatial = "-spatial" if len(level.images) > 2 else ""
    return stack_record(
        Conditions(exposure_s=level.exposure_ns * 1e-9, photons_per_px=level.photons_per_px),
        label=f"{level.kind}-{number:03d}{spatial}",
        kind=level.kind,
        frames=tuple(relative(file.parent / image, out) for image in level.images),
    )
