"""The JSON Schema of a file, with the words of the docstrings, for editors that complete and check TOML."""

import inspect
import re
from typing import Any

from labdata.parameter import Parameter


def with_descriptions(schema: dict[str, Any], types: dict[str, type]) -> dict[str, Any]:
    """Return a schema with the descriptions of its tables and keys.

    Parameters
    ----------
    schema
        JSON Schema with `$defs`.
    types
        Dataclasses by the name that the schema gives them; the schema's own title among them.
    """
    return {
        **_table(schema, types.get(schema["title"])),
        "$defs": {name: _table(table, types.get(name)) for name, table in schema["$defs"].items()},
    }


def _table(table: dict[str, Any], type_: type | None) -> dict[str, Any]:
    if type_ is None or "properties" not in table:
        return table
    words = parameters_of(type_)
    keys = {name: _key(key, words.get(name)) for name, key in table["properties"].items()}
    whole = {**table, "description": summary_of(type_), "properties": keys}
    # A bare number in a file stands for a parameter that is exact.
    return {"anyOf": [{"type": "number"}, whole]} if type_ is Parameter else whole


def _key(key: dict[str, Any], words: str | None) -> dict[str, Any]:
    """Return the schema of one key without null, which TOML does not know: an unknown value is left out."""
    kinds = [kind for kind in key.get("anyOf", []) if kind != {"type": "null"}]
    kept = {name: part for name, part in key.items() if name not in ("anyOf", "title") and part is not None}
    kept |= kinds[0] if len(kinds) == 1 else {"anyOf": kinds} if kinds else {}
    return kept | ({"description": words} if words else {})


def summary_of(type_: type) -> str:
    """Return the first paragraph of a docstring as one line."""
    return " ".join((inspect.getdoc(type_) or "").split("\n\n")[0].split())


def parameters_of(type_: type) -> dict[str, str]:
    """Return what the numpydoc sections of a class and its bases say of each parameter, as one line each."""
    words: dict[str, str] = {}
    for base in reversed(type_.__mro__):
        words.update(_parameters(inspect.cleandoc(base.__dict__.get("__doc__") or "")))
    return words


def _parameters(docstring: str) -> dict[str, str]:
    _, _, section = docstring.partition("Parameters\n----------\n")
    section = re.split(r"\n\S+\n-{3,}\n", section)[0]
    words = {}
    for names, text in re.findall(r"^(\w[\w, ]*)\n((?:[ \t]+\S.*\n?)+)", section, re.MULTILINE):
        words.update({name.strip(): " ".join(text.split()) for name in names.split(",")})
    return words
