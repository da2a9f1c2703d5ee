"""The verb `demo`: the whole loop on the virtual bench."""

from pathlib import Path
from typing import Annotated

import typer

from charact.cli import options
from charact.cli.output import exit_on_bad_input


def add_to(app: typer.Typer) -> None:
    """Add the verb to the command."""
    app.command()(demo)


def demo(
    out: Annotated[Path, typer.Argument(help="Folder for the session, the fitted sensor and the report.")] = Path(
        "demo"
    ),
    quick: Annotated[bool, typer.Option("--quick", help="Fewer frames and no Markov chains.")] = False,
    seed: Annotated[
        int | None, typer.Option(help="Seed of the specimen and of all noise; else from the clock.", min=0)
    ] = None,
    events: options.Events = False,
) -> None:
    """The whole loop on the virtual bench: acquire, characterize, fit, simulate, validate, report.

    Example: charact demo
    """
    with exit_on_bad_input(str(out), events=events):
        from charact.cli.demo_loop import demonstrate

        if not demonstrate(out, quick=quick, seed=seed, events=events):
            raise typer.Exit(1)
