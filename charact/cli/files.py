"""The verbs `import`, `convert` and `view`: frames of other programs as sessions, sessions as
files, and pictures.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from charact.cli.options import in_options
from charact.cli.output import exit_on_bad_input
from charact.cli.outputs import (
    Force,
    manifest_to_replace,
    require_free,
    require_free_session,
    why_other_kind,
)
from charact.cli.sessions import session_in
from labdata import BadInput, Kind
from labdata.file_io import require_folder_of
from labdata.settings import Extension, FrameAxis, Partial, Plane

if TYPE_CHECKING:
    from charact.frames.layout import Layout
    from labdata import FrameStack, Session

# Label, reader and files of a stack.
Readable = tuple[str, Callable[[], "FrameStack"], tuple[Path, ...]]
import_app = typer.Typer(no_args_is_help=True, help="Create a session from existing frames.")
Out = Annotated[Path, typer.Argument(help="Output session folder.")]

NO_KIND_HINT = (
    "set the kind of the stacks in {}/session.toml, or import with --kind: scene "
    "stacks are not measured"
)

# Kinds of stacks, conditions of which measurements use one, and what for; those of a bench matter
# to its owner alone.
NEEDED: tuple[tuple[tuple[Kind, ...], tuple[str, ...], str], ...] = (
    (("dark", "flat"), ("exposure_s",), "dark current"),
    (("flat",), ("illuminance_lux", "photons_per_px"), "sensitivity, linearity"),
    (("dark",), ("temperature_c",), "dark current at 25 °C"),
)


@import_app.command()
def emva1288(
    file: Annotated[Path, typer.Argument(help="EMVA 1288 descriptor file.")],
    out: Out,
    force: Force = False,
) -> None:
    """Import a photon-transfer series from an EMVA 1288 descriptor file.

    Example: charact import emva1288 EMVA1288_Data.txt ccd12
    """
    with exit_on_bad_input(str(file)):
        require_free_session(out, "import", force=force)
        from labdata.session_import import import_emva1288

        with manifest_to_replace(out):
            session = import_emva1288(file, out)
        _summarise(session, out, f"charact noise {out}")


@import_app.command()
def frames(
    files: Annotated[
        list[Path], typer.Argument(help="Frames, then the session's folder: FILES... OUT")
    ],
    kind: Annotated[
        str | None,
        typer.Option(
            help=(
                "Kind of the stacks: dark, flat, edge, bars, point or scene (default: by FITS "
                "headers, else scene)."
            )
        ),
    ] = None,
    name_pattern: Annotated[
        str | None,
        typer.Option(
            "--name", help="Pattern of conditions in the file names, e.g. '{mcp_v}V_{gate_ns}ns_*'."
        ),
    ] = None,
    label: Annotated[
        str | None,
        typer.Option("--stack", help="Label of one stack that has all files as its frames."),
    ] = None,
    axis: FrameAxis = None,
    plane: Plane = None,
    extension: Extension = None,
    partial: Partial = False,
    add: Annotated[
        bool, typer.Option("--add", help="Add the stacks to a session that exists.")
    ] = False,
    force: Force = False,
) -> None:
    """Import image files as stacks: one a file; FITS files of one frame are grouped by what their
    headers state.

    Example: charact import frames 780V_*.tif mine --kind flat --name '{mcp_v}V_*'

    Example: charact import frames bias*.tif mine --kind dark --stack bias --add
    """
    *sources, out = files
    with exit_on_bad_input(" ".join(map(str, sources))):
        if not sources:
            raise BadInput(
                "import frames needs at least one file and the folder of the session, got only "
                f"{out}"
            )
        if add and force:
            raise BadInput(
                "--add keeps the session that is there, --force replaces it: give one of them"
            )
        if not add:
            require_free_session(out, "import", force=force)
        from labdata.session_import import import_frames
        from labdata.target import kind_of

        with nullcontext() if add else manifest_to_replace(out):
            session = import_frames(
                sources,
                out,
                kind=None if kind is None else kind_of(kind),
                name_pattern=name_pattern,
                label=label,
                # Options are texts.
                axis=cast("str | None", axis),
                plane=cast("str | None", plane),
                extension=cast("str | None", extension),
                partial=partial,
                add=add,
            )
        measurable = any(entry.kind != "scene" for entry in session.stacks)
        _summarise(
            session, out, f"charact measure {out}" if measurable else NO_KIND_HINT.format(out)
        )


def _summarise(session: "Session", out: Path, next_verb: str) -> None:
    counts = Counter(stack.kind for stack in session.stacks)
    number, kinds = (
        len(session.stacks),
        ", ".join(f"{count} {kind}" for kind, count in counts.items()),
    )
    print(f"{out}: {number} stack{'s' if number != 1 else ''} ({kinds})")
    unknown = [
        f"{' or '.join(names)} ({use})"
        for kinds, names, use in NEEDED
        if any(
            all(getattr(entry.conditions, name) is None for name in names)
            for entry in session.of_kind(*kinds)
        )
    ]
    if unknown:
        print(f"unknown for some stacks: {'; '.join(unknown)}")
    _print_notes(session.notes)
    print(f"Next: {next_verb}")


def _print_notes(notes: Sequence[str]) -> None:
    for note in notes:
        print(f"note: {in_options(note)}")


# Beginnings of the files of results.
BEGINNINGS = {"csv": b"file,", "json": b'{"charact":', "emva": b"<EMVA1288 "}
PAGES = {".html": b"<!DOCTYPE html>", ".pdf": b"%PDF-"}
FORMATS = ("tif", "npy", "fits", "h5", "png", *BEGINNINGS)
Source = Annotated[
    str,
    typer.Argument(
        help="File of frames, session or demonstration folder, or SESSION#LABEL for one stack."
    ),
]


def view(
    source: Source,
    out: Annotated[
        Path | None,
        typer.Option(help="Output PNG file (default: LABEL-view.png in the working folder)."),
    ] = None,
    plane: Plane = None,
    axis: FrameAxis = None,
    extension: Extension = None,
    partial: Partial = False,
    layout: Annotated[
        bool,
        typer.Option(
            "--layout", help="Outline unexposed strips, amplifiers and lost rows, and print them."
        ),
    ] = False,
) -> None:
    """Write the mean frame of a stack as a PNG picture and print its path and levels.

    Example: charact view my-edge.tif

    Example: charact view day1#flat-3 --layout --out flat.png
    """
    with exit_on_bad_input(source):
        from charact.reporting.annotated_image import write_layout_image
        from labdata.frame_export import write_frames

        reading = {"plane": plane, "axis": axis, "extension": extension, "partial": partial}
        for label, read, _ in _stacks(source, **reading):
            path = out or Path(f"{label}-view.png")
            if path.suffix.lower() != ".png":
                raise BadInput(f"a picture must be a .png file, got {path.name!r}")
            require_folder_of(path)
            if path.exists() and path.samefile(source.partition("#")[0]):
                raise BadInput(f"a picture must not replace its own frames, got {path}")
            stack = read()
            if layout:
                shown = _layout_of(source, label, stack)
                write_layout_image(stack, shown.areas, path)
                notes = [part.note for part in shown.parts]
                print("\n".join(notes) or "one exposed area of one amplifier")
            else:
                write_frames(stack, path)
            frames, rows, cols = stack.shape
            low, high = stack.data.min(), stack.data.max()
            print(
                f"{path}: mean of {frames} frames of {rows} x {cols} px, {low:g} to {high:g} "
                f"{stack.unit}"
            )
            _print_notes(stack.notes)
            if out is not None:
                return


def _layout_of(source: str, label: str, stack: "FrameStack") -> "Layout":
    """Return the layout that darks and flats of a session show, else that of the stack."""
    from charact.frames import Stack
    from charact.frames.session_layout import sound_session
    from labdata import MANIFEST, open_session

    path = session_in(Path(source.partition("#")[0]))
    session = open_session(path) if (path / MANIFEST).is_file() else None
    of_chip = session is not None and session.stack(label).kind in ("dark", "flat")
    shown = sound_session(session)[0] if session is not None and of_chip else None
    return Stack(frames=stack).layout if shown is None else shown


def convert(
    source: Source,
    out: Annotated[
        Path, typer.Argument(help="Output folder; for csv, json and emva the output file.")
    ],
    to: Annotated[str, typer.Option("--to", help=f"Format: {', '.join(FORMATS)}.")] = "tif",
    plane: Plane = None,
    axis: FrameAxis = None,
    extension: Extension = None,
    partial: Partial = False,
    maps: Annotated[
        bool,
        typer.Option(
            "--maps",
            help="Write the maps of the specimen that a fit measured: SOURCE is the session with "
            "its fitted.toml, or the file of a fitted sensor.",
        ),
    ] = False,
    force: Force = False,
) -> None:
    """Write the frames of a session as files (tif, npy, fits, h5, png), its results as CSV, JSON or
    an EMVA 1288 data sheet (.xml, .html or .pdf), or the maps of its camera.

    Example: charact convert day1 day1-fits --to fits

    Example: charact convert day1 day1-maps --maps --to fits

    Example: charact convert ccd12 sheet.pdf --to emva
    """
    with exit_on_bad_input(source):
        if to not in FORMATS:
            raise BadInput(f"--to must be one of {', '.join(FORMATS)}, got {to!r}")
        if to in BEGINNINGS:
            beginning = PAGES.get(out.suffix, BEGINNINGS[to]) if to == "emva" else BEGINNINGS[to]
            require_free(out, force=force, kept=lambda: why_other_kind(out, beginning))
            _write_results(session_in(Path(source)), out, to)
            return
        from labdata.frame_export import write_frames

        reading = {"plane": plane, "axis": axis, "extension": extension, "partial": partial}
        stacks = _maps_of(Path(source)) if maps else _stacks(source, **reading)
        paths = [out / f"{label}.{to}" for label, _, _ in stacks]
        existing = {path.resolve() for path in paths if path.exists()}
        replaced = existing & {path.resolve() for _, _, sources in stacks for path in sources}
        obstacle = (
            "the folder of its own frames" if replaced else "a file" if out.is_file() else None
        )
        require_free(out, force=force, taken=bool(existing) or out.is_file(), kept=lambda: obstacle)
        for path, (_, read, _) in zip(paths, stacks, strict=True):
            stack = read()
            out.mkdir(parents=True, exist_ok=True)
            print(write_frames(stack, path))
            _print_notes(stack.notes)


def _maps_of(source: Path) -> "list[Readable]":
    """Return name and reader of each map of a fitted sensor and its standard deviation."""
    from charact.api.modelling import FITTED
    from labdata import FrameStack, load_camera
    from labdata.camera.maps import UNITS

    file = source / FITTED if source.is_dir() else source
    measured = load_camera(file).maps
    if measured is None:
        raise BadInput(
            f"--maps needs a fitted sensor with maps of its specimen, got none next to {file}: "
            f"charact fit SESSION --sensor-out {file} measures those that the frames support"
        )
    planes = measured.planes()
    units = {name: UNITS.get(name.removesuffix("_sd"), "1") for name in planes}
    return [
        (name, lambda plane=plane, unit=units[name]: FrameStack(data=plane[None], unit=unit), ())
        for name, plane in planes.items()
    ]


def _write_results(folder: Path, out: Path, to: str) -> None:
    from charact.reporting import exports
    from labdata import open_session, result_io, write_atomically

    session = open_session(folder)
    result = result_io.load(session.folder)
    if result is None:
        raise BadInput(
            f"{to} needs the results of a session, got none in {folder}: run charact measure "
            f"{folder}"
        )
    if to == "emva":
        from charact.reporting.emva_page import write_sheet

        write_sheet(session, result, out)
    else:
        text = (
            exports.table_of_files({session.name: result})
            if to == "csv"
            else exports.as_json(result, str(folder))
        )
        write_atomically(out, text.encode())
    print(out)


def _stacks(source: str, **reading: Any) -> "list[Readable]":
    """Return label, reader and files of a file, of one stack of a session, or of all its stacks.

    `reading`: settings of `labdata.read_frames`, which a session has of its own.
    """
    from labdata import MANIFEST, open_session, read_frames

    path, _, label = source.partition("#")
    path = session_in(Path(path))
    if not (path / MANIFEST).is_file():
        return [(Path(source).stem, lambda: read_frames(source, **reading), (path,))]
    if set_ones := [f"`{name}`" for name, value in reading.items() if value]:
        raise BadInput(
            f"{set_ones[0]} is of a file of frames; the stacks of {path}/{MANIFEST} state their own"
        )
    session = open_session(path)
    entries = session.stacks if not label else (session.stack(label),)
    return [(entry.label, entry.read, entry.paths) for entry in entries]
