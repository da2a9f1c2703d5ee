"""Pixel aperture and field readout: cells become pixels, fields become frames."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np
from numpy.typing import NDArray

from labdata.conditions import Conditions
from simulate.camera.chain import Slot, Stage
from simulate.camera.grid import CameraFrame, Grid, irfft_image, rfft_image
from simulate.camera.stage_image import StageImage
from simulate.camera.transfer import PixelAperture, StageBlur, fold_transfer, product


@dataclass(frozen=True, kw_only=True)
class Collection(Stage, slot=Slot.PIXELS, section="ccd"):
    """The pixels' aperture, summed over row pairs where fields are integrated.

    Notes
    -----
    The pending blurs and the aperture are applied in one transform, and the transform is folded
    onto the pixels before it is inverted: the samples are exact, aliases included. Takes two cells
    per column, and two per row for exact means. Cells one row high are for draws, see
    `pixel_transfer`.
    """

    # true: every frame row sums two rows of the chip. False: it is one row of the chip
    row_pairs: bool
    takes: str = "screen photons"
    emits: str = "screen photons on pixels"
    quantity: str = "photons per exposure and pixel"

    @classmethod
    def of(cls, camera: CameraFrame, conditions: Conditions) -> Self:
        if camera.has_tube:
            return cls(row_pairs=camera.description.interlaced)
        return cls(
            row_pairs=False,
            takes="photoelectrons in the chip",
            emits="photoelectrons in the wells",
            quantity="photoelectrons per exposure and pixel, expected",
        )

    def mean(self, light: StageImage) -> StageImage:
        """Return photons per pixel, shape (..., frame row, column)."""
        grid = light.grid
        if grid is None or grid.per_column != 2 or grid.per_row > 2:
            raise ValueError("pixels collect light on two cells per column and one or two per row")
        height = 2 if self.row_pairs else 1
        spectrum = rfft_image(light.values) * pixel_transfer(light.pending_blurs, grid, height)
        folded_spectrum = fold_columns(fold_rows(spectrum) if grid.per_row == 2 else spectrum)
        pixels = irfft_image(folded_spectrum, (grid.shape[0] // grid.per_row, grid.shape[1] // 2))
        # So far the amount in a cell around the pixel's centre, averaged by its aperture.
        pixels *= pixels.dtype.type(grid.per_column * grid.per_row * height)
        top, first_column = grid.margin_rows, grid.margin_columns
        rows = grid.rows - height + 1
        return StageImage(
            values=pixels[..., top : top + rows, first_column : first_column + grid.columns]
        )


@lru_cache(maxsize=8)
def pixel_transfer(
    pending: tuple[StageBlur, ...], grid: Grid, height: int
) -> NDArray[np.complex64]:
    """Return the transfer of blurs and pixels `height` rows high, with the shift from cell centres
    to theirs.

    Cells one row high are for draws: independent cells have the very covariance, on the pixels, of
    pulses that fall anywhere inside the cells, see `fold_transfer`.
    """
    aperture = PixelAperture.of(grid, height)
    fx, fy = grid.frequencies()
    if grid.per_row == 1:
        cell_x_mm = grid.pitch_x_mm / grid.per_column
        transfer = fold_transfer(
            pending, aperture, fx[0], fy[:, 0], cell_x_mm=cell_x_mm, cell_y_mm=grid.pitch_y_mm
        )
    else:
        transfer = product((*pending, aperture), *np.broadcast_arrays(fx, fy))
    col_shift, row_shift = 0.5 - 0.5 / grid.per_column, 0.5 * height - 0.5 / grid.per_row
    shift = np.exp(
        2j * np.pi * (col_shift * fx * grid.pitch_x_mm + row_shift * fy * grid.pitch_y_mm)
    )
    return (transfer * shift).astype(np.complex64)


def fold_rows(spectrum: NDArray) -> NDArray:
    """Return the transform of every second row from the transform (..., row, col) of all."""
    half = spectrum.shape[-2] // 2
    return 0.5 * (spectrum[..., :half, :] + spectrum[..., half:, :])


def fold_columns(spectrum: NDArray) -> NDArray:
    """Return the real transform (..., row, col) of every second column from that of all, a multiple
    of four.
    """
    quarter = (spectrum.shape[-1] - 1) // 2
    reversed_half = spectrum[..., : quarter - 1 : -1].conj()
    reversed_half = np.roll(reversed_half[..., ::-1, :], 1, axis=-2)
    return 0.5 * (spectrum[..., : quarter + 1] + reversed_half)


@dataclass(frozen=True, kw_only=True)
class FieldReadout(
    Stage,
    slot=Slot.SCAN,
    section="tube",
    quantity="photons per exposure and pixel as read",
    takes="screen photons on pixels",
    emits="screen photons as read",
):
    """The order of reading: frame row r is read in field r % 2 where video is interlaced.

    Takes (field, row, col) with two fields a frame, earlier field first, and emits (frame, row,
    col); without interlace every exposure is a frame.
    """

    interlaced: bool

    @classmethod
    def of(cls, camera: CameraFrame, conditions: Conditions) -> Self:
        return cls(interlaced=camera.description.interlaced)

    def mean(self, light: StageImage) -> StageImage:
        """Return frames woven of their two fields."""
        fields = light.values
        if not self.interlaced:
            return light
        if fields.ndim != 3 or len(fields) % 2:
            raise ValueError(
                f"interlaced frames are woven of two fields each, got shape {fields.shape}"
            )
        frames = fields[0::2].copy()
        frames[:, 1::2] = fields[1::2, 1::2]
        return light.with_values(frames)
