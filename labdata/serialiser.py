"""Serialisers: convert TOML and JSON to frozen dataclasses and back; invalid input raises
BadInput.
"""

import dataclasses
import difflib
import inspect
import json
import math
import tomllib
from collections.abc import Mapping, Sequence
from functools import cache, reduce
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

from labdata.errors import BadInput
from labdata.file_io import require_regular

EXPECTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "a text",
    "bool_type": "true or false",
    "finite_number": "a finite number",
    "tuple_type": "a list",
    "list_type": "a list",
    "dataclass_type": "a table",
    "dict_type": "a table",
}


def sentence(
    errors: Sequence[Mapping[str, Any]],
    mapping: Mapping[str, Any],
    where: str,
    known: Sequence[str],
) -> str:
    """Return one sentence on the first of several validation errors of pydantic; `known` are the
    valid keys.
    """
    error = errors[0]
    steps = tuple(error["loc"])[1:]
    kind = error["type"]
    if kind in ("unexpected_keyword_argument", "missing") and isinstance(steps[-1], str):
        return _about_a_key(kind, steps, mapping, where, known)
    steps = _steps_in(steps, mapping)
    if kind in ("missing", "too_long"):
        steps = steps[:-1] if kind == "missing" and steps and isinstance(steps[-1], int) else steps
        root: Any = mapping
        error = {**error, "input": reduce(lambda at, step: at[step], steps, root)}
    if kind in ("value_error", "assertion_error"):
        return f"{error['ctx']['error']}{_place(', in ', steps, mapping, where)}"
    # Each member of a union reports its own error.
    rules = [
        _rule(member_error)
        for member_error in errors
        if _steps_in(tuple(member_error["loc"])[1:], mapping) == steps
    ] or [_rule(error)]
    rule = " or ".join(dict.fromkeys(rules))
    *outer, key = steps or ("the file",)
    if isinstance(key, int) and outer:
        location = _place(", in ", outer[:-1], mapping, where)
        return f"every item of {outer[-1]} must be {rule}, got {_display(error['input'])}{location}"
    return (
        f"{key} must be {rule}, got "
        f"{_display(error['input'])}{_place(', in ', outer, mapping, where)}"
    )


def _about_a_key(
    kind: str,
    steps: Sequence[str | int],
    mapping: Mapping[str, Any],
    where: str,
    known: Sequence[str],
) -> str:
    *outer, key = steps
    outer = _steps_in(outer, mapping)
    location = _place(" in ", outer, mapping, where)
    if kind == "missing":
        return f"missing key {key!r}{location}"
    suggestions = difflib.get_close_matches(str(key), [name for name in known if name != key], n=1)
    return f"unknown key {key!r}{location}" + (
        f"; did you mean {suggestions[0]!r}?" if suggestions else ""
    )


def _rule(error: Mapping[str, Any]) -> str:
    if error["type"] == "literal_error":
        return f"one of {error['ctx']['expected']}"
    if error["type"] in ("missing", "too_long"):
        return f"a list of {error['ctx']['max_length'] if 'ctx' in error else error['loc'][-1] + 1}"
    if error["type"] == "dataclass_type" and error["ctx"]["class_name"] == "Parameter":
        return "a number or a table"
    message = str(error["msg"])
    return EXPECTED.get(error["type"], message[:1].lower() + message[1:])


def _steps_in(steps: Sequence[str | int], mapping: Any) -> tuple[str | int, ...]:
    """Return the steps that exist in the mapping; pydantic inserts names of union members."""
    existing: list[str | int] = []
    for step in steps:
        try:
            mapping = mapping[step]
        except (KeyError, IndexError, TypeError):
            continue
        existing.append(step)
    return tuple(existing)


def _place(joint: str, steps: Sequence[str | int], mapping: Any, where: str) -> str:
    """Return the location, innermost first: 'target of stack 2 ("flat-03") of session.toml'."""
    names: list[str] = []
    at = mapping
    for step in steps:
        at = at[step]
        if isinstance(step, int) and names:
            label = at.get("label") if isinstance(at, Mapping) else None
            names[-1] += f" {step + 1}" + (
                f" ({json.dumps(label, ensure_ascii=False, default=str)})" if label else ""
            )
        else:
            names.append(str(step))
    words = names[::-1] + ([where] if where else [])
    return joint + " of ".join(words) if words else ""


