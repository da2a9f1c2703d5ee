"""Many sessions given to one verb: each gets what it would get alone, whatever becomes of the others."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import typer

from charact.cli.output import print_message


def each(folders: Sequence[Path], one: Callable[[Path], None], *, as_json: bool, events: bool) -> None:
    """Do one thing with every session; those that gave no number are named last, with exit code 1.

    Parameters
    ----------
    folders
        The sessions; a single one is treated as if nobody had asked for many.
    one
        Measures and prints one session; ends by `typer.Exit` with code 1 where there is no number.
    as_json, events
        As the verb was asked: without JSON each session's folder stands above its lines.
    """
    if len(folders) == 1:
        one(folders[0])
        return
    failed = []
    for folder in folders:
        if not as_json:
            print(f"{folder}:")
        try:
            one(folder)
        except typer.Exit as end:
            if end.exit_code != 1:
                raise
            failed.append(str(folder))
        sys.stdout.flush()
    if failed:
        print_message(f"{len(failed)} of {len(folders)} sessions gave no number: {', '.join(failed)}", events=events)
        raise typer.Exit(1)
