"""JSON Schemas of the files, for editors that complete and check TOML."""

import dataclasses
import inspect
import re
from collections.abc import Mapping
from typing import Any

from labdata.camera.description import (
    IntensifiedCameraFile,
    SolidStateCameraFile,
    ThermalImagerFile,
)
from labdata.camera.parameters import Parameter
from labdata.errors import BadInput
from labdata.plan_file import PlanFile
from labdata.serialiser import adapter, dataclasses_in
from labdata.session import SessionFile

# Titles of the schemas of camera files.
_TITLES: dict[type, str] = {
    IntensifiedCameraFile: "Sensor",
    SolidStateCameraFile: "SolidStateCamera",
    ThermalImagerFile: "InfraredImager",
}


def file_schema(kind: str, more: Mapping[str, type] | None = None) -> dict[str, Any]:
    """Return the JSON Schema of a kind of file: a session, a sensor of three kinds, a plan, or one
    of more kinds.
    """
    kinds: dict[str, type] = {
        "session": SessionFile,
        "sensor": IntensifiedCameraFile,
        "solid-state": SolidStateCameraFile,
        "infrared": ThermalImagerFile,
        "plan": PlanFile,
    }
    kinds |= more or {}
    if kind not in kinds:
        raise BadInput(f"a schema must be of one of {', '.join(kinds)}, got {kind!r}")
    return json_schema(kinds[kind])


def json_schema(type_: type) -> dict[str, Any]:
    """Return the JSON Schema of the file form of a dataclass, for editors that complete and check
    TOML.
    """
    schema, types = adapter(type_).json_schema(), dataclasses_in(type_)
    definitions = schema["$defs"]
    keys = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **definitions.pop(type_.__name__),
        "$defs": {name: _table(table, types.get(name)) for name, table in definitions.items()},
    }
    return {**_table(keys, type_), "title": _TITLES.get(type_, type_.__name__)}


def _table(table: dict[str, Any], type_: type | None) -> dict[str, Any]:
    if type_ is None or "properties" not in table:
        return table
    words = parameters_of(type_)
    keys = {name: _key(key, words.get(name)) for name, key in table["properties"].items()}
    described = {**table, "description": summary_of(type_), "properties": keys}
    # A bare number in a file is an exact parameter.
    return {"anyOf": [{"type": "number"}, described]} if type_ is Parameter else described


def _key(key: dict[str, Any], words: str | None) -> dict[str, Any]:
    """Return the schema of one key without null, which TOML does not have."""
    kinds = [kind for kind in key.get("anyOf", []) if kind != {"type": "null"}]
    schema = {
        name: part
        for name, part in key.items()
        if name not in ("anyOf", "title") and part is not None
    }
    schema |= kinds[0] if len(kinds) == 1 else {"anyOf": kinds} if kinds else {}
    return schema | ({"description": words} if words else {})


def summary_of(type_: type) -> str:
    """Return the first paragraph of a docstring as one line."""
    return " ".join((inspect.getdoc(type_) or "").split("\n\n")[0].split())


def parameters_of(type_: type) -> dict[str, str]:
    """Return the documentation of each field of a class and its bases, as one line each."""
    words: dict[str, str] = {}
    for base in reversed(type_.__mro__):
        words |= _parameter_texts(inspect.cleandoc(base.__dict__.get("__doc__") or ""))
        if dataclasses.is_dataclass(base):
            words |= _field_comments(inspect.getsource(base))
    return words


def _parameter_texts(docstring: str) -> dict[str, str]:
    """Return the numpydoc text of each parameter."""
    _, _, section = docstring.partition("Parameters\n----------\n")
    section = re.split(r"\n\S+\n-{3,}\n", section)[0]
    words = {}
    for names, text in re.findall(r"^(\w[\w, ]*)\n((?:[ \t]+\S.*\n?)+)", section, re.MULTILINE):
        words.update({name.strip(): " ".join(text.split()) for name in names.split(",")})
    return words


def _field_comments(source: str) -> dict[str, str]:
    """Return the comment behind each field, or on the lines before it."""
    words: dict[str, str] = {}
    before: list[str] = []
    for line in source.splitlines():
        name, _, behind = line.strip().partition(":")
        if line.strip().startswith("#: "):
            before.append(line.strip()[3:])
            continue
        if name.isidentifier() and (text := behind.partition("  #: ")[2] or " ".join(before)):
            words[name] = text.rstrip(".") + "."
        before = []
    return words
