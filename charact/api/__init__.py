"""Functions for scripts and notebooks: arrays, files and sessions in, results with plots and tables
out.
"""

from charact.api.analysis import Analysis
from charact.api.deciding import check, compare
from charact.api.inputs import frames_of, session, stack
from charact.api.measuring import bloom, measure, mtf, noise
from charact.api.modelling import fit, report, simulate, validate

__all__ = [
    "Analysis",
    "bloom",
    "check",
    "compare",
    "fit",
    "frames_of",
    "measure",
    "mtf",
    "noise",
    "report",
    "session",
    "simulate",
    "stack",
    "validate",
]
