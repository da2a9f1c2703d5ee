"""Accuracy parameters, the lattice of cells on which images are computed, and the frame of a camera
on it.
"""

import zlib
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from labdata import Camera, Conditions


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """Tolerances of the approximations that stages and samplers make; dimensionless unless a unit
    is given.
    """

    # The image of a target is needed this far beyond the frame, pixels: the halo reaches 23 pixels.
    scene_margin_px: int = 40
    draw_margin_px: int = 10  # margin of the cells on which photoelectrons are drawn
    # Resampling is exact up to this frequency and fades to nothing at 1 cy/px, so that a point does
    # not ring.
    resampling_exact_cy_per_px: float = 0.6
    # largest error of the transfer of a band where bands are sums of a few transfers
    band_transfer_error: float = 1e-4
    n_band_frequencies: int = 1500  # frequencies at which the transfers of bands are compared
    # distance from the axis, in corner radii, to which distortion is inverted
    max_distortion_radius: float = 2.0
    n_distortion_steps: int = 4096  # radii of the table that inverts distortion
    min_replica_transfer: float = 1e-3  # spectral replicas with a smaller transfer are neglected
    # fraction of the light, at most, that is emitted after the last lag field
    max_lag_fraction: float = 1e-3
    n_arrival_times: int = 2000  # arrival times over which decay fractions are averaged
    # fraction of a single pulse that may lie beyond its compact part
    max_near_wing_fraction: float = 0.02
    # light is not sharpened where the squared kernel has a smaller transfer
    min_sharpened_transfer: float = 0.05
    # fraction of the squared kernel that its separable parts may neglect
    separable_residual: float = 2e-6
    # Relative error of the third moment of pulses on the lattice; one cell per column is then
    # enough.
    skewness_tolerance: float = 0.012
    # below this mean per pixel single pulses are resolved, and drawn one by one
    sparse_pe_per_px: float = 0.8
    # Skewness of the shot noise of the charge, over all noise, above which electrons are counted.
    counted_skewness: float = 0.01
    # Above this mean the electrons of a pixel are drawn from a normal law with the skewness of a
    # Poisson law.
    max_counted_e: float = 1000.0
    # More photoelectrons in a cell have the noise of this number, so that values stay finite.
    max_pe_per_cell: float = 1e9
    max_charge_sd: float = 8.0  # charge never exceeds its mean by more standard deviations
    min_filter_tap: float = 1e-6  # smaller taps of an impulse response are neglected
    # decay components that store a smaller mean fraction are neglected
    min_stored_fraction: float = 1e-6
    # parts of the table that guides the search for the cell of a pulse
    n_search_guides: int = 2**20
    # probability that the largest value of a fixed pattern exceeds the bound
    extreme_probability: float = 0.1
    # A well may overflow if its charge lies within this many standard deviations of the full well.
    overflow_sd: float = 8.0
    # rings in which the displacement by the taper is bounded by that of their outer edge
    n_distortion_rings: int = 6


ACCURACY = Accuracy()


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Cells per pixel and margins around the image."""

    # Physical pixels of the chip that the image needs.
    rows: int
    columns: int
    # Cells per pixel along a row and along a column.
    per_column: int
    per_row: int
    # Pixels added before the first row and column; after the last, what the shape leaves.
    margin_rows: int
    margin_columns: int
    shape: tuple[int, int]  # cells, (row, col)
    # Pixel pitch at the photocathode, mm.
    pitch_x_mm: float
    pitch_y_mm: float

    @property
    def cell_area_cm2(self) -> float:
        """Area of one cell at the photocathode, cm2."""
        return self.pitch_x_mm * self.pitch_y_mm / (self.per_column * self.per_row) * 1e-2

    @property
    def frame_slices(self) -> tuple[slice, slice]:
        """Slices that cut the pixels of the chip out of an image on cells, margins left out."""
        top, first_column = self.margin_rows * self.per_row, self.margin_columns * self.per_column
        return slice(top, top + self.rows * self.per_row), slice(
            first_column, first_column + self.columns * self.per_column
        )

    def frequencies(self) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Frequencies (fx (1, col), fy (row, 1)) of this grid's real Fourier transform, cycles/mm
        at the cathode.
        """
        rows, columns = self.shape
        fx = np.fft.rfftfreq(columns, self.pitch_x_mm / self.per_column)[None, :]
        fy = np.fft.fftfreq(rows, self.pitch_y_mm / self.per_row)[:, None]
        return fx, fy

    def one_pixel(self) -> "Grid":
        """Return one pixel of this grid: what depends on the pitches alone is computed once for
        frames of any size.
        """
        shape = (self.per_row, self.per_column)
        return replace(self, rows=1, columns=1, margin_rows=0, margin_columns=0, shape=shape)


