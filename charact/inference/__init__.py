"""Posterior sampling: Laplace approximation, importance sampling, MCMC and predictive checks."""

from typing import TYPE_CHECKING

from labdata.lazy_names import import_on_first_use

if TYPE_CHECKING:
    from charact.inference.chain import sample
    from charact.inference.diagnostics import PredictiveCheck, has_several_peaks, predictive_check
    from charact.inference.ensembles import DifferentialEvolution, Ensembles, IndependentDraws
    from charact.inference.gauss_newton import (
        covariance_at,
        least_squares,
        linearise_residual,
        ln_evidence,
        weigh_by_evidence,
    )
    from charact.inference.importance import importance_sample, sample_posterior
    from charact.inference.laplace_approximation import (
        draw_truncated_gaussian,
        find_maximum,
        laplace,
        quasi_random_normals,
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

__getattr__ = import_on_first_use(
    __name__,
    {
        "charact.inference.chain": "sample",
        "charact.inference.diagnostics": "PredictiveCheck has_several_peaks predictive_check",
        "charact.inference.ensembles": "DifferentialEvolution Ensembles IndependentDraws",
        "charact.inference.gauss_newton": (
            "covariance_at least_squares linearise_residual ln_evidence weigh_by_evidence"
        ),
        "charact.inference.importance": "importance_sample sample_posterior",
        "charact.inference.laplace_approximation": (
            "draw_truncated_gaussian find_maximum laplace quasi_random_normals"
        ),
        "charact.inference.probit_transform": "NormalScores ProbitTransform",
    },
)
