"""Power spectrum of the temporal noise at low spatial frequency, whose limit is the summed
covariance.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from charact.frames.thresholds import STACK

Array = NDArray[np.float64]
# Largest radial frequency of spectra, cycles per column pitch, and the rings and sectors of
# averaging.
BAND_CY_PER_PX = 0.25
# Rows of one exposure alias beyond this frequency, cycles per row of the exposure.
ROW_LIMIT_CY = 0.3


@dataclass(frozen=True, kw_only=True)
class Bins:
    """Bins of spatial frequency."""

    # column_cy_per_px, row_cy_per_px: root mean square of the frequency along rows and along
    # columns, cycles per column pitch, shape (bin,)
    column_cy_per_px: Array
    row_cy_per_px: Array
    modes: Array  # number of modes in each bin, shape (bin,)
    select: NDArray[np.int64]  # index of the bin of each mode of the half plane, -1 for none
    window: NDArray[np.float32]
    efficiency: float  # independent modes per mode, reduced by the taper
    row_pitch: float  # row pitch of one exposure, column pitches

    @cached_property
    def leak_cy2_per_px2(self) -> tuple[float, float]:
        """Variance of the frequencies mixed into one mode by the taper, along rows and along
        columns.
        """
        total = 4.0 * np.pi**2 * float((self.window.astype(float) ** 2).sum())
        across, down = (
            float((np.diff(self.window.astype(float), axis=axis) ** 2).sum()) for axis in (1, 0)
        )
        return across / total, down / total / self.row_pitch**2

    @cached_property
    def fades(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Factors of the window along each axis."""
        rows, cols = (_fade(length).astype(np.float32) for length in self.window.shape)
        return rows, cols

    @cached_property
    def power(self) -> float:
        """Sum of the squares of the window: mode power of white noise of variance one."""
        return float((self.window.astype(float) ** 2).sum())

    @cached_property
    def columns(self) -> int:
        """Number of frequencies along rows up to the highest of any bin."""
        return int(np.flatnonzero((self.select >= 0).any(axis=0)).max(initial=-1)) + 1

    @cached_property
    def order(self) -> NDArray[np.int64]:
        """Indices of the modes, bin after bin, in the half plane cut to `columns`, shape
        (mode,).
        """
        select = self.select[:, : self.columns].ravel()
        order = np.argsort(select, kind="stable")
        return order[np.searchsorted(select[order], 0) :]

    @cached_property
    def edges(self) -> NDArray[np.int64]:
        """First mode of each bin in that order and the end of the last, shape (bin + 1,)."""
        return np.concatenate(
            [[0], np.cumsum(np.bincount(self.select[self.select >= 0], minlength=len(self.modes)))]
        )


NO_BINS = Bins(
    column_cy_per_px=np.empty(0),
    row_cy_per_px=np.empty(0),
    modes=np.empty(0),
    select=np.empty((0, 0), np.int64),
    window=np.empty((0, 0), np.float32),
    efficiency=1.0,
    row_pitch=1.0,
)


def smooth_length(length: int) -> int:
    """Return the longest length up to this one without prime factors above 7 (fast transform)."""
    for number in range(length, 0, -1):
        cofactor = number
        for prime in (2, 3, 5, 7):
            while cofactor % prime == 0:
                cofactor //= prime
        if cofactor == 1:
            return number
    raise ValueError(f"an image must have at least one pixel along each axis, got {length}")


