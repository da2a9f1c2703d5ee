"""Kernel that spreads the light of cells over pixels with the covariance of the continuous blur.

Pulses fall anywhere; cells gather them on a lattice. Sampled on the lattice, the blur's transfer H
would lose or gain variance (an eighth at a blur of half a pixel). The kernel is therefore the
transform of sqrt(sum_m |H(f + m)|^2), whose squared modulus is exactly that of the samples of the
continuous noise: the covariance of pixels is exact at every distance. What is left is the third
moment, and `skewness_ratio` says by how much it is off. Where pulses are so rare that single ones
are seen, their shape tells on: these fall on positions of their own (`PulseKernel`).
"""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.linalg import lu_factor, lu_solve

from simulate.camera.grid import ACCURACY, Grid
from simulate.camera.transfer import PixelAperture, StageBlur, fold_transfer

# Half-width of the compact part, pixels; the wing beyond is spread on the coarse lattice.
REACH = 5
# Half-width of the compact part of single pulses, pixels.
NEAR = 3
# Pixels on one side of a coarse cell.
COARSE = 8
# Side of the lattice on which kernels are computed, pixels, and its finest division.
SIDE, FINEST = 128, 8
# Cells per row and per column of the chip, coarsest first.
DIVISIONS = ((1, 1), (1, 2), (2, 2))


@dataclass(frozen=True, kw_only=True)
class Kernel:
    """Spread of the noise from planes of cells, one cell a pixel pitch in each plane, to pixels."""

    divisions: tuple[
        int, int
    ]  # cells per row and per column of the chip; their product is the number of planes
    height: int  # rows of the chip in a pixel as read
    # Separable parts, shape (plane, rank, tap).
    down: NDArray[np.float32]
    along: NDArray[np.float32]
    # Weights of coarse cells for what reaches farther than `REACH`, shape (coarse row, coarse col),
    # centre in the middle.
    wing: NDArray[np.float32]
    # variance of the pulses' noise over its covariance sum, as read, dimensionless
    blur_factor: float
    # its third moment over that of pulses that each fall into one pixel, as read, dimensionless
    third_factor: float
    # Third moment of the lattice's pulses, as read, over that of pulses that fall anywhere,
    # dimensionless.
    skewness_ratio: float
    # Filter on the lattice, shape (SIDE down, SIDE along), origin first. Light through it has, by
    # this kernel, the variance at every pixel that the light itself has by the continuous blur.
    sharpening: NDArray[np.float64] = field(repr=False)

    @property
    def squares(self) -> float:
        """Sum of the squared fractions that pixels collect of a pulse, over the mean sum,
        dimensionless.
        """
        square_sum = float(
            np.einsum("prj,prk,psj,psk->", self.down, self.along, self.down, self.along)
        )
        return square_sum / (self.height * len(self.down))


@dataclass(frozen=True, kw_only=True)
class PulseKernel:
    """Spread of single pulses, from positions `FINEST` to a pixel pitch both ways, to pixels."""

    height: int  # rows of the chip in a pixel as read
    # Fraction of a pulse's light on pixels, shape (row and col of the position, row, col). A
    # position in row R and column C of the chip, counted from `half_width_px` before the first,
    # lights the pixels that end with row R, column C.
    fractions: NDArray[np.float32]
    # half-width of the fractions, pixels: `NEAR` where what lies beyond is little, else `REACH`
    half_width_px: int
    wing: NDArray[np.float32]  # light farther than `REACH`, as in `Kernel`

    @property
    def squares(self) -> float:
        """Sum of the squared fractions that pixels collect of a pulse, over the mean sum,
        dimensionless.
        """
        return float(np.sum(self.fractions**2)) / (FINEST**2 * self.height)


@lru_cache(maxsize=8)
def pulse_kernel(blurs: tuple[StageBlur, ...], grid: Grid, height: int) -> PulseKernel:
    """Return the kernel of blurs behind the gain for single pulses; arguments as for
    `noise_kernel`.
    """
    divisions = FINEST, FINEST
    transfer = _fine_transfer(blurs, grid, height)
    image = _image_of(_matching_transfer(transfer, height, divisions)) * FINEST**2 * height
    planes, margin = np.array(_compact_planes(image, height, divisions)), REACH - NEAR
    inner_wing = planes.copy()
    inner_wing[:, margin:-margin, margin:-margin] = 0.0
    if np.abs(inner_wing).sum() < ACCURACY.max_near_wing_fraction * np.abs(planes).sum():
        planes -= inner_wing
        fractions, half_width_px = planes[:, margin:-margin, margin:-margin], NEAR
    else:
        fractions, half_width_px = planes, REACH
    return PulseKernel(
        height=height,
        fractions=np.ascontiguousarray(fractions[:, ::-1, ::-1], np.float32).reshape(
            FINEST, FINEST, *fractions.shape[1:]
        ),
        half_width_px=half_width_px,
        wing=_wing_of(image, list(planes), height, divisions),
    )


