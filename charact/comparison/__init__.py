"""Comparison of two sessions, and of a session with the limits of a specification."""

from charact.comparison.compare import Comparison, Difference, compare, comparison_json, draws_of
from charact.comparison.conditions import ConditionPair, condition_pairs, require_alike
from charact.comparison.limits import (
    Limit,
    LimitCheck,
    Limits,
    Outcome,
    Specification,
    check,
    check_json,
    load_check,
    load_limits,
    load_specification,
    save_check,
)

__all__ = [
    "Comparison",
    "ConditionPair",
    "Difference",
    "Limit",
    "LimitCheck",
    "Limits",
    "Outcome",
    "Specification",
    "check",
    "check_json",
    "compare",
    "comparison_json",
    "condition_pairs",
    "draws_of",
    "load_check",
    "load_limits",
    "load_specification",
    "require_alike",
    "save_check",
]
