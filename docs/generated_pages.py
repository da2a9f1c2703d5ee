"""Pages of the reference that are written from the code: command line, methods, file schemas,
measured tables.
"""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

SCHEMAS = {
    "session": "`session.toml`: the stacks of a session and their conditions",
    "sensor": "description of an intensified camera",
    "solid-state": "description of a camera without a tube",
    "infrared": "description of an infrared imager",
    "plan": "acquisition plan",
    "scene": "outdoor scene",
    "bench": "target of the lab bench",
    "limits": "limits that a session is checked against",
}

RESULTS = ("ok", "suspect", "refused", "missed", "silent")


def write_pages(folder: Path) -> None:
    """Write all generated pages into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    pages = {
        "command-line": command_line(),
        "methods": methods(),
        "file-schemas": file_schemas(),
        "measured-tables": measured_tables(),
    }
    for name, text in pages.items():
        path = folder / f"{name}.md"
        if not path.exists() or path.read_text() != text:
            path.write_text(text)


def command_line() -> str:
    """Return each verb with its help, arguments, options and defaults."""
    import typer

    from charact.cli.application import app

    parts = ["# Command line\n", "`charact VERB --help` prints the same.\n"]
    root: Any = typer.main.get_command(app)
    for name, command in root.commands.items():
        for words, verb in _verbs(name, command):
            parts.append(f"## charact {words}\n")
            parts.append(_paragraphs(verb.help or ""))
            rows = [_parameter(parameter) for parameter in verb.params if parameter.name != "help"]
            if rows:
                parts.append(_table(("argument or option", "meaning", "default"), rows))
    return "\n".join(parts)


def _verbs(words: str, command: Any) -> list[tuple[str, Any]]:
    inner = getattr(command, "commands", None)
    if inner is None:
        return [(words, command)]
    return [pair for name, one in inner.items() for pair in _verbs(f"{words} {name}", one)]


def _paragraphs(text: str) -> str:
    out = []
    for paragraph in text.replace("\b", "").strip().split("\n\n"):
        line = " ".join(paragraph.split())
        before, example, command = line.partition("Example: ")
        out.append(before.strip() if before else "")
        if example:
            out.append(f"Example:\n\n    {command}\n")
    return "\n\n".join(one for one in out if one) + "\n"


def _parameter(parameter: Any) -> tuple[str, str, str]:
    argument = parameter.param_type_name == "argument"
    name = (
        parameter.name.upper()
        if argument
        else ", ".join([*parameter.opts, *parameter.secondary_opts])
    )
    default = parameter.default
    shown = (
        "required" if parameter.required else "" if default in (None, False, ()) else f"`{default}`"
    )
    meaning = " ".join((getattr(parameter, "help", "") or "").split())
    return f"`{name}`", meaning, shown


def _digits(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else "" if value is None else str(value)


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*")


def methods() -> str:
    """Return the registered methods with scope, and error and time on the cases of the chart."""
    from charact.method.registry import MODULES, chart_table, methods_of_kind
    from charact.method.stopwatch import time_text

    parts = [
        "# Methods\n",
        "Error is the 95th percentile of |value − truth| / truth over the cases of `charact "
        "chart`; a refusal counts as 100 %. Time is the median over the cases. `auto` takes the "
        "fastest method whose upper 95 % limit of the error is below `--within`.\n",
    ]
    for kind in MODULES:
        rows = []
        for method in methods_of_kind(kind).values():
            charted = [
                (q, r)
                for q in method.quantities
                for r in chart_table(q)
                if r["method"] == method.name
            ]
            for quantity, row in charted:
                error, limit = (
                    f"{row[key]:.2g}" for key in ("error_percent", "error_limit_percent")
                )
                cost = (time_text(row["seconds"]), f"{100 * row['ok_fraction']:.0f}")
                rows.append(
                    (f"`{method.name}`", f"`{quantity}`", error, limit, *cost, method.scope)
                )
            if not charted:
                rows.append(
                    (f"`{method.name}`", f"`{method.quantities[0]}`", "", "", "", "", method.scope)
                )
        head = ("method", "quantity", "error, %", "upper limit, %", "time", "ok, %", "scope")
        parts.append(f"## {kind}\n\n{_table(head, rows)}")
    return "\n".join(parts)


def measured_tables() -> str:
    """Return the tables that the studies keep, as far as they are summaries."""
    folder = Path(__file__).parents[1] / "benchmarks" / "studies" / "tables"

    def table(name: str) -> Any:
        return json.loads((folder / f"{name}.json").read_text())

    columns = ("method", "regions", "ok", "covers68", "covers95", "silent", "rms_percent")
    coverage = [
        tuple(_digits(row[key]) for key in columns) for row in table("edge_coverage")["coverage"]
    ]
    columns = ("method", "snr", "rms_percent", "ratio", "bias_percent", "covers95")
    peers = [tuple(_digits(row[key]) for key in columns) for row in table("edge_peers")["ours"]]
    columns = ("kind", "within_percent", "method", "cases", "right", "told")
    held = [
        (quantity, *(_digits(row[key]) for key in columns))
        for quantity, rows in table("held_back").items()
        if isinstance(rows, list)
        for row in rows
    ]
    parts = [
        "# Measured tables\n",
        (
            "## Coverage of edge intervals\n\nRegions of mixed blur, noise and light "
            "(`edge-coverage`).\n"
        ),
        _table(
            (
                "method",
                "regions",
                "ok",
                "68 % interval holds",
                "95 % interval holds",
                "silent",
                "RMS error, %",
            ),
            coverage,
        ),
        f"## Edges under white noise\n\n{table('edge_peers')['edge']} (`edge-peers`).\n",
        _table(
            (
                "method",
                "step / noise",
                "RMS error, %",
                "over the bound",
                "bias, %",
                "95 % interval holds",
            ),
            peers,
        ),
        "## Choice of `auto` on cases that no chart used\n\nRight: within the tolerance. Flagged: "
        "of the others, those with a flag or an interval wider than the tolerance (`held-out`).\n",
        _table(("quantity", "kind", "tolerance, %", "method", "cases", "right", "flagged"), held),
    ]
    for name, title in (
        ("edge_map", "edges"),
        ("gain_map", "gains"),
        ("spectrum_map", "noise spectra"),
    ):
        axes = table(name)["quick"]["summary"]["by_axis"]
        rows = [
            (axis.replace("none", "within scope"), *(one[key] for key in RESULTS))
            for axis, one in axes.items()
        ]
        parts.append(
            f"## Breaking points of {title}\n\nResults by defect; missed: 95 % intervals of ok "
            f"results.\n"
        )
        parts.append(_table(("defect", *RESULTS), rows))
    return "\n".join(parts)


def file_schemas() -> str:
    """Return the keys of each file format with type, meaning and default."""
    from charact.comparison import Limits
    from labdata.schema import file_schema
    from simulate.radiance.outdoor.scene import OutdoorScene
    from simulate.radiance.scene import LabScene

    parts = [
        "# File formats\n",
        "`charact schema KIND` prints the JSON Schema of a kind, for editors.\n",
    ]
    for kind, title in SCHEMAS.items():
        schema = file_schema(kind, {"limits": Limits, "scene": OutdoorScene, "bench": LabScene})
        parts.append(f"## {kind}\n\n{title[0].upper()}{title[1:]}.\n\n{_keys(schema)}")
        for name, part in schema.get("$defs", {}).items():
            if part.get("properties"):
                about = part.get("description", "").partition("\n\n")[0]
                parts.append(f"### {kind}: {name}\n\n{about}\n\n{_keys(part)}")
    return "\n".join(parts)


def _keys(schema: dict[str, Any]) -> str:
    rows = []
    for key, one in schema.get("properties", {}).items():
        default = json.dumps(one["default"]) if "default" in one else ""
        meaning = " ".join(str(one.get("description", "")).split())
        rows.append(
            (
                f"`{key}`",
                _type(one),
                meaning,
                "required" if key in schema.get("required", ()) else default,
            )
        )
    return _table(("key", "type", "meaning", "default"), rows)


def _table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return (
        "\n".join("| " + " | ".join(_cell(str(cell)) for cell in line) + " |" for line in lines)
        + "\n"
    )


def _type(one: dict[str, Any]) -> str:
    if "$ref" in one:
        return one["$ref"].rpartition("/")[2]
    if "enum" in one or "const" in one:
        return " or ".join(json.dumps(value) for value in one.get("enum", [one.get("const")]))
    if "anyOf" in one:
        return " or ".join(
            dict.fromkeys(_type(each) for each in one["anyOf"] if each.get("type") != "null")
        )
    if one.get("type") == "array":
        inside = one.get("items") or (one.get("prefixItems") or [{}])[0]
        return f"list of {_type(inside)}" if inside else "list"
    return str(one.get("type", "any"))
