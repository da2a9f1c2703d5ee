"""Pages of the reference that are written from the code: command line, methods, file schemas, measured tables."""

import json
from pathlib import Path
from typing import Any

SCHEMAS = {
    "session": "`session.toml`: the stacks of a session and their conditions",
    "sensor": "description of an intensified camera",
    "solid-state": "description of a camera without a tube",
    "plan": "acquisition plan",
    "scene": "outdoor scene",
    "bench": "target of the lab bench",
}


def write_pages(folder: Path) -> None:
    """Write all generated pages into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    pages = {"command-line": command_line(), "methods": methods(), "file-schemas": file_schemas()}
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
                parts.append("\n".join(["| argument or option | meaning | default |", "|---|---|---|", *rows]) + "\n")
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


def _parameter(parameter: Any) -> str:
    argument = parameter.param_type_name == "argument"
    name = parameter.name.upper() if argument else ", ".join([*parameter.opts, *parameter.secondary_opts])
    default = parameter.default
    shown = "required" if parameter.required else "" if default in (None, False, ()) else f"`{default}`"
    meaning = " ".join((getattr(parameter, "help", "") or "").split())
    return f"| `{name}` | {_cell(meaning)} | {_cell(shown)} |"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*")


def methods() -> str:
    """Return the registered methods with scope, and error and time on the cases of the chart."""
    from charact.method.registry import MODULES, chart_table, methods_of_kind
    from charact.method.stopwatch import time_text

    parts = [
        "# Methods\n",
        "Error is the 95th percentile of |value − truth| / truth over the cases of `charact chart`; a refusal counts as "
        "100 %. Time is the median over the cases. `auto` takes the fastest method whose upper 95 % limit of the error "
        "is below `--within`.\n",
    ]
    for kind in MODULES:
        parts.append(f"## {kind}\n")
        parts.append("| method | scope | quantity | error, % | upper limit, % | time | ok, % |\n|---|---|---|---|---|---|---|")
        for method in methods_of_kind(kind).values():
            charted = [(q, r) for q in method.quantities for r in chart_table(q) if r["method"] == method.name]
            for quantity, row in charted or [(method.quantities[0], None)]:
                cells = ["", "", "", ""] if row is None else [
                    f"{row['error_percent']:.2g}", f"{row['error_limit_percent']:.2g}", time_text(row["seconds"]),
                    f"{100 * row['ok_fraction']:.0f}",
                ]  # fmt: skip
                parts.append(f"| `{method.name}` | {_cell(method.scope)} | `{quantity}` | {' | '.join(cells)} |")
        parts.append("")
    return "\n".join(parts)


def file_schemas() -> str:
    """Return the keys of each file format with type, meaning and default."""
    from labdata.serialiser import file_schema
    from simulate.radiance.outdoor.scene import OutdoorScene
    from simulate.radiance.scene import LabScene

    parts = ["# File formats\n", "`charact schema KIND` prints the JSON Schema of a kind, for editors.\n"]
    for kind, title in SCHEMAS.items():
        schema = file_schema(kind, {"scene": OutdoorScene, "bench": LabScene})
        parts.append(f"## {kind}\n\n{title[0].upper()}{title[1:]}.\n")
        parts.append(_table(schema))
        for name, part in schema.get("$defs", {}).items():
            if part.get("properties"):
                parts.append(f"### {kind}: {name}\n\n{part.get('description', '').splitlines()[0] if part.get('description') else ''}\n")
                parts.append(_table(part))
    return "\n".join(parts)


def _table(schema: dict[str, Any]) -> str:
    rows = ["| key | type | meaning | default |", "|---|---|---|---|"]
    for key, one in schema.get("properties", {}).items():
        default = "required" if key in schema.get("required", ()) else json.dumps(one["default"]) if "default" in one else ""
        meaning = " ".join(str(one.get("description", "")).split())
        rows.append(f"| `{key}` | {_cell(_type(one))} | {_cell(meaning)} | {_cell(default)} |")
    return "\n".join(rows) + "\n"


def _type(one: dict[str, Any]) -> str:
    if "$ref" in one:
        return one["$ref"].rpartition("/")[2]
    if "enum" in one or "const" in one:
        return " or ".join(json.dumps(value) for value in one.get("enum", [one.get("const")]))
    if "anyOf" in one:
        return " or ".join(dict.fromkeys(_type(each) for each in one["anyOf"] if each.get("type") != "null"))
    if one.get("type") == "array":
        inside = one.get("items") or (one.get("prefixItems") or [{}])[0]
        return f"list of {_type(inside)}" if inside else "list"
    return str(one.get("type", "any"))
