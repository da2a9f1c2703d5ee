"""Sensor geometry: the lattice of cells on which images are computed, and its Fourier transforms."""

import zlib
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdata.sensor import Sensor
from labdata.solid_state import SolidStateCamera


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Cells per pixel and margins around the image.

    Parameters
    ----------
    rows, columns
        Physical pixels of the chip that the image needs.
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


def rfft_image(image: NDArray) -> NDArray[Any]:
    """Return the transform of real images (..., row, col), its last axis half as long plus one."""
    from scipy import fft

    transform: Any = fft.rfft2(image)
    return transform


def irfft_image(transform: NDArray, shape: tuple[int, int]) -> NDArray[Any]:
    """Return the real images (..., row, col) of the given shape that have a transform."""
    from scipy import fft

    image: Any = fft.irfft2(transform, s=shape)
    return image


# The image of a target is needed this far beyond the frame: the halo reaches 23 pixels.
SCENE_MARGIN_PX = 40
DRAW_MARGIN_PX = 10
# Dark current is stated at this temperature.
DARK_REFERENCE_C = 25.0


class SensorGeometryCamera(ABC):
    """Frame and cells of a camera, with or without a tube."""

    @property
    @abstractmethod
    def camera_description(self) -> Sensor | SolidStateCamera:
        """Its description."""

    @property
    @abstractmethod
    def is_interlaced(self) -> bool:
        """Whether a frame is two fields exposed one after the other."""

    @property
    def demagnification(self) -> float:
        """Size of the image where light arrives over its size on the chip, dimensionless."""
        return 1.0

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of a frame."""
        return self.camera_description.ccd.rows, self.camera_description.ccd.columns

    @property
    def pattern_seed(self) -> int:
        """Seed of the fixed patterns, which belong to the camera of this name."""
        return zlib.crc32(self.camera_description.name.encode())

    @cached_property
    def cells(self) -> Grid:
        """Cells on which photoelectrons are drawn or collected, two per pixel."""
        return self._grid(2, DRAW_MARGIN_PX)

    @cached_property
    def scene_cells(self) -> Grid:
        """Cells on which the scene arrives, four per pixel."""
        return self._grid(4, SCENE_MARGIN_PX)

    def _grid(self, per_pixel: int, margin: int) -> Grid:
        ccd, (rows, columns) = self.camera_description.ccd, self.shape
        # Field integration sums rows r and r + 1, so the chip has one row more than the frame.
        return grid_with_margin(
            rows + (1 if self.is_interlaced else 0),
            columns,
            per_pixel=per_pixel,
            margin=margin,
            pitch_x_mm=float(ccd.pitch_x_um) * self.demagnification * 1e-3,
            pitch_y_mm=float(ccd.pitch_y_um) * self.demagnification * 1e-3,
        )
