"""Validation of a fitted sensor by comparison of simulated with measured frames."""

from charact.validation.controls import PARAMETERS, ParameterControl, change_parameter
from charact.validation.faults import FAULTS
from charact.validation.frame_features import GROUPS, Numbers, features_of
from charact.validation.frames import MatchedFrames, MatchedStacks
from charact.validation.side_by_side import validate
from charact.validation.simulated_frames import simulate_frames
from charact.validation.statistic import Statistic
from charact.validation.thresholds import VALIDATION
from charact.validation.validation_result import (
    FramePair,
    ResidualMap,
    Validation,
    ValidationControl,
    ValidationFigures,
    as_json,
    load,
    save,
)
from charact.validation.validation_test import SCORES, ParameterChange, ValidationTest

__all__ = [
    "FAULTS",
    "GROUPS",
    "PARAMETERS",
    "SCORES",
    "VALIDATION",
    "FramePair",
    "MatchedFrames",
    "MatchedStacks",
    "Numbers",
    "ParameterChange",
    "ParameterControl",
    "ResidualMap",
    "Statistic",
    "Validation",
    "ValidationControl",
    "ValidationFigures",
    "ValidationTest",
    "as_json",
    "change_parameter",
    "features_of",
    "load",
    "save",
    "simulate_frames",
    "validate",
]
