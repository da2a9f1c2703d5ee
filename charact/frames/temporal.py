"""Unbiased temporal autocovariance from few centred exposures, and the time order of exposures."""

from collections.abc import Sized
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from charact.frames.thresholds import STACK

Array = NDArray[np.float64]
Whole = NDArray[np.int64]


def centring(parity: Whole) -> Array:
    """Return the projection that subtracts the mean over time of each parity, shape (exposure,
    exposure).
    """
    same = (parity[:, None] == parity[None, :]).astype(float)
    return np.eye(len(parity)) - same / same.sum(axis=1, keepdims=True)


def autocovariance(
    products: Array, time: Whole, parity: Whole, lags: Whole, *, within_parity: bool = False
) -> Array:
    """Return the unbiased autocovariance at the given lags from products of centred exposures,
    shape (..., lag).

    `products`: mean products of exposures i and j, shape (..., exposure, exposure). `time`,
    `parity`: as in `Order`. `lags`: lags of nonzero covariance, 0 first, exposures.
    `within_parity`: whether to compare only exposures of the same rows (no odd lags of interlaced
    video).

    Centring replaces the covariance matrix C by P C P, which is linear in the covariances c(lag).
    The mean A c over the pairs of each lag is solved for c. For independent exposures this is the
    factor n/(n-1).
    """
    pairs, solve = _solution(time, parity, lags, within_parity)
    measured = np.stack([products[..., pair].mean(axis=-1) for pair in pairs], axis=-1)
    return measured @ solve.T


def _solution(
    time: Whole, parity: Whole, lags: Whole, within_parity: bool
) -> tuple[list[NDArray[np.bool_]], Array]:
    """Return the pairs of every lag, and the matrix that inverts the centring."""
    distance = np.abs(time[:, None] - time)
    usable = (parity[:, None] == parity) | (not within_parity)
    pairs = [(distance == lag) & usable for lag in lags]
    project = centring(parity)
    centred = [project @ (distance == lag) @ project for lag in lags]
    return pairs, np.linalg.inv(
        np.array([[matrix[pair].mean() for matrix in centred] for pair in pairs])
    )


def truncation_bias(time: Whole, parity: Whole, lags: Whole) -> tuple[Whole, Array]:
    """Return the lags beyond the last one, and the bias of `autocovariance` by a covariance of 1
    there.

    The bias has shape (lag, distance) and is negative, because centring removes what exposures have
    in common.
    """
    pairs, solve = _solution(time, parity, lags, False)
    separation = np.abs(time[:, None] - time)
    distance = np.unique(separation[separation > lags[-1]])
    project = centring(parity)
    centred = [project @ (separation == lag) @ project for lag in distance]
    return distance, solve @ np.array([[lag[pair].mean() for lag in centred] for pair in pairs])


def n_effective_samples(
    time: Whole, parity: Whole, lags: Whole, correlation: Array, *, within_parity: bool = False
) -> float:
    """Return the number of independent exposures that give the covariance at lag 0 the same
    uncertainty.

    `correlation`: at the lags 1, 2, .... The estimate is a sum of products with weights M; for
    normal modes its relative variance is tr(P M P R P M P R).
    """
    pairs, solve = _solution(time, parity, lags, within_parity)
    weight = sum(
        pair_weight * pair / pair.sum() for pair_weight, pair in zip(solve[0], pairs, strict=True)
    )
    distance = np.abs(time[:, None] - time)
    known = np.concatenate(
        [[1.0], correlation, np.zeros(max(0, distance.max() - len(correlation)))]
    )
    project = centring(parity)
    chain = project @ weight @ project @ known[distance]
    return float(1.0 / np.trace(chain @ chain))


def error_correlation(time: Whole, parity: Whole, lags: Whole) -> Array:
    """Return the correlation of the errors of `autocovariance` at all lags, shape (lag, lag).

    Exposures are independent; centring correlates the errors.
    """
    pairs, solve = _solution(time, parity, lags, False)
    project = centring(parity)
    pair_weights = np.array([pair / pair.sum() for pair in pairs])
    weights = (project @ np.tensordot(solve, pair_weights, 1) @ project).reshape(len(lags), -1)
    covariance = weights @ weights.T
    return covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))


