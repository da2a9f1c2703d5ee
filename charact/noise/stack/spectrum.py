"""Power of the temporal noise at low spatial frequency, where it tends to the covariance summed over lags."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Radius up to which spectra are kept, cycles per column pitch, and the rings and sectors they are averaged in.
BAND_CY_PER_PX = 0.25
RINGS = 25
SECTORS = 4
# Rows of one exposure alias beyond this frequency, cycles per row of the exposure.
ROW_LIMIT_CY = 0.3
# Fewest modes in a bin: nearest frequency 0 the sectors of a ring, which are alike there, are one bin.
LEAST_MODES = 8
LEAST_MODES_OF_RING = 3
# Share of each side of the image that is faded out: the edges of a plain window leak from low to high frequency.
FADED = 0.08


@dataclass(frozen=True, kw_only=True)
class Bins:
    """The cells of spatial frequency that modes are averaged in.

    Parameters
    ----------
    column_cy_per_px, row_cy_per_px
        Root mean square of the frequency along rows and along columns, cycles per column pitch, shape (bin,).
    modes
        Modes in each, shape (bin,).
    select
        Index of the bin of each mode of the half plane, -1 for none.
    efficiency
        Independent modes per mode: what fading out the sides leaves.
    row_pitch
        Distance of the rows of one exposure, column pitches.
    """

    column_cy_per_px: Array
    row_cy_per_px: Array
    modes: Array
    select: NDArray[np.int64]
    window: NDArray[np.float32]
    efficiency: float
    row_pitch: float

    @cached_property
    def leak_cy2_per_px2(self) -> tuple[float, float]:
        """Variance of the frequencies that the faded sides mix into one mode, along rows and along columns."""
        total = 4.0 * np.pi**2 * float((self.window.astype(float) ** 2).sum())
        across, down = (float((np.diff(self.window.astype(float), axis=axis) ** 2).sum()) for axis in (1, 0))
        return across / total, down / total / self.row_pitch**2

    @cached_property
    def fades(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The window along each axis, of which it is the product."""
        rows, cols = (_fade(length).astype(np.float32) for length in self.window.shape)
        return rows, cols

    @cached_property
    def power(self) -> float:
        """Sum of the squares of the window: what white noise of variance one leaves in a mode."""
        return float((self.window.astype(float) ** 2).sum())

    @cached_property
    def columns(self) -> int:
        """Frequencies along rows up to the highest that any bin holds."""
        return int(np.flatnonzero((self.select >= 0).any(axis=0)).max(initial=-1)) + 1

    @cached_property
    def order(self) -> NDArray[np.int64]:
        """Places in the half plane, cut to `columns`, of the modes of one bin after the other, shape (mode,)."""
        select = self.select[:, : self.columns].ravel()
        order = np.argsort(select, kind="stable")
        return order[np.searchsorted(select[order], 0) :]

    @cached_property
    def edges(self) -> NDArray[np.int64]:
        """First mode of each bin in that order and the end of the last, shape (bin + 1,)."""
        return np.concatenate([[0], np.cumsum(np.bincount(self.select[self.select >= 0], minlength=len(self.modes)))])


NO_BINS = Bins(
    column_cy_per_px=np.empty(0), row_cy_per_px=np.empty(0), modes=np.empty(0), select=np.empty((0, 0), np.int64),
    window=np.empty((0, 0), np.float32), efficiency=1.0, row_pitch=1.0,
)  # fmt: skip


def smooth_length(length: int) -> int:
    """Return the longest length up to this one without prime factors above 7, which transforms quickly."""
    return next(n for n in range(length, 0, -1) if _smooth(n))


def _smooth(number: int) -> bool:
    for prime in (2, 3, 5, 7):
        while number % prime == 0:
            number //= prime
    return number == 1


