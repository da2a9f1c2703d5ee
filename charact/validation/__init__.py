"""Simulated beside measured frames: the fitted sensor alone must reproduce the session, by statistics that can fail."""

from charact.validation.side_by_side import validate
from charact.validation.verdict import Control, Pair, Statistic, Validation, as_json, load, save

__all__ = ["Control", "Pair", "Statistic", "Validation", "as_json", "load", "save", "validate"]
