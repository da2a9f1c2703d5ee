"""Where the camera looks: the cells of its picture as places on the target's plane."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class TargetView:
    """A rectangle of cells on the plane of the target, seen from a point in front of its centre.

    Parameters
    ----------
    shape
        Cells, (row, col).
    cell_px
        Size of a cell (x, y), column pitches.
    corner_px
        Corner of the first cell (x, y) relative to the target's centre, column pitches.
    metre_per_px
        Size of a column pitch on the target's plane, m.
    distance_m
        Distance of the lens, m.
    eye_px
        Where the optical axis meets the plane (x, y), relative to the target's centre, column pitches.
    """

    shape: tuple[int, int]
    cell_px: tuple[float, float]
    corner_px: tuple[float, float]
    metre_per_px: float
    distance_m: float
    eye_px: tuple[float, float] = (0.0, 0.0)

    def tiles(self, rows: int) -> Iterator[tuple[slice, "TargetView"]]:
        """Yield bands of at most `rows` rows of cells, each with its place in the whole."""
        for start in range(0, self.shape[0], rows):
            stop = min(start + rows, self.shape[0])
            corner = (self.corner_px[0], self.corner_px[1] + start * self.cell_px[1])
            yield slice(start, stop), replace(self, shape=(stop - start, self.shape[1]), corner_px=corner)

    def places_px(self, row: NDArray[np.floating], col: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return places (x, y) of cell coordinates, whole numbers at the corners of cells, shape (place, 2)."""
        x = self.corner_px[0] + col * self.cell_px[0]
        y = self.corner_px[1] + row * self.cell_px[1]
        return np.stack([x, y], axis=-1)

    def cells_px(self, place_px: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return cell coordinates (row, col) of places (x, y), shape (place, 2)."""
        return (place_px[:, ::-1] - np.array(self.corner_px[::-1])) / np.array(self.cell_px[::-1])

    def rays(self, place_px: NDArray[np.floating]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Return origins and directions, m, of rays from the lens to places (x, y), each of shape (ray, 3)."""
        eye = np.array([*np.multiply(self.eye_px, self.metre_per_px), -self.distance_m])
        towards = np.column_stack([place_px * self.metre_per_px, np.zeros(len(place_px))]) - eye
        return np.broadcast_to(eye, towards.shape), towards
