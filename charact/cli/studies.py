"""The verbs `chart` and `stability`: speed against accuracy, and where methods fail."""

from pathlib import Path
from typing import Annotated

import typer

from charact.cli import options
from charact.cli.output import exit_on_bad_input
from charact.cli.progress import progress_bar

Name = Annotated[str, typer.Argument(help="Quantity, such as mtf50.")]
Out = Annotated[Path, typer.Option(help="Folder for the table and the figure.")]
Quick = Annotated[bool, typer.Option("--quick", help="A few cases only; enough to see that it works.")]


def add_to(app: typer.Typer) -> None:
    """Add the verbs to the command."""
    app.command()(chart)
    app.command()(stability)


def chart(
    quantity: Name,
    out: Out = Path("study"),
    update: Annotated[bool, typer.Option("--update", help="Also rewrite the table that auto chooses by.")] = False,
    quick: Quick = False,
    seed: options.Seed = 0,
    events: options.Events = False,
) -> None:
    """Error against time of every method of a quantity, measured on the same cases.

    Example: charact chart mtf50 --out study
    """
    with exit_on_bad_input(quantity, events=events), progress_bar(events=events) as progress:
        from charact import study

        print(study.chart(quantity, seed=seed, out=out, quick=quick, update=update, progress=progress).text())


def stability(
    quantity: Name,
    out: Out = Path("study"),
    quick: Quick = False,
    seed: options.Seed = 0,
    events: options.Events = False,
) -> None:
    """Error, refusals, flags and silent failures of every method, swept past the breaking point.

    Example: charact stability mtf50 --out study
    """
    with exit_on_bad_input(quantity, events=events), progress_bar(events=events) as progress:
        from charact import study

        print(study.stability(quantity, seed=seed, out=out, quick=quick, progress=progress).text())
