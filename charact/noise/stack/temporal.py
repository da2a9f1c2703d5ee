"""Unbiased temporal autocovariance from few centred exposures."""

from collections.abc import Sized
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from charact.noise.thresholds import STACK
from labdata.frames import FrameStack

Array = NDArray[np.float64]


def centring(parity: NDArray[np.int64]) -> Array:
    """Return the projection that subtracts the mean over time of each parity, shape (exposure, exposure)."""
    same = (parity[:, None] == parity[None, :]).astype(float)
    return np.eye(len(parity)) - same / same.sum(axis=1, keepdims=True)


def autocovariance(products: Array, time: NDArray[np.int64], parity: NDArray[np.int64], lags: NDArray[np.int64], *,
                   within_parity: bool = False) -> Array:  # fmt: skip
    """Return the unbiased autocovariance at the given lags from products of centred exposures.

    `products`: mean products of centred exposures i and j, shape (..., exposure, exposure); `time`, `parity`: as in
    `Exposures`, shape (exposure,); `lags`: lags of nonzero covariance, 0 first, exposures, shape (lag,);
    `within_parity`: whether to compare only exposures of the same rows (no odd lags of interlaced video).

    Returns covariance, shape (..., lag).

    Centring replaces the covariance matrix C by P C P, which is linear in the covariances c(lag). The mean A c over the
    pairs of each lag is solved for c. For independent exposures this is the factor n/(n-1).
    """
    pairs, solve = _solution(time, parity, lags, within_parity)
    measured = np.stack([products[..., pair].mean(axis=-1) for pair in pairs], axis=-1)
    return measured @ solve.T


def _solution(time, parity, lags, within_parity: bool):
    """Return the pairs of every lag, and the matrix that inverts the centring."""
    return _solution_of(tuple(time.tolist()), tuple(parity.tolist()), tuple(lags.tolist()), within_parity)


@lru_cache(maxsize=64)
def _solution_of(time: tuple[int, ...], parity: tuple[int, ...], lags: tuple[int, ...], within_parity: bool):
    """Return the same from a cache: most stacks of a session have equal exposure times."""
    when, rows = np.array(time), np.array(parity)
    usable = (rows[:, None] == rows[None, :]) if within_parity else np.ones((len(when), len(when)), bool)
    distance = np.abs(when[:, None] - when[None, :])
    pairs = [(distance == lag) & usable for lag in lags]
    project = centring(rows)
    centred = [project @ (distance == lag) @ project for lag in lags]
    return pairs, np.linalg.inv(np.array([[matrix[pair].mean() for matrix in centred] for pair in pairs]))


def truncation_bias(time: NDArray[np.int64], parity: NDArray[np.int64], lags: NDArray[np.int64]
           ) -> tuple[NDArray[np.int64], Array]:  # fmt: skip
    """Return the lags beyond the last one, and the bias of `autocovariance` by a covariance of 1 there.

    Returns `distance`: lags, exposures, shape (distance,); `added`: bias of the covariance at each lag, shape (lag,
    distance); negative, because centring removes what exposures have in common.
    """
    return _truncation_bias_of(tuple(time.tolist()), tuple(parity.tolist()), tuple(lags.tolist()))


@lru_cache(maxsize=64)
def _truncation_bias_of(
    time: tuple[int, ...], parity: tuple[int, ...], lags: tuple[int, ...]
) -> tuple[NDArray[np.int64], Array]:
    """Return the same from a cache."""
    when = np.array(time)
    pairs, solve = _solution_of(time, parity, lags, False)
    apart = np.abs(when[:, None] - when[None, :])
    distance = np.unique(apart[apart > lags[-1]])
    project = centring(np.array(parity))
    centred = [project @ (apart == one) @ project for one in distance]
    return distance, solve @ np.array([[one[pair].mean() for one in centred] for pair in pairs])


def n_effective_samples(
    time: NDArray[np.int64],
    parity: NDArray[np.int64],
    lags: NDArray[np.int64],
    correlation: Array,
    *,
    within_parity: bool = False,
) -> float:
    """Return the number of independent exposures that give the covariance at lag 0 the same uncertainty.

    `correlation`: correlation at the lags 1, 2, ..., shape (lag,).

    The estimate is a sum of products with weights M; for normal modes its relative variance is tr(P M P R P M P R).
    """
    known = tuple(np.asarray(correlation, float).tolist())
    return _n_effective_samples_of(
        tuple(time.tolist()), tuple(parity.tolist()), tuple(lags.tolist()), known, within_parity
    )


@lru_cache(maxsize=64)
def _n_effective_samples_of(
    time: tuple[int, ...],
    parity: tuple[int, ...],
    lags: tuple[int, ...],
    correlation: tuple[float, ...],
    within_parity: bool,
) -> float:
    """Return the same from a cache."""
    pairs, solve = _solution_of(time, parity, lags, within_parity)
    weight = sum(share * pair / pair.sum() for share, pair in zip(solve[0], pairs, strict=True))
    when = np.array(time)
    distance = np.abs(when[:, None] - when[None, :])
    known = np.concatenate([[1.0], correlation, np.zeros(max(0, distance.max() - len(correlation)))])
    project = centring(np.array(parity))
    chain = project @ weight @ project @ known[distance]
    return float(1.0 / np.trace(chain @ chain))


