"""Coordinates in which each parameter by itself is about normal, so that a proposal also fits skewed margins."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Normal scores at which the margins of draws are pinned down, and the shares of draws below them.
INNER = np.linspace(-2.0, 2.0, 9)
SHARES = np.array([0.02275, 0.06681, 0.15866, 0.30854, 0.5, 0.69146, 0.84134, 0.93319, 0.97725])
# Pins beyond, one score apart, where margins are taken as so many times longer than they look: few draws have been
# there, and a walker in a tail that is longer than the proposal's stays in it.
LONGER = np.array([1.5, 2.5, 4.0])
BEYOND = INNER[-1] + 1.0 + np.arange(LONGER.size)
PINS = np.concatenate([-BEYOND[::-1], INNER, BEYOND])
STEPS = np.diff(PINS)
# Least distance of two pins as a share of the mean one: draws may repeat.
LEAST_WIDTH = 0.05


class NormalScores:
    """The map that gives each parameter of draws the quantiles of a standard normal, straight between pins.

    Parameters
    ----------
    draws
        Shape (draw, parameter).

    Notes
    -----
    Piecewise linear and carried on beyond the outer pins, hence exactly invertible with a known density: whatever the
    draws it is learnt from, a proposal made in scores has a density in the parameters.
    """

    def __init__(self, draws: Array) -> None:
        quantiles = np.quantile(draws, SHARES, axis=0).T
        mean = np.maximum(np.ptp(quantiles, axis=1) / (SHARES.size - 1), 1e-300)
        width = np.maximum(np.diff(quantiles, axis=1), LEAST_WIDTH * mean[:, None])
        longer = LONGER / (INNER[1] - INNER[0])
        below, above = width[:, :1] * longer[::-1], width[:, -1:] * longer
        self._width = np.concatenate([below, width, above], axis=1)
        self._left = quantiles[:, :1] - below.sum(axis=1, keepdims=True) + np.cumsum(self._width, axis=1) - self._width
        self._log_slope = np.log(STEPS / self._width)
        self._inner = self._left[:, 1:]
        self._first = STEPS.size * np.arange(draws.shape[1])

    def of(self, points: Array) -> tuple[Array, Array]:
        """Return the scores of points (point, parameter) and ln |d scores/d points|, shape (point,)."""
        piece = (points[:, :, None] > self._inner).sum(axis=2)
        left, width, log_slope = self._of(piece)
        return PINS[piece] + STEPS[piece] * (points - left) / width, log_slope

    def points(self, scores: Array) -> tuple[Array, Array]:
        """Return the points of scores (point, parameter) and ln |d scores/d points| there, shape (point,)."""
        piece = np.searchsorted(PINS[1:-1], scores)
        left, width, log_slope = self._of(piece)
        return left + width * (scores - PINS[piece]) / STEPS[piece], log_slope

    def _of(self, piece: NDArray[np.intp]) -> tuple[Array, Array, Array]:
        """Return left end and width of pieces between pins, and the log of the slopes that they make together."""
        at = piece + self._first
        return self._left.take(at), self._width.take(at), self._log_slope.take(at).sum(axis=1)
