"""The verbs `import emva1288|frames`: sessions from existing frames."""

from pathlib import Path
from typing import Annotated

import typer

from charact.cli.options import Axis, Plane, parse_kind
from charact.cli.output import exit_on_bad_input

app = typer.Typer(no_args_is_help=True, help="Create a session from existing frames.")

Out = Annotated[Path, typer.Argument(help="Output session folder.")]

NO_KIND_HINT = "set the kind of the stacks in {}/session.toml, or import with --kind: scene stacks are not measured"


@app.command()
def emva1288(file: Annotated[Path, typer.Argument(help="EMVA 1288 descriptor file.")], out: Out) -> None:
    """Import a photon-transfer series from an EMVA 1288 descriptor file.

    Example: charact import emva1288 EMVA1288_Data.txt ccd12
    """
    with exit_on_bad_input(str(file)):
        from labdata.importers.sessions import import_emva1288

        _summarise(import_emva1288(file, out), out, f"charact noise {out}")


@app.command()
def frames(
    files: Annotated[list[Path], typer.Argument(help="Frames, then the session's folder: FILES... OUT")],
    kind: Annotated[str, typer.Option(help="Kind of the stacks: dark, flat, edge, bars, point or scene.")] = "scene",
    name: Annotated[
        str | None, typer.Option(help="Pattern of conditions in the file names, e.g. '{mcp_v}V_{gate_ns}ns_*'.")
    ] = None,
    axis: Axis = None,
    plane: Plane = None,
) -> None:
    """Import image files as stacks, one stack per file.

    Example: charact import frames 780V_*.tif mine --kind flat --name '{mcp_v}V_*'
    """
    *sources, out = files
    with exit_on_bad_input(" ".join(map(str, sources))):
        from labdata.errors import BadInput
        from labdata.importers.sessions import import_frames

        if not sources:
            raise BadInput(f"import frames needs at least one file and the folder of the session, got only {out}")
        session = import_frames(sources, out, kind=parse_kind(kind), name_pattern=name, axis=axis, plane=plane)
        _summarise(session, out, NO_KIND_HINT.format(out) if kind == "scene" else f"charact measure {out}")


def _summarise(session, out: Path, next_verb: str) -> None:
    kinds: dict[str, int] = {}
    for stack in session.stacks:
        kinds[stack.kind] = kinds.get(stack.kind, 0) + 1
    print(f"{out}: {len(session.stacks)} stacks ({', '.join(f'{count} {kind}' for kind, count in kinds.items())})")
    unknown = sorted({name for s in session.stacks for name, value in vars(s.conditions).items() if value is None})
    if unknown:
        print(f"conditions unknown for some stacks: {', '.join(unknown)}")
    for note in session.notes:
        print(f"note: {note}")
    print(f"Next: {next_verb}")