@lru_cache(maxsize=8)
def bins_of(rows: int, cols: int, row_pitch: float) -> Bins:
    """Return the bins of an image whose rows lie `row_pitch` column pitches apart.

    The modes along the two axes stay outside: noise of whole rows (clamp, hum) and columns lives there.
    """
    along_rows = np.broadcast_to(np.fft.rfftfreq(cols)[None, :], (rows, cols // 2 + 1))
    along_cols = np.broadcast_to(np.fft.fftfreq(rows)[:, None] / row_pitch, along_rows.shape)
    radius = np.hypot(along_rows, along_cols)
    angle = np.arctan2(np.abs(along_cols), along_rows)
    ring = (radius / BAND_CY_PER_PX * RINGS).astype(int)
    sector = np.minimum((angle / (np.pi / 2) * SECTORS).astype(int), SECTORS - 1)
    # Modes of a whole ring, pi/2 ((k + 1)^2 - k^2) of its width squared each pixel, leave every sector its share.
    sparse = (
        0.5 * np.pi * (2 * ring + 1) * (BAND_CY_PER_PX / RINGS) ** 2 * rows * cols * row_pitch
        < 1.5 * LEAST_MODES * SECTORS
    )
    cell = ring * SECTORS + np.where(sparse, 0, sector)
    nyquist = (along_rows == 0.5) if cols % 2 == 0 else np.zeros_like(ring, bool)
    aliased = np.abs(along_cols) * row_pitch > ROW_LIMIT_CY
    cell[(ring >= RINGS) | (along_rows == 0) | (along_cols == 0) | nyquist | aliased] = -1
    kept, position, modes = np.unique(cell, return_inverse=True, return_counts=True)
    position = position.reshape(cell.shape)
    size = [np.sqrt(np.bincount(position.ravel(), (f**2).ravel()) / modes) for f in (along_rows, along_cols)]
    merged = np.bincount(position.ravel(), sparse.ravel()) > 0
    full = (kept >= 0) & (modes >= np.where(merged, LEAST_MODES_OF_RING, LEAST_MODES))
    renumber = np.where(full, np.cumsum(full) - 1, -1)
    window = np.outer(_fade(rows), _fade(cols)).astype(np.float32)
    efficiency = float((window.astype(float) ** 2).sum() ** 2 / (window.astype(float) ** 4).sum() / window.size)
    return Bins(column_cy_per_px=size[0][full], row_cy_per_px=size[1][full], modes=modes[full].astype(float),
                select=renumber[position], window=window, efficiency=efficiency, row_pitch=row_pitch)  # fmt: skip


def _fade(length: int) -> Array:
    """A window that is flat but for raised cosines at its ends."""
    place = (np.arange(length) + 0.5) / length
    edge = np.minimum(place, 1 - place) / FADED
    return np.where(edge < 1, 0.5 - 0.5 * np.cos(np.pi * np.minimum(edge, 1)), 1.0)


def cross_spectra(change: NDArray[np.float32], parity: NDArray[np.int64], bins: Bins) -> Array:
    """Return the mean product of the modes of exposures i and j in every bin, shape (bin, exposure, exposure), DN^2.

    Parameters
    ----------
    change
        Fluctuations, shape (exposure, row, col), DN; rows and columns beyond those of the bins stay outside.
    parity
        Which rows of the frame each exposure holds, shape (exposure,).
    bins
        The bins.

    Notes
    -----
    Normalised so that white noise of variance v gives v at i = j. Rows of odd parity lie half an image row lower,
    which turns their modes' phase; it is turned back, so that exposures of both parities may be compared.
    """
    rows = bins.window.shape[0]
    modes = [
        modes_of(along_rows(image[:rows], 0, bins), int(odd), bins) for image, odd in zip(change, parity, strict=True)
    ]
    return products_of(np.array(modes), bins)


def along_rows(band: NDArray[np.float32], first: int, bins: Bins) -> NDArray[np.complex64]:
    """Return the spectra of rows `first` and following, the sides faded out, shape (..., row, column of modes)."""
    from scipy import fft

    fade_rows, fade_cols = bins.fades
    spectra = np.asarray(fft.rfft(band[..., : len(fade_cols)] * fade_cols, axis=-1, workers=1), np.complex64)
    return spectra[..., : bins.columns] * fade_rows[first : first + band.shape[-2], None]


def modes_of(along: NDArray[np.complex64], parity: int, bins: Bins) -> NDArray[np.float32]:
    """Return the modes of an exposure, from the spectra of all its rows, in the order of the bins.

    Real and imaginary parts, shape (2, mode).
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
    """Return the mean product of modes in every bin, shape (bin, exposure, exposure), DN^2; see `cross_spectra`."""
    return _products(modes, bins.edges) / (bins.power * np.diff(bins.edges)[:, None, None])


@njit(cache=True, fastmath=True)
def _products(modes, edges):
    """Sum over the modes of each bin of the real part of their products, exposure with exposure."""
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
