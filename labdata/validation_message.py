"""What is wrong with a file, in one sentence: the key, the rule, the value and the place."""

import difflib
import json
from collections.abc import Mapping, Sequence
from typing import Any

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


def sentence(errors: Sequence[Mapping[str, Any]], mapping: Mapping[str, Any], where: str, known: Sequence[str]) -> str:
    """Return one sentence on the first of some validation errors.

    Parameters
    ----------
    errors
        Errors as pydantic lists them; their locations start behind the wrapper's index.
    mapping
        What was read.
    where
        Where it was read from.
    known
        Keys that exist, among which a misspelt one is looked for.
    """
    error = errors[0]
    steps = tuple(error["loc"])[1:]
    kind = error["type"]
    if kind in ("unexpected_keyword_argument", "missing") and isinstance(steps[-1], str):
        return _about_a_key(kind, steps, mapping, where, known)
    steps = _steps_in(steps, mapping)
    if kind in ("missing", "too_long"):
        steps = steps[:-1] if kind == "missing" and steps and isinstance(steps[-1], int) else steps
        error = {**error, "input": _at(steps, mapping)}
    if kind in ("value_error", "assertion_error"):
        return f"{error['ctx']['error']}{_place(', in ', steps, mapping, where)}"
    # Each member of a union complains by itself.
    rules = [_rule(one) for one in errors if _steps_in(tuple(one["loc"])[1:], mapping) == steps] or [_rule(error)]
    rule = " or ".join(dict.fromkeys(rules))
    *outer, key = steps or ("the file",)
    if isinstance(key, int) and outer:
        place = _place(", in ", outer[:-1], mapping, where)
        return f"every item of {outer[-1]} must be {rule}, got {_display(error['input'])}{place}"
    return f"{key} must be {rule}, got {_display(error['input'])}{_place(', in ', outer, mapping, where)}"


def _about_a_key(
    kind: str, steps: Sequence[str | int], mapping: Mapping[str, Any], where: str, known: Sequence[str]
) -> str:
    *outer, key = steps
    outer = _steps_in(outer, mapping)
    place = _place(" in ", outer, mapping, where)
    if kind == "missing":
        return f"missing key {key!r}{place}"
    near = difflib.get_close_matches(str(key), [name for name in known if name != key], n=1)
    return f"unknown key {key!r}{place}" + (f"; did you mean {near[0]!r}?" if near else "")


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
    """Return the steps that lead somewhere in what was read; pydantic adds names of union members."""
    found: list[str | int] = []
    for step in steps:
        try:
            mapping = mapping[step]
        except (KeyError, IndexError, TypeError):
            continue
        found.append(step)
    return tuple(found)


def _at(steps: Sequence[str | int], mapping: Any) -> Any:
    for step in steps:
        mapping = mapping[step]
    return mapping


def _place(joint: str, steps: Sequence[str | int], mapping: Any, where: str) -> str:
    """Return the place in words, innermost first: 'target of stack 2 ("flat-03") of session.toml'."""
    places: list[str] = []
    at = mapping
    for step in steps:
        at = at[step]
        if isinstance(step, int) and places:
            label = at.get("label") if isinstance(at, Mapping) else None
            places[-1] += f" {step + 1}" + (f" ({json.dumps(label, ensure_ascii=False, default=str)})" if label else "")
        else:
            places.append(str(step))
    words = places[::-1] + ([where] if where else [])
    return joint + " of ".join(words) if words else ""


def _display(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 60 else text[:57] + "..."
