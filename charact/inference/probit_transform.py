"""Unconstrained coordinates for sampling: probit transform of bounded parameters and normal scores
of margins.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

Array = NDArray[np.float64]


class ProbitTransform:
    """Unconstrained coordinates z = Phi^-1((x - low)/(high - low)) where both bounds are finite.

    A density truncated at a bound is difficult to propose for; in z it has a normal tail.
    """

    def __init__(self, walls: NDArray) -> None:
        self.walls = walls
        self._bounded = np.isfinite(walls).all(axis=1)
        self._low = np.where(self._bounded, walls[:, 0], 0.0)
        self._range = np.where(self._bounded, walls[:, 1] - walls[:, 0], 1.0)

    def outside(self, points: NDArray) -> NDArray[np.float64]:
        """Return z of x; points on a bound are moved inwards by a millionth of the range."""
        quantile = np.clip((points - self._low) / self._range, 1e-6, 1.0 - 1e-6)
        return np.where(self._bounded, ndtri(quantile), points)

    def inside(self, points: NDArray) -> NDArray[np.float64]:
        """Return x of z."""
        return np.where(self._bounded, self._low + self._range * ndtr(points), points)

    def log_volume(self, points: NDArray) -> NDArray[np.float64]:
        """Return ln |dx/dz| of each point, up to a constant."""
        return -0.5 * np.sum(np.where(self._bounded, points, 0.0) ** 2, axis=-1)

    def stretch(self, point: NDArray) -> NDArray[np.float64]:
        """Return dz/dx at a point."""
        quantile = np.clip((point - self._low) / self._range, 1e-3, 1.0 - 1e-3)
        slope = np.sqrt(2.0 * np.pi) * np.exp(0.5 * ndtri(quantile) ** 2) / self._range
        return np.where(self._bounded, slope, 1.0)


# Normal scores at which the margins are tabulated, and the corresponding quantiles.
INNER = np.linspace(-2.0, 2.0, 9)
SHARES = np.array([0.02275, 0.06681, 0.15866, 0.30854, 0.5, 0.69146, 0.84134, 0.93319, 0.97725])
# Further nodes, one score apart, with extended intervals: they contain few draws, and a walker
# would stay in a tail longer than the proposal's.
LONGER = np.array([1.5, 2.5, 4.0])
BEYOND = INNER[-1] + 1.0 + np.arange(LONGER.size)
PINS = np.concatenate([-BEYOND[::-1], INNER, BEYOND])
STEPS = np.diff(PINS)


class NormalScores:
    """Piecewise linear map of each parameter's draws to standard normal quantiles.

    Parameters
    ----------
    draws
        Shape (draw, parameter).

    Notes
    -----
    Piecewise linear and extrapolated beyond the outer nodes, hence exactly invertible with a known
    density: a proposal in scores has a density in the parameters for any draws.
    """

    def __init__(self, draws: Array) -> None:
        quantiles = np.quantile(draws, SHARES, axis=0).T
        mean = np.maximum(np.ptp(quantiles, axis=1) / (SHARES.size - 1), 1e-300)
        width = np.maximum(np.diff(quantiles, axis=1), 0.05 * mean[:, None])
        longer = LONGER / (INNER[1] - INNER[0])
        low_tail, high_tail = width[:, :1] * longer[::-1], width[:, -1:] * longer
        self._width = np.concatenate([low_tail, width, high_tail], axis=1)
        self._left = (
            quantiles[:, :1]
            - low_tail.sum(axis=1, keepdims=True)
            + np.cumsum(self._width, axis=1)
            - self._width
        )
        self._log_slope = np.log(STEPS / self._width)
        self._inner = self._left[:, 1:]
        self._first = STEPS.size * np.arange(draws.shape[1])

    def of(self, points: Array) -> tuple[Array, Array]:
        """Return the scores of points (point, parameter) and ln |d scores/d points|, shape
        (point,).
        """
        piece = (points[:, :, None] > self._inner).sum(axis=2)
        start, width, log_slope = self._of(piece)
        return PINS[piece] + STEPS[piece] * (points - start) / width, log_slope

    def points(self, scores: Array) -> tuple[Array, Array]:
        """Return the points of scores (point, parameter) and ln |d scores/d points| there, shape
        (point,).
        """
        piece = np.searchsorted(PINS[1:-1], scores)
        start, width, log_slope = self._of(piece)
        return start + width * (scores - PINS[piece]) / STEPS[piece], log_slope

    def _of(self, piece: NDArray[np.intp]) -> tuple[Array, Array, Array]:
        """Return left end and width of pieces between pins, and the log of the slopes that they
        make together.
        """
        at = piece + self._first
        return self._left.take(at), self._width.take(at), self._log_slope.take(at).sum(axis=1)
