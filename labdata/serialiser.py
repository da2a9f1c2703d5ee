"""The border: TOML and JSON become frozen dataclasses here or are refused in one sentence, and go back out."""

import dataclasses
import inspect
import json
import math
import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

from labdata.errors import BadInput
from labdata.regular_file import require_regular
from labdata.schema import with_descriptions
from labdata.validation_message import sentence

T = TypeVar("T")


def from_toml(path: str | Path, type_: type[T]) -> T:
    """Read a TOML file into a dataclass.

    Parameters
    ----------
    path
        The file.
    type_
        The dataclass: `Sensor`, `Plan`, or a form of `labdata.file_records`.

    Raises
    ------
    BadInput
        If the file is missing, is not TOML, or holds an unknown key or a value that breaks a rule; one sentence
        that names the key and its place.
    """
    return from_mapping(read_toml(path), type_, where=Path(path).name)


def read_toml(path: str | Path) -> dict[str, Any]:
    """Read a TOML file into a mapping of plain values, for a caller that chooses the dataclass by what it holds.

    Raises
    ------
    BadInput
        If the file is missing or is not TOML.
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
        raise BadInput(f"{path} must be a TOML file: {_lower_first(str(error))}") from None
    except ValueError:
        raise BadInput(f"{path} must hold numbers that a person would write, got one of thousands of digits") from None
    except RecursionError:
        raise BadInput(f"{path} must be a TOML file, got brackets nested too deep to be read") from None


def from_mapping(mapping: Mapping[str, Any], type_: type[T], where: str = "") -> T:
    """Build a dataclass from a mapping of TOML or JSON values.

    Parameters
    ----------
    mapping
        Keys and values; a key that the dataclass does not have is refused at every depth.
    type_
        The dataclass.
    where
        Where the mapping stood, for the sentence of an error: a file name.

    Raises
    ------
    BadInput
        As for `from_toml`.
    """
    form = _forms().get(type_)
    written = _read(mapping, form or type_, where)
    if form is None:
        return written
    try:
        return written.built()
    except BadInput as error:
        raise BadInput(f"{error}, in {where}" if where else str(error)) from None


def _read(mapping: Mapping[str, Any], type_: type, where: str) -> Any:
    from pydantic import ValidationError

    # Strict JSON takes a list for a tuple, which strict Python values do not; "780" is no number in either.
    text = json.dumps([dict(mapping)], default=lambda date: {"date": str(date)})
    try:
        return _adapter(type_).validate_json(text)[0]
    except ValidationError as errors:
        found = errors.errors(include_url=False)
        raise BadInput(sentence(found, mapping, where, _valid_keys(type_))) from None


def to_toml(value: Any) -> str:
    """Write a dataclass as TOML, as `from_toml` reads it; what is None or empty by default is left out."""
    import tomli_w

    return tomli_w.dumps(to_mapping(value))


def to_mapping(value: Any) -> dict[str, Any]:
    """Return a dataclass as the mapping of plain values that its file would hold."""
    form = _forms().get(type(value))
    return _plain(value if form is None else form.written(value))


def json_schema(type_: type) -> dict[str, Any]:
    """Return the JSON Schema of the file form of a dataclass, for editors that complete and check TOML."""
    written = _forms().get(type_, type_)
    schema = _adapter(written).json_schema()
    definitions = schema["$defs"]
    whole = definitions.pop(written.__name__)
    return with_descriptions(
        {
            "$schema": "https://json-schema.org/draft/2020-12/schema",
            **whole,
            "title": written.__name__,
            "$defs": definitions,
        },
        _dataclasses_in(written),
    )


def file_schema(kind: str, more: Mapping[str, type] | None = None) -> dict[str, Any]:
    """Return the JSON Schema of a kind of file: "session", "sensor", "solid-state", "plan", or one of more kinds."""
    from labdata.file_records import SessionFile
    from labdata.plan import Plan
    from labdata.sensor import Sensor
    from labdata.solid_state import SolidStateCamera

    kinds = {"session": SessionFile, "sensor": Sensor, "solid-state": SolidStateCamera, "plan": Plan, **(more or {})}
    if kind not in kinds:
        raise BadInput(f"a schema must be of one of {', '.join(kinds)}, got {kind!r}")
    return json_schema(kinds[kind])


def _dataclasses_in(type_: Any) -> dict[str, type]:
    """Return a dataclass and all dataclasses inside it, by name."""
    if dataclasses.is_dataclass(type_) and isinstance(type_, type):
        inner = [_dataclasses_in(hint) for hint in get_type_hints(type_).values()]
        return {type_.__name__: type_, **{name: found for one in inner for name, found in one.items()}}
    return {name: found for one in get_args(type_) for name, found in _dataclasses_in(one).items()}


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return _plain_fields(value)
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items() if item is not None}
    return _plain_number(value)


def _plain_number(value: Any) -> Any:
    """Return a number of NumPy as one of Python; one that is not finite could not be read back and is refused."""
    number = value.item() if hasattr(value, "item") else value
    if isinstance(number, float) and not math.isfinite(number):
        raise BadInput(f"a file holds finite numbers only, got {number}")
    return number


def _plain_fields(value: Any) -> dict[str, Any]:
    own = inspect.get_annotations(type(value))
    plain = {}
    for item in sorted(dataclasses.fields(value), key=lambda item: item.name not in own):
        written = _plain(getattr(value, item.name))
        required = item.default is dataclasses.MISSING and item.default_factory is dataclasses.MISSING
        empty = isinstance(written, list | dict) and not written
        if written is not None and (required or not empty):
            plain[item.name] = written
    return plain


@cache
def _adapter(type_: type) -> Any:
    """Return the strict reader of a dataclass and of all dataclasses inside it."""
    from pydantic import ConfigDict, TypeAdapter

    # Around a bare dataclass pydantic ignores the configuration; inside a tuple it reaches every depth.
    wrapped: Any = tuple.__class_getitem__(type_)
    return TypeAdapter(wrapped, config=ConfigDict(extra="forbid", strict=True, allow_inf_nan=False))


@cache
def _valid_keys(type_: type) -> tuple[str, ...]:
    return tuple(sorted({key.name for table in _dataclasses_in(type_).values() for key in dataclasses.fields(table)}))


@cache
def _forms() -> dict[type, Any]:
    from labdata.file_records import FORMS

    return FORMS


def _lower_first(text: str) -> str:
    return text[:1].lower() + text[1:]
