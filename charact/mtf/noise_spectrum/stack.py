"""Noise spectra of one stack of flats or darks over the whole band, and its memory of earlier exposures."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.stack.spectrum import Bins, bins_of, cross_spectra
from charact.noise.stack.temporal import (
    autocovariance,
    exposures,
    fluctuations,
    n_effective_samples,
    runs_of,
    usable_lags,
)
from labdata.errors import BadInput
from labdata.frames import FrameStack

Array = NDArray[np.float64]

# Cells of frequency on each axis, and the least modes that one is averaged over.
MAX_CELLS = 20
MODES_ALONG = 4
MIN_MODES = 8
# Modes this near an axis hold the noise of whole rows and columns, and what the faded sides leak of it.
NEAR_AXIS = 2
# Exposures this far apart may still share light.
MAX_LAGS = 12
# Correlation in time is read where light outshines the white floor, cycles per column pitch; exposures of opposite
# rows are compared only where rows do not alias, cycles per row of the exposure.
LAG_BAND = 0.2
LAG_ROW_BAND = 0.08


@dataclass(frozen=True, kw_only=True)
class StackSpectra:
    """Spectra of one stack: with exposures taken as independent, and with lags allowed for."""

    bins: Bins
    plain_dn2: Array
    lagged_dn2: Array
    low_dn2: Array
    lags: NDArray[np.int64]
    time: NDArray[np.int64]
    parity: NDArray[np.int64]
    runs: int
    frames: int

    def power(self, lag: Array) -> Array:
        """Return the power of each cell, DN^2, lags allowed for where any are given."""
        return self.lagged_dn2 if len(lag) else self.plain_dn2

    def independent(self, lag: Array) -> float:
        """Return how many independent exposures are behind the power if they are correlated so in time."""
        own = self._same_parity(self.lags) if len(lag) else np.zeros(1, np.int64)
        return self.runs * n_effective_samples(self.time, self.parity, own, lag, within_parity=True)

    def _same_parity(self, lags: NDArray[np.int64]) -> NDArray[np.int64]:
        return lags[lags % 2 == 0] if len(np.unique(self.parity)) > 1 else lags


def stack_spectra(stack: FrameStack, context: Context) -> StackSpectra:
    """Return the spectra of a stack, run by run."""
    plain, lagged, low, weight = [], [], [], []
    runs = runs_of(stack)
    for first, last in runs:
        shots = exposures(stack, first, last, interlaced=context.interlaced)
        change = fluctuations(shots)
        bins = frequency_cells(change.shape[1], change.shape[2], context.pitch_ratio * shots.row_step)
        products = cross_spectra(change, shots.parity, bins)
        lags = usable_lags(shots.time, shots.parity, MAX_LAGS)
        same = lags[lags % 2 == 0] if context.interlaced else lags
        none = np.zeros(1, np.int64)
        plain.append(autocovariance(products, shots.time, shots.parity, none, within_parity=True)[:, 0])
        lagged.append(autocovariance(products, shots.time, shots.parity, same, within_parity=True)[:, 0])
        pooled = np.tensordot(low_frequency_weights(bins), products, 1)
        low.append(autocovariance(pooled, shots.time, shots.parity, lags))
        weight.append(len(shots.time))
    count = min(len(part) for part in low)
    return StackSpectra(
        bins=bins,
        plain_dn2=np.average(plain, axis=0, weights=weight),
        lagged_dn2=np.average(lagged, axis=0, weights=weight),
        low_dn2=np.average([part[:count] for part in low], axis=0, weights=weight),
        lags=lags[:count],
        time=shots.time,
        parity=shots.parity,
        runs=len(runs),
        frames=len(stack),
    )


def low_frequency_weights(bins: Bins) -> Array:
    """Weights of the cells in which the correlation in time is read."""
    inside = np.hypot(bins.column_cy_per_px, bins.row_cy_per_px) < LAG_BAND
    inside &= bins.row_cy_per_px * bins.row_pitch < max(LAG_ROW_BAND, 1.01 * bins.row_cy_per_px.min() * bins.row_pitch)
    weight = bins.modes * inside
    return weight / max(weight.sum(), 1.0)


def frequency_cells(rows: int, cols: int, row_pitch: float) -> Bins:
    """Return the cells of frequency of an image whose rows lie `row_pitch` column pitches apart, axes left out.

    Raises
    ------
    BadInput
        If fewer than 24 cells hold modes enough.
    """
    plain = bins_of(rows, cols, row_pitch)
    along = np.arange(cols // 2 + 1)[None, :]
    down = np.abs(np.round(np.fft.fftfreq(rows) * rows))[:, None]
    across, up = (int(np.clip(n // (2 * MODES_ALONG), 1, MAX_CELLS)) for n in (cols, rows))
    cell = np.minimum(2 * along * across // cols, across - 1).astype(np.int64) * up
    cell = cell + np.minimum(2 * down * up // rows, up - 1).astype(np.int64)
    cell[(along <= NEAR_AXIS) | (down <= NEAR_AXIS) | (2 * along == cols)] = -1
    kept, position, modes = np.unique(cell, return_inverse=True, return_counts=True)
    position = position.reshape(cell.shape)
    full = (kept >= 0) & (modes >= MIN_MODES)
    if full.sum() < 24:
        raise BadInput(f"images must have some 48 x 48 pixels an exposure for a noise spectrum, got {rows} x {cols}")
    column, row = (np.broadcast_to(f, cell.shape).ravel() for f in (along / cols, down / rows / row_pitch))
    mean = [np.bincount(position.ravel(), f) / modes for f in (column, row)]
    select = np.where(full, np.cumsum(full) - 1, -1)[position]
    return replace(
        plain, column_cy_per_px=mean[0][full], row_cy_per_px=mean[1][full], modes=modes[full].astype(float),
        select=select,
    )  # fmt: skip


def smear(window: NDArray[np.float32]) -> float:
    """Standard deviation of the kernel |W|^2 that a window convolves a spectrum with, cycles per sample.

    Its second moment is the integral of w'^2 over (2 pi)^2 times that of w^2.
    """
    fine = window.astype(float)
    return float(np.sqrt(np.sum(np.diff(fine) ** 2) / np.sum(fine**2)) / (2.0 * np.pi))