def error_correlation(time: NDArray[np.int64], parity: NDArray[np.int64], lags: NDArray[np.int64]) -> Array:
    """Return the correlation of the errors of `autocovariance` at all lags, shape (lag, lag).

    Exposures are independent; centring correlates the errors.
    """
    return _error_correlation_of(tuple(time.tolist()), tuple(parity.tolist()), tuple(lags.tolist()))


@lru_cache(maxsize=64)
def _error_correlation_of(time: tuple[int, ...], parity: tuple[int, ...], lags: tuple[int, ...]) -> Array:
    """Return the same from a cache."""
    pairs, solve = _solution_of(time, parity, lags, False)
    project = centring(np.array(parity))
    each = np.array([pair / pair.sum() for pair in pairs])
    weights = (project @ np.tensordot(solve, each, 1) @ project).reshape(len(lags), -1)
    covariance = weights @ weights.T
    return covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))


def usable_lags(time: NDArray[np.int64], parity: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Return the lags 0..most that can be estimated from centred exposures."""
    frames = int(np.bincount(parity).min())
    fields = len(np.unique(parity))
    longest = min(most, (frames // 2) * fields - (fields == 1)) if frames > 3 else 0
    gaps = set(np.abs(time[:, None] - time[None, :]).ravel().tolist())
    return np.array([lag for lag in range(longest + 1) if lag in gaps], np.int64)


@dataclass(frozen=True, kw_only=True)
class Exposures:
    """Successive exposures."""

    image: NDArray[np.float32]  # pixel values, shape (exposure, row, col), DN
    # time of each exposure in units of one exposure's period (a field of interlaced video), shape (exposure,)
    time: NDArray[np.int64]
    # rows of the frame it contains: 0 even, 1 odd; 0 for progressive frames. Shape (exposure,).
    parity: NDArray[np.int64]
    row_step: int  # frame rows per image row


def runs_of(stack: Sized) -> list[tuple[int, int]]:
    """Return the first and last-plus-one frame of blocks of nearly equal length, at least two frames each."""
    frames = len(stack)
    count = max(1, -(-frames // STACK.block_frames))
    edges = np.linspace(0, frames, count + 1).round().astype(int)
    return [(int(a), int(b)) for a, b in pairwise(edges)]


@dataclass(frozen=True, kw_only=True)
class Order:
    """Times and parities of exposures: `time`, `parity` and `row_step` as in `Exposures`."""

    time: NDArray[np.int64]
    parity: NDArray[np.int64]
    row_step: int


def order_of(frame_number: NDArray[np.int64], *, interlaced: bool) -> Order:
    """Return the time order of the exposures of frames; lost frames leave a gap."""
    number = np.asarray(frame_number, np.int64) - int(frame_number[0])
    if not interlaced:
        return Order(time=number, parity=np.zeros(len(number), np.int64), row_step=1)
    parity = np.tile([0, 1], len(number))
    return Order(time=2 * np.repeat(number, 2) + parity, parity=parity, row_step=2)


def split_fields(data: NDArray, row_step: int) -> list[NDArray]:
    """Return the fields of frames as views, each of shape (frame, row, col), without an unpaired last row."""
    rows = row_step * (data.shape[1] // row_step)
    return [data[:, parity:rows:row_step] for parity in range(row_step)]


def exposures(stack: FrameStack, first: int, last: int, *, interlaced: bool) -> Exposures:
    """Return the exposures of the frames first..last-1; lost frames leave a gap in time."""
    data = stack.data[first:last]
    stamped = len(stack.frame_number) == len(stack)
    order = order_of(stack.frame_number[first:last] if stamped else np.arange(first, last), interlaced=interlaced)
    image = np.stack(split_fields(data, order.row_step), axis=1).astype(np.float32)
    return Exposures(image=image.reshape(-1, *image.shape[2:]), time=order.time, parity=order.parity,
                     row_step=order.row_step)  # fmt: skip


def fluctuations(shots: Exposures) -> NDArray[np.float32]:
    """Return the temporal fluctuations: exposures less each pixel's mean and each exposure's mean.

    The pixel mean removes the fixed pattern, the exposure mean flicker. The fraction 1/N of white noise lost with the
    mean of N pixels is restored.
    """
    pixels = shots.image[0].size
    change = shots.image - shots.image.mean(axis=(1, 2), keepdims=True, dtype=np.float64).astype(np.float32)
    for parity in np.unique(shots.parity):
        same = shots.parity == parity
        change[same] -= change[same].mean(axis=0, keepdims=True)
    return change * np.float32(np.sqrt(pixels / max(pixels - 1, 1)))
