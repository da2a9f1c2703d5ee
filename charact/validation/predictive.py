"""Comparison of a measured vector with simulated ones by a bootstrapped chi-squared test."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

REPLICATES = 4000


@dataclass(frozen=True, kw_only=True)
class Features:
    """Numbers from one set of frames, shape (k,), their sampling covariance (k, k) and its degrees of freedom."""

    value: Array
    covariance: Array
    freedom: int


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Distance of a measured vector from an ensemble of simulated ones.

    `distance`: root of chi-squared over its number of terms, 1 is usual; `p_value`: probability of at least this
    distance; `centre`, `sd`: predicted mean and standard deviation of a measured vector, shape (k,).
    """

    distance: float
    p_value: float
    centre: Array
    sd: Array


def compare(
    measured: Features, simulated: list[Features], *, rng: np.random.Generator, replicates: int = REPLICATES
) -> Comparison:
    """Compare one measured vector with at least two simulated ones, each from its own posterior draw.

    Notes
    -----
    Simulated vectors scatter with S = W + P: sampling W, and the posterior P. W is pooled from within the sets, S from
    between them, and P is the positive part of S - W. The distance of the measured vector from the mean of D draws has
    the covariance (W + P)(1 + 1/D). Since W and P are estimates, the squared distance has no tabulated distribution:
    the procedure is repeated on vectors drawn with the estimated W and P, and the p-value is the fraction of
    repetitions at least as distant (a parametric bootstrap; Davison & Hinkley 1997, section 4.2).
    """
    values = np.array([one.value for one in simulated])
    within, freedom = _pool_covariance([*simulated, measured])
    chi_squared, covariance = _distance(measured.value, values, within)
    whole = _root(within + _above(np.cov(values.T), within))
    normal = rng.standard_normal((replicates, len(values) + 1, values.shape[1])) @ whole.T
    sampled = rng.standard_normal((replicates, freedom, values.shape[1])) @ _root(within).T
    again = np.einsum("rni,rnj->rij", sampled, sampled, optimize=True) / freedom
    null, _ = _distance(normal[:, 0], normal[:, 1:], again)
    return Comparison(
        distance=float(np.sqrt(chi_squared / values.shape[1])),
        p_value=float((1 + np.sum(null >= chi_squared)) / (replicates + 1)),
        centre=values.mean(axis=0),
        sd=np.sqrt(np.diag(covariance)),
    )


def _distance(one: Array, many: Array, within: Array) -> tuple[Array, Array]:
    """Return the squared distance of vectors (..., k) from ensembles (..., draw, k), and the covariance it is in."""
    count = many.shape[-2]
    centre = many.mean(axis=-2)
    away = many - centre[..., None, :]
    between = np.swapaxes(away, -1, -2) @ away / (count - 1.0)
    covariance = (within + _above(between, within)) * (1.0 + 1.0 / count)
    gap = one - centre
    return np.einsum("...i,...i->...", gap, np.linalg.solve(covariance, gap[..., None])[..., 0]), covariance


def _pool_covariance(sets: list[Features]) -> tuple[Array, int]:
    """Return the sampling covariance pooled over sets, and its degrees of freedom."""
    freedom = sum(one.freedom for one in sets)
    total = np.sum([one.freedom * one.covariance for one in sets], axis=0)
    size = len(total)
    return total / freedom + 1e-12 * np.trace(total) / (freedom * size) * np.eye(size), freedom


def _above(between: Array, within: Array) -> Array:
    """Return the excess of covariances (..., k, k) over others, in the directions where it is positive."""
    root = _root(within)
    inverse = np.linalg.inv(root)
    white = inverse @ between @ np.swapaxes(inverse, -1, -2)
    values, vectors = np.linalg.eigh((white + np.swapaxes(white, -1, -2)) / 2.0)
    extra = (vectors * np.maximum(values - 1.0, 0.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    return np.asarray(root @ extra @ np.swapaxes(root, -1, -2))


def _root(covariance: Array) -> Array:
    """Return Cholesky roots."""
    return np.linalg.cholesky(covariance).astype(np.float64)