def _display(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 60 else text[:57] + "..."


T = TypeVar("T")


def from_toml(path: str | Path, type_: type[T]) -> T:
    """Read a TOML file into a dataclass.

    A file that is missing or no TOML, an unknown key or an invalid value is BadInput with key and
    place.
    """
    return from_mapping(read_toml(path), type_, where=Path(path).name)


def read_toml(path: str | Path) -> dict[str, Any]:
    """Read a TOML file into a mapping of plain values; one that is missing or no TOML is
    BadInput.
    """
    path = Path(path)
    require_regular(path)
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadInput(f"{path} must be a readable file: {error.strerror}") from None
    except UnicodeDecodeError:
        raise BadInput(f"{path} must be a TOML file, got bytes that are no text") from None
    except tomllib.TOMLDecodeError as error:
        words = str(error)
        raise BadInput(f"{path} must be a TOML file: {words[:1].lower()}{words[1:]}") from None
    except ValueError:
        raise BadInput(
            f"{path} must have numbers of ordinary length, got one of thousands of digits"
        ) from None
    except RecursionError:
        raise BadInput(
            f"{path} must be a TOML file, got brackets nested too deep to be read"
        ) from None


def from_mapping(mapping: Mapping[str, Any], type_: type[T], where: str = "") -> T:
    """Build a dataclass from a mapping of TOML or JSON values, checked as by `from_toml`; `where`
    names its file.
    """
    from pydantic import ValidationError

    # Strict JSON accepts a list for a tuple, strict Python values do not; neither accepts "780" as
    # a number.
    text = json.dumps([dict(mapping)], default=lambda date: {"date": str(date)})
    try:
        return adapter(type_).validate_json(text)[0]
    except ValidationError as errors:
        problems = errors.errors(include_url=False)
        raise BadInput(sentence(problems, mapping, where, _valid_keys(type_))) from None


def to_toml(value: Any) -> str:
    """Return a dataclass as TOML that `from_toml` reads; None and empty defaults are omitted."""
    import tomli_w

    return tomli_w.dumps(to_mapping(value))


def to_mapping(value: Any) -> dict[str, Any]:
    """Return a dataclass as the mapping of plain values of its file."""
    return _plain(value)


def dataclasses_in(type_: Any) -> dict[str, type]:
    """Return a dataclass and all dataclasses inside it, by name."""
    if dataclasses.is_dataclass(type_) and isinstance(type_, type):
        inner = [dataclasses_in(hint) for hint in get_type_hints(type_).values()]
        return {
            type_.__name__: type_,
            **{name: found for one in inner for name, found in one.items()},
        }
    return {name: found for one in get_args(type_) for name, found in dataclasses_in(one).items()}


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return _plain_fields(value)
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items() if item is not None}
    return _plain_number(value)


def _plain_number(value: Any) -> Any:
    """Return a NumPy number as a Python one; a non-finite one, which cannot be read back, is
    BadInput.
    """
    number = value.item() if hasattr(value, "item") else value
    if isinstance(number, float) and not math.isfinite(number):
        raise BadInput(f"a file holds finite numbers only, got {number}")
    return number


def _plain_fields(value: Any) -> dict[str, Any]:
    annotations = inspect.get_annotations(type(value))
    plain = {}
    for item in sorted(dataclasses.fields(value), key=lambda item: item.name not in annotations):
        written = _plain(getattr(value, item.name))
        required = (
            item.default is dataclasses.MISSING and item.default_factory is dataclasses.MISSING
        )
        empty = isinstance(written, list | dict) and not written
        if written is not None and (required or not empty):
            plain[item.name] = written
    return plain


@cache
def adapter(type_: type) -> Any:
    """Return the strict reader of a dataclass and of all dataclasses inside it."""
    from pydantic import ConfigDict, TypeAdapter

    # Around a bare dataclass pydantic ignores the configuration; inside a tuple it reaches every
    # depth.
    wrapped: Any = tuple.__class_getitem__(type_)
    return TypeAdapter(wrapped, config=ConfigDict(extra="forbid", strict=True, allow_inf_nan=False))


@cache
def _valid_keys(type_: type) -> tuple[str, ...]:
    return tuple(
        sorted(
            {
                key.name
                for table in dataclasses_in(type_).values()
                for key in dataclasses.fields(table)
            }
        )
    )
