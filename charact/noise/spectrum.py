"""Power of the temporal noise at low spatial frequency, where it tends to the covariance summed over lags."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Radius up to which spectra are kept, cycles per column pitch, and the rings and sectors they are averaged in.
BAND_CY_PER_PX = 0.25
RINGS = 25
SECTORS = 4
# Rows of one exposure alias beyond this frequency, cycles per row of the exposure.
ROW_LIMIT_CY = 0.3
# Share of each side of the image that is faded out: the edges of a plain window leak from low to high frequency.
FADED = 0.08


@dataclass(frozen=True, kw_only=True)
class Bins:
    """The cells of spatial frequency that modes are averaged in.

    Parameters
    ----------
    column_cy_per_px, row_cy_per_px
        Mean size of the frequency along rows and along columns, cycles per column pitch, shape (bin,).
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


NO_BINS = Bins(
    column_cy_per_px=np.empty(0), row_cy_per_px=np.empty(0), modes=np.empty(0), select=np.empty((0, 0), np.int64),
    window=np.empty((0, 0), np.float32), efficiency=1.0, row_pitch=1.0,
)  # fmt: skip


def bins_of(rows: int, cols: int, row_pitch: float) -> Bins:
    """Return the bins of an image whose rows lie `row_pitch` column pitches apart.

    The modes along the two axes stay outside: noise of whole rows (clamp, hum) and columns lives there.
    """
    along_rows = np.broadcast_to(np.fft.rfftfreq(cols)[None, :], (rows, cols // 2 + 1))
    along_cols = np.broadcast_to(np.fft.fftfreq(rows)[:, None] / row_pitch, along_rows.shape)
    radius = np.hypot(along_rows, along_cols)
    angle = np.arctan2(np.abs(along_cols), along_rows)
    ring = (radius / BAND_CY_PER_PX * RINGS).astype(int)
    cell = ring * SECTORS + np.minimum((angle / (np.pi / 2) * SECTORS).astype(int), SECTORS - 1)
    nyquist = (along_rows == 0.5) if cols % 2 == 0 else np.zeros_like(ring, bool)
    aliased = np.abs(along_cols) * row_pitch > ROW_LIMIT_CY
    cell[(ring >= RINGS) | (along_rows == 0) | (along_cols == 0) | nyquist | aliased] = -1
    kept, position, modes = np.unique(cell, return_inverse=True, return_counts=True)
    position = position.reshape(cell.shape)
    mean = [np.bincount(position.ravel(), np.abs(f).ravel()) / modes for f in (along_rows, along_cols)]
    full = (kept >= 0) & (modes >= 8)
    renumber = np.where(full, np.cumsum(full) - 1, -1)
    window = np.outer(_fade(rows), _fade(cols)).astype(np.float32)
    efficiency = float((window.astype(float) ** 2).sum() ** 2 / (window.astype(float) ** 4).sum() / window.size)
    return Bins(column_cy_per_px=mean[0][full], row_cy_per_px=mean[1][full], modes=modes[full].astype(float),
                select=renumber[position], window=window, efficiency=efficiency, row_pitch=row_pitch)  # fmt: skip


def _fade(length: int) -> Array:
    """A window that is flat but for raised cosines at its ends."""
    place = (np.arange(length) + 0.5) / length
    edge = np.minimum(place, 1 - place) / FADED
    return np.where(edge < 1, 0.5 - 0.5 * np.cos(np.pi * np.minimum(edge, 1)), 1.0)


def cross_spectra(change: NDArray[np.float32], parity: NDArray[np.int64], bins: Bins) -> Array:
    """Return the mean product of the modes of exposures i and j in every bin, shape (bin, exposure, exposure), DN^2.

    Normalised so that white noise of variance v gives v at i = j. Rows of odd parity lie half an image row lower,
    which turns their modes' phase; it is turned back, so that exposures of both parities may be compared.
    """
    from scipy import fft

    modes = np.asarray(fft.rfft2(change * bins.window, workers=1))
    turn = np.exp(-1j * np.pi * np.fft.fftfreq(change.shape[1])).astype(np.complex64)
    modes[parity == 1] *= turn[:, None]
    scale = float((bins.window.astype(float) ** 2).sum())
    out = np.empty((len(bins.modes), len(change), len(change)))
    order = np.argsort(bins.select, axis=None, kind="stable")
    edges = np.searchsorted(bins.select.ravel()[order], np.arange(len(bins.modes) + 1))
    flat = modes.reshape(len(change), -1)
    for index, (first, last) in enumerate(pairwise(edges)):
        part = flat[:, order[first:last]]
        out[index] = np.real(part @ part.conj().T) / (scale * (last - first))
    return out
