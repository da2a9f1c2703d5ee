"""The verbs `methods` and `schema`: what there is to choose from, and the file formats for editors."""

import json
from typing import Annotated

import typer

from charact.cli import options
from charact.cli.output import exit_on_bad_input


def add_to(app: typer.Typer) -> None:
    """Add the verbs to the command."""
    app.command()(methods)
    app.command()(schema)


def methods(as_json: options.Json = False) -> None:
    """Every registered method: what it measures, where it holds, its measured error and time.

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
    kind: Annotated[str, typer.Argument(help="session, sensor, solid-state, plan, scene (out of doors) or bench.")],
) -> None:
    """JSON Schema of a file format, for completion and checking in editors.

    Example: charact schema plan > plan.schema.json
    """
    with exit_on_bad_input(kind):
        from labdata.serialiser import file_schema
        from simulate.radiance.outdoor.scene import OutdoorScene
        from simulate.radiance.scene import LabScene

        found = file_schema(kind, {"scene": OutdoorScene, "bench": LabScene})
        if kind == "scene":
            # Where the file lies is no part of it.
            del found["properties"]["folder"]
        print(json.dumps(found, indent=2))
