"""Low-discrepancy points in the unit square (R2 sequence), for the rays of one point and of neighbouring points."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Increments of the R2 sequence (Roberts, 2018): powers of the inverse plastic number.
R2 = np.array([0.7548776662466927, 0.5698402909980532])
# Grid points along the side of a tile that use one sequence.
TILE = 8


def fraction(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the fractional part, in [0, 1): ten times as fast as NumPy's remainder."""
    return values - np.floor(values)


@dataclass(frozen=True)
class SequenceSlice:
    """A slice of the sequence for each of several points.

    Parameters
    ----------
    start
        First pair of each point, in [0, 1), shape (point, 2).
    rays
        Pairs of each point.
    """

    start: NDArray[np.float64]
    rays: int

    @classmethod
    def random(cls, places: int, rays: int, rng: np.random.Generator) -> "SequenceSlice":
        """Return slices with independent random starts."""
        return cls(rng.random((places, 2)), rays)

    def some(self, which: NDArray[np.int64]) -> "SequenceSlice":
        """Return the slices of some points."""
        return SequenceSlice(self.start[which], self.rays)

    def divide(self, parts: int) -> "SequenceSlice":
        """Split each slice into equal consecutive parts."""
        each = self.rays // parts
        start = self.start[:, None] + (each * np.arange(parts))[:, None] * R2
        return SequenceSlice(fraction(start.reshape(-1, 2)), each)

    def pairs(self) -> NDArray[np.float64]:
        """Return all pairs, shape (point, ray, 2)."""
        return fraction(self.start[:, None] + np.arange(self.rays)[:, None] * R2)


def low_discrepancy_points(row: NDArray[np.int64], col: NDArray[np.int64], rays: int, seed: list[int]) -> SequenceSlice:
    """Return slices for rays of points on a grid, with a random shift for each tile.

    The points of a tile use consecutive slices in Morton order, so that every quarter of a tile is one slice: the rays
    of a neighbourhood are together as uniform as those of one point.
    """
    tiles = (int(row.max(initial=0)) // TILE + 1, int(col.max(initial=0)) // TILE + 1)
    shift = np.random.default_rng(seed).random((*tiles, 2))[row // TILE, col // TILE]
    turn = np.zeros(len(row), np.int64)
    for bit in range(TILE.bit_length() - 1):
        turn |= (col >> bit & 1) << 2 * bit | (row >> bit & 1) << 2 * bit + 1
    return SequenceSlice(fraction(shift + (turn * rays)[:, None] * R2), rays)
