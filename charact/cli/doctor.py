"""The verb `doctor`: what the bench needs of this machine, each line ok or the fix."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from charact import __version__
from charact.cli import options
from charact.cli.output import exit_on_bad_input


def add_to(app: typer.Typer) -> None:
    """Add the verb to the command."""
    app.command()(doctor)


def doctor(
    folder: Annotated[Path, typer.Argument(help="Folder that sessions are to be written to.")] = Path(),
    as_json: options.Json = False,
) -> None:
    """Versions, disk, cameras, ports, permissions and network: ok, or the fix.

    Nothing is set and no instrument is spoken to. Exit 0 if the core can work, even without any camera.

    Example: charact doctor /data
    """
    with exit_on_bad_input(str(folder), as_json=as_json):
        from charact.live.doctor import can_work, examine

        found = []
        for one in examine(folder):
            found.append(one)
            if not as_json:
                mark = "ok " if one.ok else "FIX"
                print(f"{mark}  {one.area:14} {one.says}" + ("" if one.ok else f"\n{'':19} -> {one.fix}"), flush=True)
        works = can_work(tuple(found))
        if as_json:
            told = [{**vars(one), "ok": one.ok} for one in found]
            print(json.dumps({"charact": __version__, "core_can_work": works, "findings": told}))
        elif works:
            print(f"\nThe core can work; {sum(not one.ok for one in found)} things may want a fix.")
        if not works:
            lacking = next(one for one in found if one.core and not one.ok)
            print(f"charact: the core cannot work: {lacking.says}", file=sys.stderr)
            raise typer.Exit(1)
