"""Posterior sampling: Laplace approximation, importance sampling, MCMC and predictive checks."""

from charact.inference.chain import sample
from charact.inference.diagnostics import has_several_peaks
from charact.inference.importance import importance_sample
from charact.inference.laplace import find_maximum, laplace
from charact.inference.predictive import PredictiveCheck, predictive_check
from charact.inference.sampling import sample_posterior

__all__ = [
    "PredictiveCheck",
    "find_maximum",
    "has_several_peaks",
    "importance_sample",
    "laplace",
    "predictive_check",
    "sample",
    "sample_posterior",
]
