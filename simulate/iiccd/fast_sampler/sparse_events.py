"""Sparse events: each pulse drawn with its own position and arrival time."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simulate.iiccd.accuracy import ACCURACY
from simulate.iiccd.fast_sampler.frame_generator import Shared
from simulate.iiccd.fast_sampler.kernel import COARSE, FINEST, REACH, PulseKernel

Array = NDArray[np.float32]
Places = NDArray[np.int32]
# What a generator is for.
PULSES = 59
# Cells to a pixel pitch, and places to a cell, both ways.
CELLS, PLACES = 2, FINEST // 2


@dataclass(frozen=True, kw_only=True)
class SparseEventSampler:
    """Pulses that fall anywhere in their cells, two cells to a pixel both ways.

    Parameters
    ----------
    expected
        Mean number of detected photoelectrons of every cell in one exposure, shape (row, col); the first cell lies
        under the kernel of the first pixel.
    gain
        CCD electrons per mean pulse of every cell, shape (row, col).
    shape
        Gamma shape of pulses.
    ions_per_field, ion_size
        Ion events on all cells in one exposure, and their mean number of pulses.
    kernel
        Spread of a pulse.
    size
        Rows and columns of the frame.
    stays, kept
        Mean fraction of a pulse that each component of the phosphor's decay stores, and the fraction of what is stored
        that stays stored for one exposure more, shape (component,).
    later
        Fractions that each component stores of pulses by their time of arrival in the exposure's open time, 0..1, shape
        (component, pulse).
    fields
        Exposures in a frame.
    """

    expected: Array
    gain: Array
    shape: float
    ions_per_field: float
    ion_size: float
    kernel: PulseKernel
    size: tuple[int, int]
    stays: Array
    kept: Array
    later: Callable[[Array], Array]
    fields: int

    @property
    def pulse_e(self) -> float:
        """Variance of a pixel's charge over its mean, from pulses alone, e-."""
        squares = float(np.sum(self.kernel.shares**2)) / (FINEST**2 * self.kernel.height)
        return float(self.gain.mean()) * (1.0 + 1.0 / self.shape) * squares

    @cached_property
    def running(self) -> NDArray[np.float64]:
        """Photoelectrons expected in all cells up to each, shape (cell,)."""
        return np.cumsum(self.expected, dtype=np.float64)

    @cached_property
    def guide(self) -> NDArray[np.int32]:
        """First cell beyond each of evenly spaced parts of the expected photoelectrons, shape (part,)."""
        parts = np.arange(ACCURACY.n_search_guides) * (self.running[-1] / ACCURACY.n_search_guides)
        return np.searchsorted(self.running, parts, side="right").astype(np.int32)

    @cached_property
    def charge_e(self) -> Array:
        """Mean charge that pulses bring to cells, e-, shape (row, col)."""
        ions = np.float32(self.ions_per_field * self.ion_size / self.gain.size)
        return np.asarray(self.gain * (self.expected + ions), np.float32)

    @cached_property
    def near_e(self) -> Array:
        """Mean charge that pulses bring to pixels by the compact kernel, e-, shape (row, col)."""
        from scipy.signal import fftconvolve

        shares = self.kernel.shares
        taps, breadth = shares.shape[2:]
        # Pulses are even over a cell: its kernel is the mean of its places'.
        cells = shares.reshape(CELLS, PLACES, CELLS, PLACES, taps, breadth).mean(axis=(1, 3))
        parts = [
            fftconvolve(self.charge_e[i::CELLS, j::CELLS], cells[i, j]) for i in range(CELLS) for j in range(CELLS)
        ]
        rows, cols = self.size
        further = REACH - self.kernel.reach
        whole = np.sum(parts, axis=0)[taps - 1 + further :, breadth - 1 + further :]
        return np.ascontiguousarray(whole[:rows, :cols], np.float32)

    @cached_property
    def lines(self) -> Array:
        """The kernel's fractions, padded to a multiple of `ADDED_AT_ONCE` columns."""
        from simulate.iiccd.fast_sampler.phosphor_rows import ADDED_AT_ONCE

        shares = self.kernel.shares
        return np.pad(shares, [(0, 0)] * 3 + [(0, -shares.shape[3] % ADDED_AT_ONCE)])

    @cached_property
    def coarse_e(self) -> Array:
        """Mean charge that pulses bring to coarse cells, e-, shape (coarse row, coarse col)."""
        side = CELLS * COARSE
        rows, cols = (n // side for n in self.charge_e.shape)
        return self.charge_e.reshape(rows, side, cols, side).sum(axis=(1, 3))

    def phosphor_sampler(self, seed: int) -> "SparsePhosphorSampler":
        """Return the phosphor in its initial state."""
        return SparsePhosphorSampler(self, seed)


@dataclass(frozen=True, kw_only=True)
class _Pulses:
    """Places of pulses in fractions of a pixel, their electrons, and those of them that come later."""

    rows: Places
    columns: Places
    charge: Array
    later: Array


class SparsePhosphorSampler:
    """Phosphor on pixels from one exposure to the next."""

    def __init__(self, light: SparseEventSampler, seed: int) -> None:
        self._light, self._seed = light, seed
        self._stored = np.zeros((len(light.stays), *light.size), np.float32)
        self._coarse_stored = np.zeros((len(light.stays), *light.coarse_e.shape), np.float32)
        self.shown = np.zeros((light.fields, 1, *light.size), np.float32)
        # Pulses are laid on pixels at once.
        self.spread = np.ones((1, 1, 1), np.float32), np.ones((1, 1, 1), np.float32)
        self.far = light.kernel

    def forget(self) -> None:
        """Reset the stored light to its mean."""
        self._stored[:] = 0.0
        self._coarse_stored[:] = 0.0

    def expose(self, frame: int, brightness: float, shared: Shared) -> Array:
        """Draw the pulses of a frame's exposures and apply phosphor decay; see `PhosphorSampler`."""
        from simulate.iiccd.fast_sampler.phosphor_rows import pulse_rows

        light, coarse = self._light, []
        near, factor = light.near_e * np.float32(brightness), np.float32(brightness)
        for number in range(light.fields):
            pulses = self._draw_pulses(frame * light.fields + number, factor)
            places, shown = (pulses.rows, pulses.columns, pulses.charge, pulses.later), self.shown[number, 0]
            given = (number, light.fields, light.kernel.reach), places, light.lines, (near, light.stays), light.kept
            shared(lambda a, b, g=given, s=shown: pulse_rows(a, b, *g, self._stored, s), light.size[0], 1)
            coarse.append(self._on_coarse_cells(pulses, factor))
        return np.stack(coarse)

    def _draw_pulses(self, exposure: int, factor: np.float32) -> _Pulses:
        from simulate.iiccd.fast_sampler.phosphor_rows import cells_beyond

        light = self._light
        rng = np.random.default_rng([self._seed, PULSES, exposure + 2**32])
        number, ions = rng.poisson(light.running[-1]), rng.poisson(light.ions_per_field)
        # Even numbers in order, so that memory is walked through once: running sums of exponential ones, over the last.
        running = np.cumsum(rng.standard_exponential(number + 1))
        cells = cells_beyond(running[:-1] * (light.running[-1] / running[-1]), light.running, light.guide)
        cells = np.concatenate([cells, rng.integers(light.gain.size, size=ions)])
        heights = [
            rng.standard_gamma(light.shape, size=number),
            rng.standard_gamma(rng.poisson(light.ion_size, size=ions) * light.shape),
        ]
        charge = np.concatenate(heights) / light.shape * light.gain.ravel()[cells] * factor
        rows, columns = np.divmod(cells, light.gain.shape[1])
        within = rng.integers(PLACES, size=(2, len(cells)))
        later = charge * light.later(rng.random(len(cells), np.float32))
        return _Pulses(
            rows=(PLACES * rows + within[0]).astype(np.int32),
            columns=(PLACES * columns + within[1]).astype(np.int32),
            charge=charge.astype(np.float32),
            later=later.astype(np.float32),
        )

    def _on_coarse_cells(self, pulses: _Pulses, factor: np.float32) -> Array:
        """Light of an exposure beyond the mean, summed over coarse cells."""
        from simulate.iiccd.fast_sampler.phosphor_rows import coarse_sums

        light, stored = self._light, self._coarse_stored
        side = FINEST * COARSE
        sums = coarse_sums(pulses.rows, pulses.columns, pulses.charge, pulses.later, side, *light.coarse_e.shape)
        shown = sums[0] - factor * (np.float32(1.0) - light.stays.sum()) * light.coarse_e
        for one, stays, kept, later in zip(stored, light.stays, light.kept, sums[1:], strict=True):
            shown += (np.float32(1.0) - kept) * one
            one *= kept
            one += later - factor * stays * light.coarse_e
        return shown
