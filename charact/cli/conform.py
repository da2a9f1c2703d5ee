"""The verb `conform`: a driver and its virtual instrument are tried against the rules that all of them keep."""

from typing import Annotated

import typer

from charact.cli.output import exit_on_bad_input


def add_to(app: typer.Typer) -> None:
    """Add the verb to the command."""
    app.command()(conform)


def conform(
    names: Annotated[list[str] | None, typer.Argument(help="Models, such as dg645; all where none is named.")] = None,
) -> None:
    """Try drivers on their virtual instruments, rule by rule, over pseudo-terminals.

    Exit 1 if a rule is broken. Models of other packages are found by their entry points.

    Example: charact conform iseg
    """
    with exit_on_bad_input("conform"):
        from drivers.instruments.models import models
        from labdata.errors import BadInput

        broken = sum(_check_model(name) for name in names or models())
        if broken:
            raise BadInput(f"every rule must be kept, got {broken} broken")


def _check_model(name: str) -> int:
    """Try one model, print each rule, and return how many it broke."""
    import tempfile
    from pathlib import Path

    from charact.cli.virtual_pair import VirtualPair
    from drivers.instruments.conformance import rules_for

    broken = 0
    with tempfile.TemporaryDirectory() as folder, VirtualPair(name, Path(folder)) as pair:
        rules = rules_for(pair.model)
        print(f"{name} ({pair.model.role}), {len(rules)} rules:")
        for rule in rules:
            said = (rule.__doc__ or rule.__name__).strip().splitlines()[0]
            try:
                rule(pair)
                print(f"  kept    {said}")
            except Exception as error:  # whatever a driver raises wrongly is what the trial is for
                broken += 1
                print(f"  BROKEN  {said} {rule.__name__}: {error!r}")
                pair.heal()
    return broken
