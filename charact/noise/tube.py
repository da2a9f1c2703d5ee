"""Presence of an intensifier or multiplying register."""

from collections.abc import Iterable

from charact.method import Context
from labdata.conditions import Conditions
from labdata.session import Session

# Conditions that imply an intensifier.
OF_TUBES = ("mcp_v", "gain_control", "luminous_gain", "brightness_control")


def has_intensifier(conditions: Iterable[Conditions], context: Context) -> bool:
    """Return whether an intensifier is described, or one of its settings stated."""
    return context.sensor is not None or any(getattr(one, name) is not None for one in conditions for name in OF_TUBES)


def has_multiplication(session: Session, context: Context) -> bool:
    """Return whether single electrons are multiplied, in a tube or in a register."""
    known = [entry.conditions for entry in session.of_kind("dark", "flat")]
    return (
        has_intensifier(known, context) or context.register is not None or any((c.em_gain or 1.0) > 1.0 for c in known)
    )
