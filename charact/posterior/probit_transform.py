"""Coordinates without walls, in which a chain walks and a proposal fits."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri


class ProbitTransform:
    """Coordinates in which no parameter has walls: z = Phi^-1((x - low)/(high - low)) where both bounds are finite.

    A density that is cut off at a wall is awkward to propose for; in z it has the tail of a normal one.
    """

    def __init__(self, walls: NDArray) -> None:
        self.walls = walls
        self._bounded = np.isfinite(walls).all(axis=1)
        self._low = np.where(self._bounded, walls[:, 0], 0.0)
        self._range = np.where(self._bounded, walls[:, 1] - walls[:, 0], 1.0)

    def outside(self, points: NDArray) -> NDArray[np.float64]:
        """Return x carried to z; points on a wall are taken a millionth of the range off it."""
        share = np.clip((points - self._low) / self._range, 1e-6, 1.0 - 1e-6)
        return np.where(self._bounded, ndtri(share), points)

    def inside(self, points: NDArray) -> NDArray[np.float64]:
        """Return z carried to x."""
        return np.where(self._bounded, self._low + self._range * ndtr(points), points)

    def log_volume(self, points: NDArray) -> NDArray[np.float64]:
        """Return ln |dx/dz| of each point, up to a constant."""
        return -0.5 * np.sum(np.where(self._bounded, points, 0.0) ** 2, axis=-1)

    def stretch(self, point: NDArray) -> NDArray[np.float64]:
        """Return dz/dx at a point."""
        share = np.clip((point - self._low) / self._range, 1e-3, 1.0 - 1e-3)
        slope = np.sqrt(2.0 * np.pi) * np.exp(0.5 * ndtri(share) ** 2) / self._range
        return np.where(self._bounded, slope, 1.0)
