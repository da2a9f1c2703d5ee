"""Collection by the pixels and the order of reading: cells become field pixels, fields become frames."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from simulate.iiccd.grid import Grid
from simulate.iiccd.light import Light, _transfer
from simulate.iiccd.transfer import Blur, PixelAperture


@dataclass(frozen=True, kw_only=True)
class Collection:
    """The pixels' aperture, summed over row pairs where fields are integrated.

    Parameters
    ----------
    row_pairs
        True: every frame row sums two rows of the chip. False: it is one row of the chip.

    Notes
    -----
    All blurs that the light still owes and the aperture are computed in one transform, and the transform is folded
    onto the pixels before it is inverted: the samples are exact, aliases included. Takes two cells per pixel.
    """

    row_pairs: bool
    name: str = "pixels"
    takes: str = "screen photons"
    emits: str = "screen photons on pixels"

    def mean(self, light: Light) -> Light:
        """Return photons per pixel, shape (..., frame row, column)."""
        from scipy.fft import irfft2, rfft2

        grid = light.grid
        if grid is None or grid.per_pixel != 2:
            raise ValueError("pixels collect light on two cells per pixel")
        height = 2 if self.row_pairs else 1
        aperture = PixelAperture(width_mm=grid.pitch_x_mm, height_mm=height * grid.pitch_y_mm)
        folded = folded_spectrum(rfft2(light.values), pixel_transfer((*light.owed, aperture), grid, height))
        pixels = irfft2(folded, s=(grid.shape[0] // 2, grid.shape[1] // 2))
        # A pixel holds 4 cells per row of the chip; folding and the shorter inverse give the sample of one cell.
        pixels *= pixels.dtype.type(4 * height)
        top, left = grid.margin_rows, grid.margin_columns
        rows = grid.rows - height + 1
        return Light(values=pixels[..., top : top + rows, left : left + grid.columns])

    def draw(self, light: Light, rng: np.random.Generator) -> Light:
        """Return the mean; the photons' noise is drawn where they become charge."""
        return self.mean(light)


@lru_cache(maxsize=8)
def pixel_transfer(owed: tuple[Blur, ...], grid: Grid, height: int) -> NDArray[np.complex64]:
    """Transfer of the owed blurs with the shift from cell centres to the centres of the pixels read."""
    fx, fy = grid.frequencies()
    shift = np.exp(2j * np.pi * (0.25 * fx * grid.pitch_x_mm + (0.5 * height - 0.25) * fy * grid.pitch_y_mm))
    return (_transfer(owed, grid) * shift).astype(np.complex64)


def folded_spectrum(spectrum: NDArray, transfer: NDArray) -> NDArray:
    """Return the transform of every second sample along both axes of an image times a transfer.

    `spectrum` (..., row, col) is a real transform over an even number of columns, divisible by four.
    """
    rows, columns = spectrum.shape[-2], 2 * (spectrum.shape[-1] - 1)
    product = spectrum * transfer
    upright = product[..., : rows // 2, :] + product[..., rows // 2 :, :]
    quarter = columns // 4
    mirrored = upright[..., : quarter - 1 : -1].conj()
    mirrored = np.roll(mirrored[..., ::-1, :], 1, axis=-2)
    return 0.25 * (upright[..., : quarter + 1] + mirrored)


@dataclass(frozen=True, kw_only=True)
class Scan:
    """The order of reading: frame row r is read in field r % 2 where video is interlaced.

    Takes (field, row, col) with two fields a frame, earlier field first, and emits (frame, row, col); without
    interlace every exposure is a frame.
    """

    interlaced: bool
    name: str = "scan"
    takes: str = "screen photons on pixels"
    emits: str = "screen photons as read"

    def mean(self, light: Light) -> Light:
        """Return frames woven of their two fields."""
        fields = light.values
        if not self.interlaced:
            return light
        if fields.ndim != 3 or len(fields) % 2:
            raise ValueError(f"interlaced frames are woven of two fields each, got shape {fields.shape}")
        frames = fields[0::2].copy()
        frames[:, 1::2] = fields[1::2, 1::2]
        return light.with_values(frames)

    def draw(self, light: Light, rng: np.random.Generator) -> Light:
        """Return the mean: reading order adds no noise."""
        return self.mean(light)
