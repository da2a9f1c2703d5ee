"""A picture cut into square tiles, in which a few pixels stand for the rest."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Tiles along the shorter side of a small picture, whose pixels have less in common.
FEWEST = 16


@dataclass(frozen=True)
class Tiles:
    """Tiles of a picture; those at its lower and right border may be cut.

    Parameters
    ----------
    shape
        Pixels of the picture, (row, col).
    side
        Side of a tile, px.
    """

    shape: tuple[int, int]
    side: int

    @classmethod
    def of(cls, shape: tuple[int, int], side: int) -> "Tiles":
        """Return tiles of a side, px, or smaller ones where the picture is small."""
        return cls(shape, int(np.clip(min(shape) // FEWEST, 1, side)))

    @property
    def count(self) -> tuple[int, int]:
        """How many there are, (down, across)."""
        return -(-self.shape[0] // self.side), -(-self.shape[1] // self.side)

    @property
    def of_pixels(self) -> NDArray[np.int64]:
        """Where the tiles of all pixels are, (down, across), shape (2, row, col)."""
        return np.indices(self.shape) // self.side

    def holding(self, pixel: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return where the tiles of some pixels are, (down, across), each of shape (pixel,)."""
        return pixel // self.shape[1] // self.side, pixel % self.shape[1] // self.side

    def some_pixels(self, many: int, rng: np.random.Generator) -> NDArray[np.int64]:
        """Draw numbers of so many pixels of each tile, tile by tile."""
        down, across = self.count
        corner = self.side * np.indices((down, across)).reshape(2, -1, 1)
        at = corner + np.moveaxis(rng.integers(0, self.side, (down * across, many, 2)), -1, 0)
        row, col = (np.minimum(axis, length - 1) for axis, length in zip(at, self.shape, strict=True))
        return (row * self.shape[1] + col).ravel()

    def one_of_each(self, pixel: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return of some pixels the first in each tile."""
        down, across = self.holding(pixel)
        return pixel[np.unique(down * self.count[1] + across, return_index=True)[1]]


def with_neighbours(grid: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the sum of each tile (kind, down, across) and the eight around it."""
    wide = np.pad(grid, ((0, 0), (1, 1), (1, 1)))
    down = wide[:, :-2] + wide[:, 1:-1] + wide[:, 2:]
    return down[:, :, :-2] + down[:, :, 1:-1] + down[:, :, 2:]
