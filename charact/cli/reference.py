"""The verbs `methods`, `schema`, `chart` and `stability`: reference tables and studies of the methods."""

import json
from pathlib import Path
from typing import Annotated

import typer

from charact.cli import options
from charact.cli.output import exit_on_bad_input, progress_bar


def methods(as_json: options.Json = False) -> None:
    """List the registered methods with scope, measured error and computing time.

    Example: charact methods
    """
    from charact.method.registry import MODULES, chart_table, methods_of_kind
    from charact.method.stopwatch import time_text

    rows = []
    for method in (method for kind in MODULES for method in methods_of_kind(kind).values()):
        charted = [r for q in method.quantities for r in chart_table(q) if r["method"] == method.name]
        measured = {key: charted[0][key] for key in ("error_percent", "seconds")} if charted else {}
        rows.append(
            {
                "kind": method.kind,
                "name": method.name,
                "quantities": method.quantities,
                "scope": method.scope,
                **measured,
            }
        )
    if as_json:
        print(json.dumps({"methods": rows}))
        return
    for row in rows:
        cost = f"{row['error_percent']:.3g} % in {time_text(row['seconds'])}" if "seconds" in row else "not charted"
        print(f"{row['kind']:6} {row['name']:16} {cost:22} {', '.join(row['quantities'])}\n{'':24}{row['scope']}")


def schema(
    kind: Annotated[str, typer.Argument(help="session, sensor, solid-state, plan, scene (outdoor) or bench.")],
) -> None:
    """Print the JSON Schema of a file format, for editors.

    Example: charact schema plan > plan.schema.json
    """
    with exit_on_bad_input(kind):
        from labdata.serialiser import file_schema
        from simulate.radiance.outdoor.scene import OutdoorScene
        from simulate.radiance.scene import LabScene

        found = file_schema(kind, {"scene": OutdoorScene, "bench": LabScene})
        if kind == "scene":
            # The folder is not part of the file.
            del found["properties"]["folder"]
        print(json.dumps(found, indent=2))


Name = Annotated[str, typer.Argument(help="Quantity, such as mtf50.")]
Out = Annotated[Path, typer.Option(help="Folder for the table and the figure.")]
Quick = Annotated[bool, typer.Option("--quick", help="Reduced run: fewer cases, no Markov chains.")]


def chart(
    quantity: Name,
    out: Out = Path("study"),
    update: Annotated[bool, typer.Option("--update", help="Also update the table used by auto.")] = False,
    quick: Quick = False,
    seed: options.Seed = 0,
    events: options.Events = False,
) -> None:
    """Measure error against computing time of every method of a quantity on common cases.

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
    """Map error, refusals, flags and silent failures of every method beyond its breaking point.

    Example: charact stability mtf50 --out study
    """
    with exit_on_bad_input(quantity, events=events), progress_bar(events=events) as progress:
        from charact import study

        print(study.stability(quantity, seed=seed, out=out, quick=quick, progress=progress).text())
