"""Placement of images on cells: resampling to the lattice, radial distortion and other static
displacements.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.arrays import Array, Array32
from simulate.camera.grid import ACCURACY, Grid


def place_on_cells(image: NDArray, grid: Grid, *, row_pairs: bool) -> Array32:
    """Return an image of any size on cells, each cell the average of what it covers.

    Parameters
    ----------
    image
        A quantity per area, shape (row, col), which covers the image exactly.
    grid
        Cells.
    row_pairs
        True where row r of a frame sums rows r and r + 1 of the chip, which has one row more than
        the frame. The image then reaches from the middle of the chip's first row to the middle of
        its last, so that every row of it is centred on the row of the frame that reads it; half the
        light of that row comes from it and a quarter from each neighbour.

    Notes
    -----
    Beyond its border the image goes on as it ends there.
    """
    start, rows = (0.5, grid.rows - 1) if row_pairs else (0.0, grid.rows)
    row_overlaps = _overlaps(
        image.shape[0],
        grid.shape[0],
        (grid.margin_rows + start) * grid.per_row,
        rows * grid.per_row,
    )
    col_overlaps = _overlaps(
        image.shape[1],
        grid.shape[1],
        grid.margin_columns * grid.per_column,
        grid.columns * grid.per_column,
    )
    return np.asarray(row_overlaps @ (col_overlaps @ np.asarray(image, np.float32).T).T, np.float32)


def _overlaps(pixels: int, cells: int, start: float, length: float):
    """Fraction of each cell covered by each pixel, sparse (cell, pixel), for pixels that fill
    start..start + length.
    """
    from scipy.sparse import csr_array

    borders = start + length * np.arange(pixels + 1) / pixels
    borders[0], borders[-1] = min(borders[0], 0.0), max(borders[-1], float(cells))
    edges = np.union1d(np.arange(cells + 1.0), np.clip(borders, 0.0, cells))
    centre, width = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
    pixel = np.clip(np.searchsorted(borders, centre, side="right") - 1, 0, pixels - 1)
    return csr_array((width.astype(np.float32), (centre.astype(int), pixel)), shape=(cells, pixels))


@dataclass(frozen=True, kw_only=True)
class Radial:
    """Radial distortion r' = r (1 + D (r/R)^2): a point at r lands at r'.

    Raises
    ------
    BadInput
        If the map would fold: D must lie above -1/12, so that r' grows with r out to
        `Accuracy.max_distortion_radius` corner radii.
    """

    # D, displacement at the corner over its distance from the axis, dimensionless; positive is
    # pincushion.
    fraction: float
    corner_mm: float  # r, the corner's distance from the axis, mm

    def __post_init__(self) -> None:
        if not -1.0 / (3.0 * ACCURACY.max_distortion_radius**2) < self.fraction < 1.0:
            raise BadInput(
                f"a distortion must lie between -1/12 and 1 at the corner, got {self.fraction:g}"
            )

    def source(self, x_mm: Array, y_mm: Array) -> tuple[Array, Array, Array]:
        """Return where light that lands at places about the axis came from, and its area there over
        that here.

        Notes
        -----
        Area ratio 1 / ((1 + D s^2)(1 + 3 D s^2)), s = r/R: light per area thins out where the image
        is stretched.
        """
        radius_table = np.linspace(0.0, ACCURACY.max_distortion_radius, ACCURACY.n_distortion_steps)
        lands = radius_table * (1.0 + self.fraction * radius_table**2)
        landed = np.hypot(x_mm, y_mm) / self.corner_mm
        s = np.interp(landed, lands, radius_table).astype(landed.dtype)
        growth = self.fraction * s * s
        shrink = 1.0 / (1.0 + growth)
        return x_mm * shrink, y_mm * shrink, shrink / (1.0 + 3.0 * growth)


def cell_centres(grid: Grid) -> tuple[Array, Array]:
    """Return x (1, col) and y (row, 1) of cell centres about the middle of the image, mm at the
    photocathode.
    """
    rows, columns = grid.shape
    x = (np.arange(columns) + 0.5) / grid.per_column - grid.margin_columns - 0.5 * grid.columns
    y = (np.arange(rows) + 0.5) / grid.per_row - grid.margin_rows - 0.5 * grid.rows
    return x[None, :] * grid.pitch_x_mm, y[:, None] * grid.pitch_y_mm


def corner_mm(grid: Grid) -> float:
    """Return the distance of the image's corner from its middle, mm at the photocathode."""
    return 0.5 * float(np.hypot(grid.columns * grid.pitch_x_mm, grid.rows * grid.pitch_y_mm))


def resample_image(image: NDArray, grid: Grid, x_mm: Array, y_mm: Array, *, order: int) -> Array32:
    """Return an image whose cells show what lies at other places of it, mm about its middle.

    Beyond its border the image goes on as it ends. Order 1 is linear, never below zero, and loses
    up to 8 % of the contrast at an eighth of a cycle per cell; order 3, cubic splines, is for
    images without sharp steps.
    """
    from scipy.ndimage import map_coordinates

    row = (y_mm / grid.pitch_y_mm + 0.5 * grid.rows + grid.margin_rows) * grid.per_row - 0.5
    col = (
        x_mm / grid.pitch_x_mm + 0.5 * grid.columns + grid.margin_columns
    ) * grid.per_column - 0.5
    resampled = np.empty(image.shape, np.float32)
    map_coordinates(
        image.astype(np.float32, copy=False),
        [row, col],
        output=resampled,
        order=order,
        mode="nearest",
    )
    return resampled
