"""Is the measured vector one of the simulated ones? A chi-squared with honest uncertainty of the prediction itself."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Features:
    """Numbers taken of one set of frames, with their sampling errors.

    Parameters
    ----------
    value
        Shape (k,).
    covariance
        Sampling covariance estimated within the set, shape (k, k).
    freedom
        Degrees of freedom of that estimate.
    """

    value: Array
    covariance: Array
    freedom: int


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Distance of a measured vector from an ensemble of simulated ones.

    Parameters
    ----------
    distance
        Root of chi-squared over its number of terms: 1 is usual.
    p_value
        Probability of at least this distance, dimensionless.
    centre, sd
        Predicted mean and standard deviation of a measured vector, shape (k,).
    """

    distance: float
    p_value: float
    centre: Array
    sd: Array


def compare(measured: Features, simulated: list[Features]) -> Comparison:
    """Compare one measured vector with simulated ones, each of its own posterior draw.

    Notes
    -----
    Simulated vectors t_d scatter with S = W + P: sampling W, and the spread P of the posterior. W is pooled from within
    the simulated sets, S from between them, and P is what S has over W, where it has. The measured vector has its own
    sampling error M; its distance from the mean of D draws has the covariance M' + P + (W + P)/D, M' being M pooled
    with W. Hotelling's T^2 with Welch-Satterthwaite degrees of freedom then allows for few draws.
    """
    from scipy.stats import f

    values = np.array([one.value for one in simulated])
    count, size = values.shape
    centre = values.mean(axis=0)
    within, freedom_within = _pooled([*simulated, measured])
    between = np.atleast_2d(np.cov(values.T)) if count > 1 else within
    spread = _above(between, within)
    covariance = within + spread + (within + spread) / count
    root = np.linalg.cholesky(covariance + 1e-12 * np.trace(covariance) / size * np.eye(size))
    away = np.linalg.solve(root, measured.value - centre)
    chi_squared = float(away @ away)
    white = np.linalg.solve(root, np.linalg.solve(root, spread).T)
    share = float(np.clip(np.trace(white) / size, 0.0, 1.0))
    freedom = 1.0 / (share**2 / max(count - 1, 1) + (1.0 - share) ** 2 / freedom_within)
    freedom = max(freedom, size + 1.0)
    scaled = (freedom - size + 1.0) / (size * freedom) * chi_squared
    return Comparison(
        distance=float(np.sqrt(chi_squared / size)),
        p_value=float(f.sf(scaled, size, freedom - size + 1.0)),
        centre=centre,
        sd=np.sqrt(np.diag(covariance)),
    )


def _pooled(sets: list[Features]) -> tuple[Array, int]:
    """Return the sampling covariance pooled over sets, and its degrees of freedom."""
    freedom = sum(one.freedom for one in sets)
    total = np.sum([one.freedom * one.covariance for one in sets], axis=0)
    return total / freedom, freedom


def _above(between: Array, within: Array) -> Array:
    """Return the part of a covariance that exceeds another in the directions where it does."""
    root = np.linalg.cholesky(within + 1e-9 * np.trace(within) / len(within) * np.eye(len(within)))
    white = np.linalg.solve(root, np.linalg.solve(root, between).T)
    values, vectors = np.linalg.eigh((white + white.T) / 2.0)
    extra = (vectors * np.maximum(values - 1.0, 0.0)) @ vectors.T
    return root @ extra @ root.T
