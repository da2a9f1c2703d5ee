"""Validation of a fitted sensor by comparison of simulated with measured frames."""

from charact.validation.side_by_side import validate
from charact.validation.validation_result import (
    FramePair,
    ResidualMap,
    Statistic,
    Validation,
    ValidationControl,
    ValidationFigures,
    as_json,
    load,
    save,
)

__all__ = [
    "FramePair",
    "ResidualMap",
    "Statistic",
    "Validation",
    "ValidationControl",
    "ValidationFigures",
    "as_json",
    "load",
    "save",
    "validate",
]