@lru_cache(maxsize=8)
def noise_kernel(
    blurs: tuple[StageBlur, ...],
    grid: Grid,
    height: int,
    impulse: tuple[float, ...],
    tolerance: float,
) -> Kernel:
    """Return the kernel of blurs behind the gain, on the coarsest lattice that keeps the third
    moment.

    Parameters
    ----------
    blurs
        Blurs behind the gain, the pixel's aperture left out.
    grid
        Any grid of the camera; its pitches count.
    height
        Rows of the chip in a pixel as read, 1 or 2.
    impulse
        Impulse response along a line of what follows; it takes part in the third moment.
    tolerance
        Error that the third moment may have, dimensionless; the finest lattice has what it has.
    """
    transfer = _fine_transfer(blurs, grid, height)
    exact_moment = _third_moment(_filtered_transfer(transfer, impulse, FINEST))
    kernel = None
    for divisions in DIVISIONS:
        kernel = _on_lattice(transfer, height, divisions, impulse, exact_moment)
        if abs(kernel.skewness_ratio - 1.0) <= tolerance:
            break
    assert kernel is not None
    return kernel


def _on_lattice(
    transfer: NDArray[np.float64],
    height: int,
    divisions: tuple[int, int],
    impulse: tuple[float, ...],
    exact_moment: float,
) -> Kernel:
    lattice_transfer = _matching_transfer(transfer, height, divisions)
    n_cells = divisions[0] * divisions[1]
    image = _image_of(lattice_transfer) * n_cells * height
    parts = [_separable_parts(plane) for plane in _compact_planes(image, height, divisions)]
    filtered = _image_of(_filtered_transfer(lattice_transfer, impulse, divisions[1])) * n_cells
    return Kernel(
        divisions=divisions,
        height=height,
        down=_stack_ranks([down for down, _ in parts]),
        along=_stack_ranks([along for _, along in parts]),
        wing=_wing_of(image, [down.T @ along for down, along in parts], height, divisions),
        blur_factor=float(np.sum(filtered**2) / n_cells) * height,
        third_factor=float(np.sum(filtered**3) / n_cells) * height**2,
        skewness_ratio=float(np.sum(filtered**3) / n_cells / exact_moment),
        sharpening=_sharpening(transfer, lattice_transfer, height, divisions),
    )


@lru_cache(maxsize=2)
def _fine_transfer(blurs: tuple[StageBlur, ...], grid: Grid, height: int) -> NDArray[np.float64]:
    """Transfer of blurs and pixels from the finest lattice, shape (SIDE * FINEST, SIDE *
    FINEST).
    """
    aperture = PixelAperture.of(grid, height)
    # Transfers are even in both frequencies: a quarter of them is worked out.
    distance = np.abs(np.fft.fftfreq(SIDE * FINEST, 1.0 / (SIDE * FINEST))).astype(int)
    frequency = np.arange(distance.max() + 1) / SIDE
    cell_size = {"cell_x_mm": grid.pitch_x_mm / FINEST, "cell_y_mm": grid.pitch_y_mm / FINEST}
    quarter = fold_transfer(
        blurs, aperture, frequency / grid.pitch_x_mm, frequency / grid.pitch_y_mm, **cell_size
    )
    return quarter[np.ix_(distance, distance)]