def usable_lags(time: Whole, parity: Whole, max_lag: int) -> Whole:
    """Return the lags 0..most that can be estimated from centred exposures."""
    frames = int(np.bincount(parity).min())
    fields = len(np.unique(parity))
    longest = min(max_lag, (frames // 2) * fields - (fields == 1)) if frames > 3 else 0
    gaps = set(np.abs(time[:, None] - time[None, :]).ravel().tolist())
    return np.array([lag for lag in range(longest + 1) if lag in gaps], np.int64)


def same_row_lags(lags: Whole, parity: Whole) -> Whole:
    """Return the lags between exposures of the same rows."""
    return lags[lags % 2 == 0] if len(np.unique(parity)) > 1 else lags


def runs_of(stack: Sized) -> list[tuple[int, int]]:
    """Return the first and last-plus-one frame of blocks of nearly equal length, at least two
    frames each.
    """
    frames = len(stack)
    count = max(1, -(-frames // STACK.block_frames))
    edges = np.linspace(0, frames, count + 1).round().astype(int)
    return [(int(a), int(b)) for a, b in pairwise(edges)]


@dataclass(frozen=True, kw_only=True)
class Order:
    """Times and parities of exposures."""

    # in units of one exposure's period (a field of interlaced video), shape (exposure,)
    time: Whole
    # rows of the frame in each exposure: 0 even, 1 odd; 0 for progressive frames, shape (exposure,)
    parity: Whole
    row_step: int  # frame rows per image row


def order_of(frame_number: Whole, *, interlaced: bool) -> Order:
    """Return the time order of the exposures of frames; lost frames leave a gap."""
    number = np.asarray(frame_number, np.int64) - int(frame_number[0])
    if not interlaced:
        return Order(time=number, parity=np.zeros(len(number), np.int64), row_step=1)
    parity = np.tile([0, 1], len(number))
    return Order(time=2 * np.repeat(number, 2) + parity, parity=parity, row_step=2)


def split_fields(data: NDArray, row_step: int) -> list[NDArray]:
    """Return the fields of frames as views, each of shape (frame, row, col), without an unpaired
    last row.
    """
    rows = row_step * (data.shape[1] // row_step)
    return [data[:, parity:rows:row_step] for parity in range(row_step)]


@dataclass(frozen=True, kw_only=True)
class LevelChange:
    """Change of the level within a stack: a step, or a slow drift."""

    frames: int  # frames of the stack
    after: int | None  # frames before the step; None of a drift
    size_dn: float  # height of the step, or change from first to last frame, DN
    departure_dn: float  # largest distance of the level of a frame from the mean of all, DN

    def __str__(self) -> str:
        way = "up" if self.size_dn > 0 else "down"
        if self.after is None:
            return f"drifts {way} by {abs(self.size_dn):.3g} DN from first to last frame"
        return (
            f"steps {way} by {abs(self.size_dn):.3g} DN after frame {self.after} of {self.frames}"
        )


def level_change(means: Array, noise_dn: float) -> LevelChange | None:
    """Return the step or drift of the means of frames, shape (frame,), DN; None if there is none.

    Of the best step and the line the one with the smaller residual is tested against no change by
    the F distribution, over all positions of a step. `noise_dn`: standard deviation of a mean by
    the noise of pixels, DN, at least which is expected of the residual.
    """
    from scipy.special import fdtrc

    n = len(means)
    if n < STACK.min_change_frames:
        return None
    means = means - means.mean()
    at = np.arange(1, n)
    before = np.cumsum(means)[:-1]
    of_steps = before**2 * n / (at * (n - at))
    time = np.linspace(-0.5, 0.5, n)
    slope = float(time @ means / (time @ time))
    of_line, best = slope**2 * float(time @ time), int(np.argmax(of_steps))
    is_step = of_steps[best] > of_line
    explained = max(float(of_steps[best]), of_line)
    variance = max((float(means @ means) - explained) / (n - 2 - is_step), noise_dn**2, 1e-24)
    if fdtrc(1, n - 2 - is_step, explained / variance) * n > STACK.false_alarm:
        return None
    if not is_step:
        return LevelChange(frames=n, after=None, size_dn=slope, departure_dn=0.5 * abs(slope))
    low, high = float(before[best] / at[best]), float(-before[best] / (n - at[best]))
    return LevelChange(
        frames=n, after=int(at[best]), size_dn=high - low, departure_dn=max(abs(low), abs(high))
    )