def grid_with_margin(
    rows: int, columns: int, *, per_pixel: int, margin: int, pitch_x_mm: float, pitch_y_mm: float
) -> Grid:
    """Return a grid with at least `margin` pixels on every side and a shape that transforms
    fast.
    """
    return Grid(
        rows=rows,
        columns=columns,
        per_column=per_pixel,
        per_row=per_pixel,
        margin_rows=margin,
        margin_columns=margin,
        shape=(
            fast_length((rows + 2 * margin) * per_pixel),
            fast_length((columns + 2 * margin) * per_pixel),
        ),
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
    transform: Any = fft.rfft2(image)
    return transform


def irfft_image(transform: NDArray, shape: tuple[int, int]) -> NDArray[Any]:
    """Return the real images (..., row, col) of the given shape that have a transform."""
    image: Any = fft.irfft2(transform, s=shape)
    return image


class CameraFrame(ABC):
    """What every stage may ask of its camera: its description, its frame with the cells, and its
    clock.
    """

    description: Camera

    @property
    def has_tube(self) -> bool:
        """Whether an image intensifier stands before the chip."""
        return self.description.has_tube

    @abstractmethod
    def open_s(self, conditions: Conditions) -> float:
        """Return the time that gate or shutter is open in one exposure, s."""

    @property
    def fields_per_frame(self) -> int:
        """Exposures in one frame; where there are two, a pixel as read is as many rows of the chip
        high.
        """
        return self.description.fields

    @property
    def field_s(self) -> float:
        """Time from one exposure to the next, s."""
        return 1.0 / float(self.description.video.field_rate_hz)

    @property
    def frame_s(self) -> float:
        """Time from one frame to the next, s."""
        return self.field_s * self.fields_per_frame

    @property
    def demagnification(self) -> float:
        """Size of the image where light arrives over its size on the chip, dimensionless."""
        return float(self.description.taper.demagnification) if self.has_tube else 1.0

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of a frame."""
        return self.description.ccd.rows, self.description.ccd.columns

    @property
    def pattern_seed(self) -> int:
        """Seed of the fixed patterns, which belong to the camera of this name."""
        return zlib.crc32(self.description.name.encode())

    @property
    @abstractmethod
    def specimen(self) -> Any:
        """Fixed patterns of this very camera, `simulate.camera.specimen.SpecimenPatterns`."""

    @cached_property
    def cells(self) -> Grid:
        """Cells on which photoelectrons are drawn or collected, two per pixel."""
        return self._grid(2, ACCURACY.draw_margin_px)

    @cached_property
    def scene_cells(self) -> Grid:
        """Cells on which the scene arrives, four per pixel."""
        grid, margin_px = (
            self._grid(4, ACCURACY.scene_margin_px),
            ACCURACY.scene_margin_px - ACCURACY.draw_margin_px,
        )
        # Both extents are rounded up to lengths that transform fast; this one must contain that of
        # the cells.
        rows, columns = (
            fast_length(max(size, 4 * margin_px + 2 * cells))
            for size, cells in zip(grid.shape, self.cells.shape, strict=True)
        )
        return replace(grid, shape=(rows, columns))

    @property
    def field_pixel_area_cm2(self) -> float:
        """Area of one pixel as read, at the photocathode, cm2: two rows where fields are
        integrated.
        """
        return self.cells.pitch_x_mm * self.cells.pitch_y_mm * self.fields_per_frame * 1e-2

    def _grid(self, per_pixel: int, margin: int) -> Grid:
        ccd, (rows, columns) = self.description.ccd, self.shape
        # Field integration sums rows r and r + 1, so the chip has one row more than the frame.
        return grid_with_margin(
            rows + (1 if self.description.interlaced else 0),
            columns,
            per_pixel=per_pixel,
            margin=margin,
            pitch_x_mm=float(ccd.pitch_x_um) * self.demagnification * 1e-3,
            pitch_y_mm=float(ccd.pitch_y_um) * self.demagnification * 1e-3,
        )
