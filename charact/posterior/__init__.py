"""Posterior draws that may be trusted: a maximum with its curvature, weighted draws, a chain that must prove itself."""

from charact.posterior.chain import sample
from charact.posterior.curvature import laplace, maximum
from charact.posterior.diagnostics import has_several_peaks
from charact.posterior.drawing import draw
from charact.posterior.importance import weighed
from charact.posterior.predictive import PredictiveCheck, predictive_check, predictive_probability

__all__ = [
    "PredictiveCheck",
    "draw",
    "has_several_peaks",
    "laplace",
    "maximum",
    "predictive_check",
    "predictive_probability",
    "sample",
    "weighed",
]
