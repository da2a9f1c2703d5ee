"""Posterior sampling: Laplace approximation, importance sampling, MCMC and predictive checks."""

from charact.posterior.chain import sample
from charact.posterior.diagnostics import has_several_peaks
from charact.posterior.importance import importance_sample
from charact.posterior.laplace import find_maximum, laplace
from charact.posterior.predictive import PredictiveCheck, predictive_check
from charact.posterior.sampling import sample_posterior

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
