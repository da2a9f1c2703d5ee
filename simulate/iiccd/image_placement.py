"""Where a picture lies on the chip: its pixels laid on cells, so that every pixel as read gets its own light."""

import numpy as np
from numpy.typing import NDArray

from simulate.iiccd.grid import Grid


def place_on_cells(image: NDArray, grid: Grid, *, row_pairs: bool) -> NDArray[np.float32]:
    """Return an image of any size on cells, each cell the average of what it covers.

    Parameters
    ----------
    image
        A quantity per area, shape (row, col), which covers the picture exactly.
    grid
        Cells.
    row_pairs
        True where row r of a frame sums rows r and r + 1 of the chip, which has one row more than the frame. The
        picture then reaches from the middle of the chip's first row to the middle of its last, so that every row of it
        is centred on the row of the frame that reads it; half the light of that row comes from it and a quarter from
        each neighbour.

    Notes
    -----
    Beyond its border the picture goes on as it ends there.
    """
    first, rows = (0.5, grid.rows - 1) if row_pairs else (0.0, grid.rows)
    down = _overlaps(image.shape[0], grid.shape[0], (grid.margin_rows + first) * grid.per_row, rows * grid.per_row)
    right = _overlaps(
        image.shape[1], grid.shape[1], grid.margin_columns * grid.per_column, grid.columns * grid.per_column
    )
    return np.asarray(down @ (right @ np.asarray(image, np.float32).T).T, np.float32)


def _overlaps(pixels: int, cells: int, start: float, length: float):
    """Share of each cell that each pixel covers, a sparse matrix (cell, pixel), for pixels that fill start..+length."""
    from scipy.sparse import csr_array

    borders = start + length * np.arange(pixels + 1) / pixels
    borders[0], borders[-1] = min(borders[0], 0.0), max(borders[-1], float(cells))
    edges = np.union1d(np.arange(cells + 1.0), np.clip(borders, 0.0, cells))
    middle, width = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
    pixel = np.clip(np.searchsorted(borders, middle, side="right") - 1, 0, pixels - 1)
    return csr_array((width.astype(np.float32), (middle.astype(int), pixel)), shape=(cells, pixels))
