"""Autocovariance in time without bias, from a few exposures whose mean was taken away."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def centring(parity: NDArray[np.int64]) -> Array:
    """Return the projection that takes each parity's mean over time away, shape (exposure, exposure)."""
    same = (parity[:, None] == parity[None, :]).astype(float)
    return np.eye(len(parity)) - same / same.sum(axis=1, keepdims=True)


def autocovariance(products: Array, time: NDArray[np.int64], parity: NDArray[np.int64], lags: NDArray[np.int64], *,
                   within_parity: bool = False) -> Array:  # fmt: skip
    """Return the unbiased autocovariance at the given lags from products of centred exposures.

    Parameters
    ----------
    products
        Mean products of exposures i and j after each pixel's mean was taken away, shape (..., exposure, exposure).
    time, parity
        As in `Exposures`, shape (exposure,).
    lags
        Lags at which the covariance may differ from zero, 0 first, in exposures, shape (lag,).
    within_parity
        Only exposures of the same rows are compared (odd lags of interlaced video then cannot be had).

    Returns
    -------
    NDArray
        Covariance, shape (..., lag).

    Notes
    -----
    Centring replaces the covariance matrix C by P C P, which is linear in the covariances c(lag): the mean over the
    pairs of each lag, A c, is solved for c. With independent exposures this is the factor n/(n-1).
    """
    pairs, solve = _solution(time, parity, lags, within_parity)
    measured = np.stack([products[..., pair].mean(axis=-1) for pair in pairs], axis=-1)
    return measured @ solve.T


def _solution(time, parity, lags, within_parity: bool):
    """The pairs of every lag, and the matrix that undoes the centring."""
    return _cached_solution(tuple(time.tolist()), tuple(parity.tolist()), tuple(lags.tolist()), within_parity)


@lru_cache(maxsize=64)
def _cached_solution(time: tuple[int, ...], parity: tuple[int, ...], lags: tuple[int, ...], within_parity: bool):
    """The same, remembered: most stacks of a session are exposed alike."""
    when, rows = np.array(time), np.array(parity)
    usable = (rows[:, None] == rows[None, :]) if within_parity else np.ones((len(when), len(when)), bool)
    distance = np.abs(when[:, None] - when[None, :])
    pairs = [(distance == lag) & usable for lag in lags]
    project = centring(rows)
    centred = [project @ (distance == lag) @ project for lag in lags]
    return pairs, np.linalg.inv(np.array([[matrix[pair].mean() for matrix in centred] for pair in pairs]))


def truncation_bias(time: NDArray[np.int64], parity: NDArray[np.int64], lags: NDArray[np.int64]
           ) -> tuple[NDArray[np.int64], Array]:  # fmt: skip
    """Return the distances beyond the last lag, and what a covariance of 1 there adds to `autocovariance`.

    Returns
    -------
    distance
        Exposures apart, shape (distance,).
    added
        What the covariance at each lag reads too much, shape (lag, distance): below zero, as centring takes away what
        exposures share.
    """
    return _cached_truncation_bias(tuple(time.tolist()), tuple(parity.tolist()), tuple(lags.tolist()))


@lru_cache(maxsize=64)
def _cached_truncation_bias(
    time: tuple[int, ...], parity: tuple[int, ...], lags: tuple[int, ...]
) -> tuple[NDArray[np.int64], Array]:
    """The same, remembered."""
    when = np.array(time)
    pairs, solve = _cached_solution(time, parity, lags, False)
    apart = np.abs(when[:, None] - when[None, :])
    distance = np.unique(apart[apart > lags[-1]])
    project = centring(np.array(parity))
    centred = [project @ (apart == one) @ project for one in distance]
    return distance, solve @ np.array([[one[pair].mean() for one in centred] for pair in pairs])


def n_effective_samples(time: NDArray[np.int64], parity: NDArray[np.int64], lags: NDArray[np.int64], correlation: Array, *,
                within_parity: bool = False) -> float:  # fmt: skip
    """Return how many independent exposures know the covariance at lag 0 as well as `autocovariance` does.

    Parameters
    ----------
    correlation
        Correlation at the lags 1, 2, ..., shape (lag,).

    Notes
    -----
    The estimate is a sum of products with weights M; for Gaussian modes its relative variance is tr(P M P R P M P R).
    """
    known = tuple(np.asarray(correlation, float).tolist())
    return _cached_n_effective_samples(
        tuple(time.tolist()), tuple(parity.tolist()), tuple(lags.tolist()), known, within_parity
    )


@lru_cache(maxsize=64)
def _cached_n_effective_samples(time: tuple[int, ...], parity: tuple[int, ...], lags: tuple[int, ...], correlation: tuple[float, ...],
             within_parity: bool) -> float:  # fmt: skip
    """The same, remembered."""
    pairs, solve = _cached_solution(time, parity, lags, within_parity)
    weight = sum(share * pair / pair.sum() for share, pair in zip(solve[0], pairs, strict=True))
    when = np.array(time)
    distance = np.abs(when[:, None] - when[None, :])
    known = np.concatenate([[1.0], correlation, np.zeros(max(0, distance.max() - len(correlation)))])
    project = centring(np.array(parity))
    chain = project @ weight @ project @ known[distance]
    return float(1.0 / np.trace(chain @ chain))


def error_correlation(time: NDArray[np.int64], parity: NDArray[np.int64], lags: NDArray[np.int64]) -> Array:
    """Return the correlation of the errors of `autocovariance` at all lags, shape (lag, lag).

    Exposures of the same kind that share nothing; errors go together, as the same mean was taken from all of them.
    """
    return _cached_error_correlation(tuple(time.tolist()), tuple(parity.tolist()), tuple(lags.tolist()))


@lru_cache(maxsize=64)
def _cached_error_correlation(time: tuple[int, ...], parity: tuple[int, ...], lags: tuple[int, ...]) -> Array:
    """The same, remembered."""
    pairs, solve = _cached_solution(time, parity, lags, False)
    project = centring(np.array(parity))
    each = np.array([pair / pair.sum() for pair in pairs])
    weights = (project @ np.tensordot(solve, each, 1) @ project).reshape(len(lags), -1)
    covariance = weights @ weights.T
    return covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))


def usable_lags(time: NDArray[np.int64], parity: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Return the lags 0..most that the exposures can tell from the mean that was taken away."""
    frames = int(np.bincount(parity).min())
    fields = len(np.unique(parity))
    longest = min(most, (frames // 2) * fields - (fields == 1)) if frames > 3 else 0
    gaps = set(np.abs(time[:, None] - time[None, :]).ravel().tolist())
    return np.array([lag for lag in range(longest + 1) if lag in gaps], np.int64)
