"""The verbs `doctor` and `conform`, which check the machine and the drivers."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from charact import __version__
from charact.cli import options
from charact.cli.output import exit_on_bad_input


def doctor(
    folder: Annotated[Path, typer.Argument(help="Folder for sessions.")] = Path(),
    as_json: options.Json = False,
) -> None:
    """Check versions, disk, cameras, ports, permissions and network; report ok or how to fix it.

    Changes nothing and contacts no instrument. Exit 0 if the core works, even without a camera.

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
            findings = [{**vars(one), "ok": one.ok} for one in found]
            print(json.dumps({"charact": __version__, "core_can_work": works, "findings": findings}))
        elif works:
            print(f"\nThe core works; {sum(not one.ok for one in found)} other findings have a fix.")
        if not works:
            lacking = next(one for one in found if one.core and not one.ok)
            print(f"charact: the core does not work: {lacking.says}", file=sys.stderr)
            raise typer.Exit(1)


def conform(
    names: Annotated[list[str] | None, typer.Argument(help="Models, such as dg645 (default: all).")] = None,
) -> None:
    """Run the conformance tests of drivers against their virtual instruments.

    Exit 1 if a rule is broken. Models of other packages are found by their entry points.

    Example: charact conform iseg
    """
    with exit_on_bad_input("conform"):
        from drivers.instruments.models import models
        from labdata.errors import BadInput

        broken = sum(_check_model(name) for name in names or models())
        if broken:
            raise BadInput(f"all conformance rules must be kept, got {broken} broken")


def _check_model(name: str) -> int:
    """Check one model, print each rule, and return the number of broken rules."""
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
            except Exception as error:  # a driver under test may raise anything
                broken += 1
                print(f"  BROKEN  {said} {rule.__name__}: {error!r}")
                pair.heal()
    return broken
