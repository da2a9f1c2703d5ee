"""How the light of a cell spreads over pixels: a kernel on the lattice with the covariance of the continuous blur.

Pulses fall anywhere; cells gather them on a lattice. Sampled on the lattice, the blur's transfer H would lose or gain
variance (an eighth at a blur of half a pixel). The kernel is therefore the transform of sqrt(sum_m |H(f + m)|^2), whose
squared modulus is exactly that of the samples of the continuous noise: the covariance of pixels is exact at every
distance. What is left is the third moment, and `skewness_ratio` says by how much it is off.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from simulate.iiccd.grid import Grid
from simulate.iiccd.light import product
from simulate.iiccd.transfer import Blur, PixelAperture

# Half-width of the compact part, pixels; what reaches farther goes by the coarse lattice.
REACH = 4
# Pixels on one side of a coarse cell.
COARSE = 8
# Side of the lattice on which kernels are computed, pixels, and its finest division.
SIDE, FINEST = 128, 8
# Cells per row and per column of the chip, coarsest first.
DIVISIONS = ((1, 1), (1, 2), (2, 2))
# Share of the kernel's square that separable parts may leave out.
LEFT_OUT = 1e-5


@dataclass(frozen=True, kw_only=True)
class Kernel:
    """Spread of the noise from planes of cells, one cell a pixel pitch in each plane, to pixels.

    Parameters
    ----------
    divisions
        Cells per row and per column of the chip; their product is the number of planes.
    height
        Rows of the chip in a pixel as read.
    down, along
        Separable parts, shape (plane, rank, tap).
    wing
        What reaches farther than `REACH`, averaged over coarse cells, shape (coarse row, coarse col), centre in the
        middle.
    blur_factor
        Variance of the pulses' noise over its covariance sum, as read, dimensionless.
    third_factor
        Its third moment over that of pulses that each fall into one pixel, as read, dimensionless.
    skewness_ratio
        Third moment of the lattice's pulses, as read, over that of pulses that fall anywhere, dimensionless.
    """

    divisions: tuple[int, int]
    height: int
    down: NDArray[np.float32]
    along: NDArray[np.float32]
    wing: NDArray[np.float32]
    blur_factor: float
    third_factor: float
    skewness_ratio: float


@lru_cache(maxsize=8)
def noise_kernel(
    blurs: tuple[Blur, ...], grid: Grid, height: int, impulse: tuple[float, ...], tolerance: float, *, sparse: bool
) -> Kernel:
    """Return the kernel of blurs behind the gain, on the coarsest lattice that keeps the third moment.

    Parameters
    ----------
    blurs
        Blurs behind the gain, the pixel's aperture left out.
    grid
        Any grid of the camera; its pitches count.
    height
        Rows of the chip in a pixel as read, 1 or 2.
    impulse
        Impulse response along a line of what follows, one tap a pixel; it takes part in the third moment.
    tolerance
        Error that the third moment may have, dimensionless; the finest lattice has what it has.
    sparse
        Whether pulses are so rare that each shows where in a pixel it fell: two cells a column, then, at least.
    """
    aperture = PixelAperture(width_mm=grid.pitch_x_mm, height_mm=height * grid.pitch_y_mm)
    transfer = _fine_transfer((*blurs, aperture), grid.pitch_x_mm, grid.pitch_y_mm)
    exact = _third_moment(_read(transfer, impulse, FINEST))
    kernel = None
    for divisions in DIVISIONS[int(sparse) :]:
        kernel = _on_lattice(transfer, height, divisions, impulse, exact)
        if abs(kernel.skewness_ratio - 1.0) <= tolerance:
            break
    assert kernel is not None
    return kernel


def _on_lattice(
    transfer: NDArray[np.float64], height: int, divisions: tuple[int, int], impulse: tuple[float, ...], exact: float
) -> Kernel:
    matched = _matched(transfer, height, divisions)
    cells = divisions[0] * divisions[1]
    whole = np.fft.ifft2(matched).real * cells * height
    parts = [_separated(plane) for plane in _compact(whole, height, divisions)]
    read = np.fft.ifft2(_read(matched, impulse, divisions[1])).real * cells
    return Kernel(
        divisions=divisions,
        height=height,
        down=_stacked([down for down, _ in parts]),
        along=_stacked([along for _, along in parts]),
        wing=_wing(whole, height, divisions),
        blur_factor=float(np.sum(read**2) / cells) * height,
        third_factor=float(np.sum(read**3) / cells) * height**2,
        skewness_ratio=float(np.sum(read**3) / cells / exact),
    )


def _fine_transfer(blurs: tuple[Blur, ...], pitch_x_mm: float, pitch_y_mm: float) -> NDArray[np.float64]:
    fine = np.fft.fftfreq(SIDE * FINEST, 1.0 / FINEST)
    fx, fy = np.broadcast_arrays(fine[None, :] / pitch_x_mm, fine[:, None] / pitch_y_mm)
    return product(blurs, fx, fy)


def _read(transfer: NDArray, impulse: tuple[float, ...], per_column: int) -> NDArray[np.complex128]:
    """The transfer with that of a filter along lines."""
    frequency = np.fft.fftfreq(SIDE * per_column, 1.0 / per_column)
    phase = np.exp(-2j * np.pi * np.multiply.outer(frequency, np.arange(len(impulse))))
    filtered: NDArray[np.complex128] = transfer * (phase @ np.array(impulse))
    return filtered


def _third_moment(transfer: NDArray[np.complex128]) -> float:
    density = np.fft.ifft2(transfer).real * FINEST**2
    return float(np.sum(density**3) / FINEST**2)


def _matched(transfer: NDArray[np.float64], height: int, divisions: tuple[int, int]) -> NDArray[np.complex128]:
    """Transfer on the lattice of cells whose squared modulus is that of all that falls on it, centred on the pixel."""
    down, along = divisions
    power = (transfer**2).reshape(FINEST // down, SIDE * down, FINEST // along, SIDE * along).sum(axis=(0, 2))
    fy, fx = np.fft.fftfreq(SIDE * down, 1.0 / down), np.fft.fftfreq(SIDE * along, 1.0 / along)
    own = np.ix_(*(np.rint(f * SIDE).astype(int) % (SIDE * FINEST) for f in (fy, fx)))
    # The pixel's centre lies this far beyond that of its first cell.
    shift = (0.5 * height - 0.5 / down) * fy[:, None] + (0.5 - 0.5 / along) * fx[None, :]
    return np.copysign(np.sqrt(power), transfer[own]) * np.exp(2j * np.pi * shift)


def _offsets(height: int, divisions: tuple[int, int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of cells within `REACH` pixels, counted from the pixel's first cell."""
    down, along = divisions
    rows = np.arange(-REACH * down, (REACH + height) * down)
    columns = np.arange(-REACH * along, (REACH + 1) * along)
    return rows, columns


