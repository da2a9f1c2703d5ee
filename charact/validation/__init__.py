"""Simulated beside measured frames: the fitted sensor alone must reproduce the session, under statistics that can fail."""

from charact.validation.verdict import Control, Pair, Statistic, Validation, as_json, load, save

__all__ = ["Control", "Pair", "Statistic", "Validation", "as_json", "load", "save", "validate"]
