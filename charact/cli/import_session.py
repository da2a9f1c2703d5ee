"""The verbs `import emva1288|frames`: a session of frames made elsewhere."""

from pathlib import Path
from typing import Annotated

import typer

from charact.cli.options import Axis, Plane, parse_kind
from charact.cli.output import exit_on_bad_input

app = typer.Typer(no_args_is_help=True, help="Make a session of frames made elsewhere.")

Out = Annotated[Path, typer.Argument(help="Folder of the session to make.")]

UNSAID = "say in {}/session.toml what the frames show, or import them with --kind: nothing is measured of a scene"


@app.command()
def emva1288(file: Annotated[Path, typer.Argument(help="EMVA 1288 descriptor file.")], out: Out) -> None:
    """A photon-transfer series from its EMVA 1288 descriptor.

    Example: charact import emva1288 EMVA1288_Data.txt ccd12
    """
    with exit_on_bad_input(str(file)):
        from labdata.importers.emva1288 import import_emva1288

        _summarise(import_emva1288(file, out), out, f"charact noise {out}")


@app.command()
def frames(
    files: Annotated[list[Path], typer.Argument(help="Frames, then the session's folder: FILES... OUT")],
    kind: Annotated[str, typer.Option(help="What they show: dark, flat, edge, bars, point or scene.")] = "scene",
    name: Annotated[
        str | None, typer.Option(help="Conditions in the file names, such as '{mcp_v}V_{gate_ns}ns_*'.")
    ] = None,
    axis: Axis = None,
    plane: Plane = None,
) -> None:
    """Frames in files of known kinds, one stack a file.

    Example: charact import frames 780V_*.tif mine --kind flat --name '{mcp_v}V_*'
    """
    *sources, out = files
    with exit_on_bad_input(" ".join(map(str, sources))):
        from labdata.errors import BadInput
        from labdata.importers.frame_files import import_frames

        if not sources:
            raise BadInput(f"import frames needs at least one file and the folder of the session, got only {out}")
        session = import_frames(sources, out, kind=parse_kind(kind), name_pattern=name, axis=axis, plane=plane)
        _summarise(session, out, UNSAID.format(out) if kind == "scene" else f"charact measure {out}")


def _summarise(session, out: Path, next_verb: str) -> None:
    kinds: dict[str, int] = {}
    for stack in session.stacks:
        kinds[stack.kind] = kinds.get(stack.kind, 0) + 1
    print(f"{out}: {len(session.stacks)} stacks ({', '.join(f'{count} {kind}' for kind, count in kinds.items())})")
    unknown = sorted({name for s in session.stacks for name, value in vars(s.conditions).items() if value is None})
    if unknown:
        print(f"conditions not known for every stack: {', '.join(unknown)}")
    for note in session.notes:
        print(f"note: {note}")
    print(f"Next: {next_verb}")
