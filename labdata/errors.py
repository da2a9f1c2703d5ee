"""The error of invalid input, and the rules that numbers of records obey."""

import math
from collections.abc import Callable, Iterable
from typing import Any


class BadInput(ValueError):
    """Invalid files, settings or parameters from outside; one sentence with rule and value, exit
    code 1.
    """


_RULES: dict[str, tuple[Callable[[float], bool], str]] = {
    "finite": (math.isfinite, "must be a finite number"),
    "positive": (lambda number: 0.0 < number < math.inf, "must be positive"),
    "not_negative": (lambda number: 0.0 <= number < math.inf, "must not be negative"),
    "fraction": (lambda number: 0.0 <= number <= 1.0, "must lie between 0 and 1"),
    "one_or_more": (lambda number: number >= 1.0, "must be at least 1"),
}


def check(record: Any, *, of: str = "", **rules: str | Iterable[str]) -> None:
    """Require numbers of a record to obey rules, each with the names of its fields; None is no
    number.

    check(self, positive="rows columns", fraction="gate_duty") names the first field that breaks a
    rule; `of` is the record.
    """
    for kind, names in rules.items():
        holds, words = _RULES[kind]
        for name in names.split() if isinstance(names, str) else names:
            value = getattr(record, name)
            if value is not None and not holds(float(value)):
                rule = words if math.isfinite(value) else "must be a finite number"
                raise BadInput(f"{name}{of} {rule}, got {float(value):g}")


def check_range(record: Any, low: float, high: float, *names: str, of: str = "") -> None:
    """Require numbers of a record to lie between two bounds; None is no number."""
    for name in names:
        value = getattr(record, name)
        if value is not None and not low <= float(value) <= high:
            raise BadInput(
                f"{name} must lie between {low:g} and {high:g}, got {float(value):g}{of}"
            )
