"""Numbers that fill a square evenly: for the rays of one place, and for those of neighbours together."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# The golden and silver ratios' plane sequence fills a square evenly (Roberts' R2 sequence).
R2 = np.array([0.7548776662466927, 0.5698402909980532])
# Places along the side of a tile that share a sequence.
TILE = 8


def fraction(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what numbers have beyond whole ones, in [0, 1): ten times as fast as NumPy's remainder."""
    return values - np.floor(values)


@dataclass(frozen=True)
class SequenceSlice:
    """A stretch of the sequence for each of several places.

    Parameters
    ----------
    start
        Its first pair for each place, in [0, 1), shape (place, 2).
    rays
        Pairs of each place.
    """

    start: NDArray[np.float64]
    rays: int

    @classmethod
    def drawn(cls, places: int, rays: int, rng: np.random.Generator) -> "SequenceSlice":
        """Return stretches that know nothing of each other."""
        return cls(rng.random((places, 2)), rays)

    def some(self, which: NDArray[np.int64]) -> "SequenceSlice":
        """Return those of some places."""
        return SequenceSlice(self.start[which], self.rays)

    def divide(self, parts: int) -> "SequenceSlice":
        """Return shorter stretches, so many for each place one after the other, that make up the same."""
        each = self.rays // parts
        start = self.start[:, None] + (each * np.arange(parts))[:, None] * R2
        return SequenceSlice(fraction(start.reshape(-1, 2)), each)

    def pairs(self) -> NDArray[np.float64]:
        """Return all pairs, shape (place, ray, 2)."""
        return fraction(self.start[:, None] + np.arange(self.rays)[:, None] * R2)


def low_discrepancy_points(row: NDArray[np.int64], col: NDArray[np.int64], rays: int, seed: list[int]) -> SequenceSlice:
    """Return stretches for rays of places on a grid, shifted by chance from tile to tile.

    The places of a tile take turns in one sequence, in an order in which every quarter of a tile is a stretch of it:
    together their rays are as even as those of one place.
    """
    tiles = (int(row.max(initial=0)) // TILE + 1, int(col.max(initial=0)) // TILE + 1)
    shift = np.random.default_rng(seed).random((*tiles, 2))[row // TILE, col // TILE]
    turn = np.zeros(len(row), np.int64)
    for bit in range(TILE.bit_length() - 1):
        turn |= (col >> bit & 1) << 2 * bit | (row >> bit & 1) << 2 * bit + 1
    return SequenceSlice(fraction(shift + (turn * rays)[:, None] * R2), rays)
