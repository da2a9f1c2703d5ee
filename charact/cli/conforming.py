"""The verb `conform`: a driver and its virtual instrument are tried against the rules that all of them keep."""

from typing import Annotated

import typer

from charact.cli.output import bad_input_ends


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
    with bad_input_ends("conform"):
        from drivers.instruments.models import models
        from labdata.errors import BadInput

        broken = sum(_tried(name) for name in names or models())
        if broken:
            raise BadInput(f"every rule must be kept, got {broken} broken")


def _tried(name: str) -> int:
    """Try one model, print its tally, and return how many rules it broke."""
    import tempfile
    from pathlib import Path

    from charact.cli.virtual_pair import VirtualPair
    from drivers.instruments.conformance import rules_for

    broken = []
    with tempfile.TemporaryDirectory() as folder, VirtualPair(name, Path(folder)) as pair:
        rules = rules_for(pair.model)
        for rule in rules:
            try:
                rule(pair)
            except Exception as error:  # whatever a driver raises wrongly is what the trial is for
                broken.append(f"  {rule.__name__}: {error!r}")
                pair.heal()
    print(f"{name} ({pair.model.role}): {len(rules) - len(broken)} of {len(rules)} rules kept", *broken, sep="\n")
    return len(broken)