@lru_cache(maxsize=8)
def bins_of(rows: int, cols: int, row_pitch: float) -> Bins:
    """Return the bins of an image with a row pitch of `row_pitch` column pitches.

    The modes on the two axes are excluded, because they contain row noise (clamp, hum) and column
    noise.
    """
    along_rows = np.broadcast_to(np.fft.rfftfreq(cols)[None, :], (rows, cols // 2 + 1))
    along_cols = np.broadcast_to(np.fft.fftfreq(rows)[:, None] / row_pitch, along_rows.shape)
    radius = np.hypot(along_rows, along_cols)
    angle = np.arctan2(np.abs(along_cols), along_rows)
    ring = (radius / BAND_CY_PER_PX * STACK.rings).astype(int)
    sector = np.minimum((angle / (np.pi / 2) * STACK.sectors).astype(int), STACK.sectors - 1)
    # A ring has pi/2 ((k + 1)^2 - k^2) modes per pixel in units of its squared width, divided over
    # its sectors.
    sparse = (
        0.5 * np.pi * (2 * ring + 1) * (BAND_CY_PER_PX / STACK.rings) ** 2 * rows * cols * row_pitch
        < 1.5 * STACK.min_modes * STACK.sectors
    )
    cell = ring * STACK.sectors + np.where(sparse, 0, sector)
    nyquist = (along_rows == 0.5) if cols % 2 == 0 else np.zeros_like(ring, bool)
    aliased = np.abs(along_cols) * row_pitch > ROW_LIMIT_CY
    cell[(ring >= STACK.rings) | (along_rows == 0) | (along_cols == 0) | nyquist | aliased] = -1
    cells, position, modes = np.unique(cell, return_inverse=True, return_counts=True)
    position = position.reshape(cell.shape)
    size = [
        np.sqrt(np.bincount(position.ravel(), (f**2).ravel()) / modes)
        for f in (along_rows, along_cols)
    ]
    merged = np.bincount(position.ravel(), sparse.ravel()) > 0
    full = (cells >= 0) & (modes >= np.where(merged, STACK.min_ring_modes, STACK.min_modes))
    renumber = np.where(full, np.cumsum(full) - 1, -1)
    window = np.outer(_fade(rows), _fade(cols)).astype(np.float32)
    efficiency = float(
        (window.astype(float) ** 2).sum() ** 2 / (window.astype(float) ** 4).sum() / window.size
    )
    return Bins(
        column_cy_per_px=size[0][full],
        row_cy_per_px=size[1][full],
        modes=modes[full].astype(float),
        select=renumber[position],
        window=window,
        efficiency=efficiency,
        row_pitch=row_pitch,
    )


def _fade(length: int) -> Array:
    """Return a window with raised-cosine ends."""
    position = (np.arange(length) + 0.5) / length
    edge = np.minimum(position, 1 - position) / STACK.taper
    return np.where(edge < 1, 0.5 - 0.5 * np.cos(np.pi * np.minimum(edge, 1)), 1.0)


def along_rows(band: NDArray[np.float32], first: int, bins: Bins) -> NDArray[np.complex64]:
    """Return the spectra of the tapered rows from `first` on, shape (..., row, column of modes)."""
    from scipy import fft

    fade_rows, fade_cols = bins.fades
    spectra = np.asarray(
        fft.rfft(band[..., : len(fade_cols)] * fade_cols, axis=-1, workers=1), np.complex64
    )
    return spectra[..., : bins.columns] * fade_rows[first : first + band.shape[-2], None]


def modes_of(along: NDArray[np.complex64], parity: int, bins: Bins) -> NDArray[np.float32]:
    """Return the modes of an exposure, from the spectra of its rows, in the order of the bins: real
    and imaginary parts, shape (2, mode).
    """
    from scipy import fft

    if not len(bins.order):
        return np.empty((2, 0), np.float32)
    modes = np.asarray(fft.fft(along, axis=0, workers=1, overwrite_x=True), np.complex64)
    if parity:
        modes *= np.exp(-1j * np.pi * np.fft.fftfreq(len(modes))).astype(np.complex64)[:, None]
    chosen = modes.ravel()[bins.order]
    return np.stack([chosen.real, chosen.imag])


def products_of(modes: NDArray[np.float32], bins: Bins) -> Array:
    """Return the mean product of modes in every bin, shape (bin, exposure, exposure), DN^2.

    White noise of variance v gives v at i = j.
    """
    return _products(modes, bins.edges) / (bins.power * np.diff(bins.edges)[:, None, None])


@njit(cache=True, fastmath=True)
def _products(modes, edges):
    """Sum the real part of mode products over each bin, exposure by exposure."""
    count = len(modes)
    out = np.zeros((len(edges) - 1, count, count))
    for cell in range(len(edges) - 1):
        for i in range(count):
            for j in range(i + 1):
                total = np.float32(0.0)
                for part in range(2):
                    for mode in range(edges[cell], edges[cell + 1]):
                        total += modes[i, part, mode] * modes[j, part, mode]
                out[cell, i, j] = total
                out[cell, j, i] = total
    return out
