"""Image between two camera stages.

Consecutive linear blurs are deferred and applied in a single Fourier transform.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from simulate.camera.grid import ACCURACY, Grid, irfft_image, rfft_image
from simulate.camera.transfer import StageBlur, product


@dataclass(frozen=True, kw_only=True)
class StageImage:
    """Image between two stages."""

    values: NDArray  # amount per cell or per pixel, shape (..., row, col)
    # the lattice of cells; None once the image stands on the image's own pixels
    grid: Grid | None = None
    pending_blurs: tuple[StageBlur, ...] = ()  # blurs that are not yet applied to the values

    def with_values(self, values: NDArray) -> "StageImage":
        """Return the same image with other values."""
        return replace(self, values=values)

    def with_blurs(self, *blurs: StageBlur) -> "StageImage":
        """Return the image with further pending blurs."""
        return replace(self, pending_blurs=(*self.pending_blurs, *blurs))

    def with_blurs_applied(self) -> "StageImage":
        """Return the image with its pending blurs applied, on the same cells."""
        if not self.pending_blurs or self.grid is None:
            return self
        spectrum = rfft_image(self.values) * _transfer(self.pending_blurs, self.grid)
        return replace(
            self,
            values=irfft_image(spectrum, self.grid.shape).astype(self.values.dtype),
            pending_blurs=(),
        )

    def in_whole_rows(self) -> "StageImage":
        """Return the image summed into cells one row high, clipped at zero."""
        if self.grid is None or self.grid.per_row == 1:
            return self
        rows, columns = self.grid.shape[0] // self.grid.per_row, self.grid.shape[1]
        blocks = self.values.reshape(*self.values.shape[:-2], rows, self.grid.per_row, columns)
        grid = replace(self.grid, per_row=1, shape=(rows, columns))
        return replace(self, values=np.maximum(blocks.sum(axis=-2), 0.0), grid=grid)

    def resample_to(self, grid: Grid) -> "StageImage":
        """Return point samples on half as many cells per pixel, pending blurs applied.

        The average over a cell, which the finer cells hold, is undone up to
        `Accuracy.resampling_exact_cy_per_px`; amounts stay per cell.
        """
        fine = self.grid
        if fine is None or fine.per_column != 2 * grid.per_column:
            raise ValueError("light is resampled to half as many cells per pixel")
        rows, columns = fine.shape[0] // 2, fine.shape[1] // 2
        spectrum = rfft_image(self.values)
        half = rows // 2
        low_frequencies = np.concatenate(
            [spectrum[..., :half, :], spectrum[..., -half:, :]], axis=-2
        )[..., : columns // 2 + 1]
        # Four cells become one, and the inverse transform divides by a quarter of the number: the
        # two cancel.
        values = irfft_image(
            low_frequencies * _resampling(self.pending_blurs, fine, grid.per_column),
            (rows, columns),
        )
        # The extent of the grid in the wider one of the light.
        row = (fine.margin_rows - grid.margin_rows) * grid.per_row
        col = (fine.margin_columns - grid.margin_columns) * grid.per_column
        values = values[..., row : row + grid.shape[0], col : col + grid.shape[1]]
        return StageImage(values=np.ascontiguousarray(values, dtype=np.float32), grid=grid)


@lru_cache(maxsize=16)
def _transfer(pending: tuple[StageBlur, ...], grid: Grid) -> NDArray[np.float32]:
    fx, fy = grid.frequencies()
    return product(pending, *np.broadcast_arrays(fx, fy)).astype(np.float32)


@lru_cache(maxsize=2)
def _resampling(
    pending: tuple[StageBlur, ...], fine: Grid, per_pixel: int
) -> NDArray[np.complex64]:
    """Transfer of pending blurs, the inverse cell aperture and a shift by half a fine cell, at
    coarse frequencies.
    """
    rows, columns = fine.shape[0] // 2, fine.shape[1] // 2
    fx = np.fft.rfftfreq(columns, fine.pitch_x_mm / per_pixel)[None, :]
    fy = np.fft.fftfreq(rows, fine.pitch_y_mm / per_pixel)[:, None]
    x, y = fx * fine.pitch_x_mm, fy * fine.pitch_y_mm
    transfer = product(pending, *np.broadcast_arrays(fx, fy)) * _fade(x) * _fade(y)
    cell = np.sinc(x / fine.per_column) * np.sinc(y / fine.per_column)
    shift = np.exp(2j * np.pi * 0.5 * (x + y) / fine.per_column)
    return (transfer / cell * shift).astype(np.complex64)


def _fade(frequency_cy_per_px: NDArray[np.floating]) -> NDArray[np.float64]:
    exact = ACCURACY.resampling_exact_cy_per_px
    excess = (np.abs(frequency_cy_per_px) - exact) / (1.0 - exact)
    return np.cos(np.pi / 2.0 * np.clip(excess, 0.0, 1.0)) ** 2
