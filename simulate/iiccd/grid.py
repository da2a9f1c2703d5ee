"""The lattice of cells on which light is carried: finer than the pixels, wider than the picture."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Cells per pixel and margins around the picture.

    Parameters
    ----------
    rows, columns
        Physical pixels of the chip that the picture needs.
    per_column, per_row
        Cells per pixel along a row and along a column.
    margin_rows, margin_columns
        Pixels added before the first row and column; after the last, what the shape leaves.
    shape
        Cells, (row, col).
    pitch_x_mm, pitch_y_mm
        Pixel pitch at the photocathode, mm.
    """

    rows: int
    columns: int
    per_column: int
    per_row: int
    margin_rows: int
    margin_columns: int
    shape: tuple[int, int]
    pitch_x_mm: float
    pitch_y_mm: float

    @property
    def cell_area_cm2(self) -> float:
        """Area of one cell at the photocathode, cm2."""
        return self.pitch_x_mm * self.pitch_y_mm / (self.per_column * self.per_row) * 1e-2

    def frequencies(self) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Frequencies (fx (1, col), fy (row, 1)) of this grid's real Fourier transform, cycles/mm at the cathode."""
        rows, columns = self.shape
        fx = np.fft.rfftfreq(columns, self.pitch_x_mm / self.per_column)[None, :]
        fy = np.fft.fftfreq(rows, self.pitch_y_mm / self.per_row)[:, None]
        return fx, fy

    def whole_rows(self) -> "Grid":
        """Return the grid of the same extent whose cells are one row high."""
        return replace(self, per_row=1, shape=(self.shape[0] // self.per_row, self.shape[1]))

    def window_of(self, other: "Grid") -> tuple[slice, slice]:
        """Slices that cut this grid's extent out of an image with this grid's cells and `other`'s wider extent."""
        row = (other.margin_rows - self.margin_rows) * self.per_row
        col = (other.margin_columns - self.margin_columns) * self.per_column
        return slice(row, row + self.shape[0]), slice(col, col + self.shape[1])


def grid_with_margin(
    rows: int, columns: int, *, per_pixel: int, margin: int, pitch_x_mm: float, pitch_y_mm: float
) -> Grid:
    """Return a grid with at least `margin` pixels on every side and a shape that transforms fast."""
    shape = (fast_length((rows + 2 * margin) * per_pixel), fast_length((columns + 2 * margin) * per_pixel))
    return Grid(
        rows=rows,
        columns=columns,
        per_column=per_pixel,
        per_row=per_pixel,
        margin_rows=margin,
        margin_columns=margin,
        shape=shape,
        pitch_x_mm=pitch_x_mm,
        pitch_y_mm=pitch_y_mm,
    )


def fast_length(length: int) -> int:
    """Return the next length that is a multiple of 8, has small factors and is no power of two."""
    from scipy.fft import next_fast_len

    # Rows a power of two apart fall on the same cache lines: 1024 takes twice the time of 1050.
    while length % 8 or next_fast_len(length, real=True) != length or length & (length - 1) == 0:
        length += 1
    return length