def _image_of(transfer: NDArray[Any]) -> NDArray[np.float64]:
    """Real part of the image of a transfer of even length, from half of its frequencies."""
    rows, columns = transfer.shape
    half = np.array(transfer[:, : columns // 2 + 1], np.complex128)
    # Each frequency stands for its opposite: in all rows but the Nyquist one both are there.
    opposite = np.conj(transfer[rows // 2, -np.arange(columns // 2 + 1)])
    half[rows // 2] = 0.5 * (half[rows // 2] + opposite)
    return np.asarray(fft.irfft2(half, transfer.shape))


def _filtered_transfer(
    transfer: NDArray, impulse: tuple[float, ...], per_column: int
) -> NDArray[np.complex128]:
    """The transfer with that of a filter along lines."""
    frequency = np.fft.fftfreq(SIDE * per_column, 1.0 / per_column)
    phase = np.exp(-2j * np.pi * np.multiply.outer(frequency, np.arange(len(impulse))))
    return np.asarray(transfer * (phase @ np.array(impulse)), np.complex128)


def _third_moment(transfer: NDArray[np.complex128]) -> float:
    density = _image_of(transfer) * FINEST**2
    return float(np.sum(density**3) / FINEST**2)


def _matching_transfer(
    transfer: NDArray[np.float64], height: int, divisions: tuple[int, int]
) -> NDArray[np.complex128]:
    """Transfer on the lattice of cells whose squared modulus is that of all that falls on it,
    centred on the pixel.
    """
    per_row, per_column = divisions
    # Whole rows are summed first.
    power = (transfer**2).reshape(FINEST // per_row, SIDE * per_row, -1).sum(axis=0)
    power = power.reshape(SIDE * per_row, FINEST // per_column, -1).sum(axis=1)
    fy, fx = _frequencies(divisions)
    phase = np.exp(2j * np.pi * _shift(height, divisions, fy, fx))
    return np.copysign(np.sqrt(power), transfer[_fine_indices(fy, fx)]) * phase


def _sharpening(
    transfer: NDArray[np.float64],
    lattice_transfer: NDArray[np.complex128],
    height: int,
    divisions: tuple[int, int],
) -> NDArray[np.float64]:
    """Ratio of the transforms of the squared blur and of the squared kernel, cells of uniform light
    between them.
    """
    per_row, per_column = divisions
    fine_blur = np.fft.fft2(_image_of(transfer) ** 2).real * FINEST**2
    fy, fx = _frequencies(divisions)
    squared_blur = fine_blur[_fine_indices(fy, fx)]
    phase = np.exp(-2j * np.pi * _shift(height, divisions, fy, fx))
    squared_kernel = np.fft.fft2(_image_of(lattice_transfer) ** 2) * phase
    squared_kernel = squared_kernel.real * (per_row * per_column)
    cell = np.sinc(fy / per_row)[:, None] * np.sinc(fx / per_column)[None, :]
    cell_kernel = squared_kernel * cell
    # Where the kernel passes next to nothing the ratio means nothing, and light is left as it is.
    floor = (ACCURACY.min_sharpened_transfer * squared_kernel[0, 0]) ** 2
    ratio = (squared_blur * cell_kernel + floor) / (cell_kernel**2 + floor)
    tapers = [
        np.maximum(1.0 - np.abs(np.fft.fftfreq(n, 1.0 / n)) / (REACH * d), 0.0)
        for n, d in zip(ratio.shape, divisions, strict=True)
    ]
    kernel = _image_of(ratio) * np.sqrt(tapers[0])[:, None] * np.sqrt(tapers[1])[None, :]
    return kernel / kernel.sum()


def _frequencies(divisions: tuple[int, int]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Frequencies (fy, fx) of a lattice's transform, cycles per pixel."""
    fy, fx = (np.fft.fftfreq(SIDE * cells, 1.0 / cells) for cells in divisions)
    return fy, fx


def _fine_indices(
    fy: NDArray[np.floating], fx: NDArray[np.floating]
) -> tuple[NDArray[np.int64], ...]:
    """Indices of a lattice's frequencies in the finest transform."""
    return np.ix_(*(np.rint(f * SIDE).astype(int) % (SIDE * FINEST) for f in (fy, fx)))


def _shift(
    height: int, divisions: tuple[int, int], fy: NDArray[np.floating], fx: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Cycles by which the pixel's centre lies beyond that of its first cell."""
    per_row, per_column = divisions
    return (0.5 * height - 0.5 / per_row) * fy[:, None] + (0.5 - 0.5 / per_column) * fx[None, :]


def _compact_indices(
    height: int, divisions: tuple[int, int]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of the kernel's lattice on which cells within `REACH` pixels have their
    fractions.
    """
    per_row, per_column = divisions
    rows = np.arange(-REACH * per_row, (REACH + height) * per_row)
    columns = np.arange(-REACH * per_column, (REACH + 1) * per_column)
    return -rows % (SIDE * per_row), -columns % (SIDE * per_column)


def _compact_planes(
    image: NDArray[np.float64], height: int, divisions: tuple[int, int]
) -> list[NDArray[np.float64]]:
    """What a wing leaves to do within `REACH` pixels, for each plane of cells, shape (row, col) of
    its own cells.
    """
    per_row, per_column = divisions
    core = tuple(slice(SIDE // 2 + 1 - n - REACH, SIDE // 2 + REACH + 1) for n in (height, 1))
    wing = _fit_wing(_per_pixel(image, divisions), height, core)
    spread = [_spread_of_wing(n) for n in (height, 1)]
    wing_image = (
        np.fft.ifftshift(spread[0] @ wing @ spread[1].T)
        .repeat(per_row, axis=0)
        .repeat(per_column, axis=1)
    )
    residual = image - np.roll(wing_image, (1 - per_row, 1 - per_column), axis=(0, 1))
    compact = residual[np.ix_(*_compact_indices(height, divisions))]
    return [compact[i::per_row, j::per_column] for i in range(per_row) for j in range(per_column)]


def _separable_parts(plane: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Separable parts, (rank, row) and (rank, col), whose outer products add up to the plane."""
    u, s, v = np.linalg.svd(plane)
    residual_power = np.append(np.cumsum(s[::-1] ** 2)[::-1][1:], 0.0)
    rank = 1 + int(np.argmax(residual_power < ACCURACY.separable_residual * np.sum(s**2)))
    root = np.sqrt(s[:rank])[:, None]
    return u[:, :rank].T * root, v[:rank] * root


def _stack_ranks(parts: list[NDArray[np.float64]]) -> NDArray[np.float32]:
    """Planes may need different ranks; the shorter are filled with nothing."""
    rank = max(len(part) for part in parts)
    # In C order whatever the parts have: each order would be a compilation of its own.
    return np.stack([np.pad(part, ((0, rank - len(part)), (0, 0))) for part in parts]).astype(
        np.float32, order="C"
    )


def _wing_of(
    image: NDArray[np.float64],
    planes: list[NDArray[np.float64]],
    height: int,
    divisions: tuple[int, int],
) -> NDArray[np.float32]:
    """Return the weights of coarse cells for what compact planes leave of the kernel."""
    (per_row, per_column), residual = divisions, image.copy()
    rows, columns = _compact_indices(height, divisions)
    for n, plane in enumerate(planes):
        i, j = divmod(n, per_column)
        residual[np.ix_(rows[i::per_row], columns[j::per_column])] -= plane
    return _fit_wing(_per_pixel(residual, divisions), height).astype(np.float32)


def _fit_wing(
    residual: NDArray[np.float64], height: int, excluded: tuple[slice, ...] = ()
) -> NDArray[np.float64]:
    """Return the weights of coarse cells that bring to pixels what comes closest to a residual of
    the kernel.

    Cells gather in coarse ones, and pixels lie anywhere between the centres of these: of weights
    that are the residual's means over coarse cells, a tenth is lost at a hundredth of a cycle per
    pixel. The residual is by distance from the pixel, -SIDE/2 first; distances that are together in
    `excluded` do not count.
    """
    row_spread, column_spread = (_spread_of_wing(n) for n in (height, 1))
    data = residual.copy()
    if excluded:
        data[excluded] = 0.0
    bounds = tuple((part.start, part.stop) for part in excluded)
    wing = lu_solve(
        _information_of_wing(height, bounds), (row_spread.T @ data @ column_spread).ravel()
    )
    return wing.reshape(row_spread.shape[1], column_spread.shape[1])


@lru_cache(maxsize=4)
def _information_of_wing(
    height: int, excluded: tuple[tuple[int, int], ...]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the information on the weights of coarse cells, factorised, without distances between
    bounds of rows and columns.
    """
    row_spread, column_spread = (_spread_of_wing(n) for n in (height, 1))
    information = np.kron(row_spread.T @ row_spread, column_spread.T @ column_spread)
    if excluded:
        (top, bottom), (left, right) = excluded
        rows, columns = row_spread[top:bottom], column_spread[left:right]
        information -= np.kron(rows.T @ rows, columns.T @ columns)
    return lu_factor(information)


def _per_pixel(image: NDArray[np.float64], divisions: tuple[int, int]) -> NDArray[np.float64]:
    """Average over the cells of a pixel pitch both ways, distances from -SIDE/2 pixels on, shape
    (SIDE, SIDE).
    """
    per_row, per_column = divisions
    aligned = np.roll(image, (per_row - 1, per_column - 1), axis=(0, 1))
    return np.fft.fftshift(aligned.reshape(SIDE, per_row, SIDE, per_column).mean(axis=(1, 3)))


@lru_cache(maxsize=2)
def _spread_of_wing(height: int) -> NDArray[np.float64]:
    """How weights come to pixels so many rows high: mean over their positions, shape
    (distance, coarse cell).

    It goes round, as the kernel's lattice does, so that the best weights keep all light.
    """
    coarse, distance = SIDE // COARSE, np.arange(-SIDE // 2, SIDE // 2)
    spread = np.zeros((SIDE, coarse))
    for row in range(COARSE):
        # The pixel's centre, between those of two coarse cells.
        position = (row + 0.5 * height) / COARSE - 0.5
        lower_cell = int(np.floor(position))
        for cell, fraction in (
            (lower_cell, lower_cell + 1.0 - position),
            (lower_cell + 1, position - lower_cell),
        ):
            weight = cell - (row - distance) // COARSE + coarse // 2
            spread[np.arange(SIDE), weight % coarse] += fraction / COARSE
    return spread
