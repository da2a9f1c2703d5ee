"""Posterior sampling: Laplace approximation, importance sampling, MCMC and predictive checks."""

from charact.inference.chain import sample
from charact.inference.diagnostics import (
    PredictiveCheck,
    has_several_peaks,
    predictive_check,
)
from charact.inference.ensembles import DifferentialEvolution, Ensembles, IndependentDraws
from charact.inference.importance import importance_sample, sample_posterior
from charact.inference.laplace import (
    draw_truncated_gaussian,
    find_maximum,
    laplace,
    quasi_random_normals,
)
from charact.inference.least_squares import (
    covariance_at,
    least_squares,
    linearise_residual,
    ln_evidence,
    weigh_by_evidence,
)
from charact.inference.probit_transform import NormalScores, ProbitTransform

__all__ = [
    "DifferentialEvolution",
    "Ensembles",
    "IndependentDraws",
    "NormalScores",
    "PredictiveCheck",
    "ProbitTransform",
    "covariance_at",
    "draw_truncated_gaussian",
    "find_maximum",
    "has_several_peaks",
    "importance_sample",
    "laplace",
    "least_squares",
    "linearise_residual",
    "ln_evidence",
    "predictive_check",
    "quasi_random_normals",
    "sample",
    "sample_posterior",
    "weigh_by_evidence",
]
