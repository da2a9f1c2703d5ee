"""Images displaced: radial distortion and any other static map from where light lands to where it came from."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.iiccd.grid import Grid

Array = NDArray[np.floating]

# Distances from the axis, in corner radii, over which a distortion is inverted.
FARTHEST, STEPS = 2.0, 4096


@dataclass(frozen=True, kw_only=True)
class Radial:
    """Radial distortion r' = r (1 + D (r/R)^2): a point at r lands at r'.

    Parameters
    ----------
    fraction
        D, displacement at the corner over its distance from the axis, dimensionless; positive is pincushion.
    corner_mm
        R, the corner's distance from the axis, mm.

    Raises
    ------
    BadInput
        If the map would fold: D must lie above -1/12, so that r' grows with r out to `FARTHEST` corner radii.
    """

    fraction: float
    corner_mm: float

    def __post_init__(self) -> None:
        if not -1.0 / (3.0 * FARTHEST**2) < self.fraction < 1.0:
            raise BadInput(f"a distortion must lie between -1/12 and 1 at the corner, got {self.fraction:g}")

    def source(self, x_mm: Array, y_mm: Array) -> tuple[Array, Array, Array]:
        """Return where light that lands at places about the axis came from, and its area there over that here.

        Notes
        -----
        Area ratio 1 / ((1 + D s^2)(1 + 3 D s^2)), s = r/R: light per area thins out where the picture is stretched.
        """
        came = np.linspace(0.0, FARTHEST, STEPS)
        lands = came * (1.0 + self.fraction * came**2)
        landed = np.hypot(x_mm, y_mm) / self.corner_mm
        s = np.interp(landed, lands, came).astype(landed.dtype)
        stretch = self.fraction * s * s
        shrink = 1.0 / (1.0 + stretch)
        return x_mm * shrink, y_mm * shrink, shrink / (1.0 + 3.0 * stretch)


def cell_centres(grid: Grid) -> tuple[Array, Array]:
    """Return x (1, col) and y (row, 1) of cell centres about the middle of the picture, mm at the photocathode."""
    rows, columns = grid.shape
    x = (np.arange(columns) + 0.5) / grid.per_column - grid.margin_columns - 0.5 * grid.columns
    y = (np.arange(rows) + 0.5) / grid.per_row - grid.margin_rows - 0.5 * grid.rows
    return x[None, :] * grid.pitch_x_mm, y[:, None] * grid.pitch_y_mm


def corner_mm(grid: Grid) -> float:
    """Return the distance of the picture's corner from its middle, mm at the photocathode."""
    return 0.5 * float(np.hypot(grid.columns * grid.pitch_x_mm, grid.rows * grid.pitch_y_mm))


def resample_image(image: NDArray, grid: Grid, x_mm: Array, y_mm: Array, *, order: int) -> NDArray[np.float32]:
    """Return an image whose cells show what lies at other places of it; beyond its border it goes on as it ends.

    Parameters
    ----------
    image
        Shape (row, col), amounts per cell.
    grid
        Its cells.
    x_mm, y_mm
        Where each cell's light comes from, about the middle of the picture, shape (row, col), mm.
    order
        1: linear, never below zero; loses up to 8 % of the contrast at an eighth of a cycle per cell. 3: cubic splines,
        for images without sharp steps.
    """
    from scipy.ndimage import map_coordinates

    row = (y_mm / grid.pitch_y_mm + 0.5 * grid.rows + grid.margin_rows) * grid.per_row - 0.5
    col = (x_mm / grid.pitch_x_mm + 0.5 * grid.columns + grid.margin_columns) * grid.per_column - 0.5
    found = np.empty(image.shape, np.float32)
    map_coordinates(image.astype(np.float32, copy=False), [row, col], output=found, order=order, mode="nearest")
    return found