def _compact(whole: NDArray[np.float64], height: int, divisions: tuple[int, int]) -> list[NDArray[np.float64]]:
    """The part within `REACH` pixels of each plane of cells, shape (row, col) of its own cells."""
    rows, columns = _offsets(height, divisions)
    near = whole[np.ix_(-rows % whole.shape[0], -columns % whole.shape[1])]
    down, along = divisions
    return [near[i::down, j::along] for i in range(down) for j in range(along)]


def _separated(plane: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Separable parts, (rank, row) and (rank, col), whose outer products add up to the plane."""
    u, s, v = np.linalg.svd(plane)
    beyond = np.append(np.cumsum(s[::-1] ** 2)[::-1][1:], 0.0)
    rank = 1 + int(np.argmax(beyond < LEFT_OUT * np.sum(s**2)))
    root = np.sqrt(s[:rank])[:, None]
    return u[:, :rank].T * root, v[:rank] * root


def _stacked(parts: list[NDArray[np.float64]]) -> NDArray[np.float32]:
    """Planes may need different ranks; the shorter are filled with nothing."""
    rank = max(len(part) for part in parts)
    return np.stack([np.pad(part, ((0, rank - len(part)), (0, 0))) for part in parts]).astype(np.float32)


def _wing(whole: NDArray[np.float64], height: int, divisions: tuple[int, int]) -> NDArray[np.float32]:
    """The rest of the kernel, averaged over the cells of coarse cells, about the pixel's centre."""
    rows, columns = _offsets(height, divisions)
    rest = whole.copy()
    rest[np.ix_(-rows % whole.shape[0], -columns % whole.shape[1])] = 0.0
    down, along = divisions
    per_pixel = rest.reshape(SIDE, down, SIDE, along).mean(axis=(1, 3))
    centred = np.roll(per_pixel, (SIDE // 2 + COARSE // 2, SIDE // 2 + COARSE // 2), axis=(0, 1))
    coarse = SIDE // COARSE
    return centred.reshape(coarse, COARSE, coarse, COARSE).mean(axis=(1, 3)).astype(np.float32)
