"""What was read back: merged with what was asked, and compared between two runs of one step."""

from dataclasses import fields, replace

from labdata.conditions import Conditions
from labdata.errors import BadInput

SAME = 1e-3
"""Relative difference within which an instrument reads back the same."""

OBSERVED = ("temperature_c", "temperature_time_s", "metered_w", "metered_lux", "metered_time_s")
"""What nobody set: it is recorded as it was, and need not be the same again."""

SAME_LIGHT = 0.02
"""The same for a light meter, whose reading repeats less well."""


def merged(asked: Conditions, *read_back: Conditions) -> Conditions:
    """Return the conditions in force: what was read back where something was, else what was asked."""
    for part in read_back:
        known = {item.name: value for item in fields(Conditions) if (value := getattr(part, item.name)) is not None}
        asked = replace(asked, **known)
    return asked


def require_same(before: Conditions, now: Conditions, *, label: str) -> None:
    """Refuse (BadInput) to go on with a stack under other conditions than it was begun under."""
    for item in fields(Conditions):
        if item.name in OBSERVED:
            continue
        first, second = getattr(before, item.name), getattr(now, item.name)
        if first is None or second is None:
            continue
        if abs(second - first) > (SAME_LIGHT if item.name == "illuminance_lux" else SAME) * abs(first):
            raise BadInput(
                f"a resumed step must read back what it did in its first run, got {item.name} of {second:g} "
                f"after {first:g} in {label!r}"
            )
