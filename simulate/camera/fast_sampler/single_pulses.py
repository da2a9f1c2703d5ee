"""Single pulses, each with its own position and arrival time: their light and their phosphor."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulate.arrays import Array32
from simulate.camera.chain import Chain, Slot
from simulate.camera.fast_sampler.cell_planes import (
    CELLS,
    POSITIONS,
    cell_gain,
    cut_to_frame,
    gather_planes,
    interleave_planes,
)
from simulate.camera.fast_sampler.kernel import COARSE, FINEST, REACH, PulseKernel, pulse_kernel
from simulate.camera.fast_sampler.phosphor_rows import (
    VECTOR_COLUMNS,
    coarse_sums,
    find_cells,
    pulse_rows,
)
from simulate.camera.grid import ACCURACY, Grid
from simulate.camera.phosphor import PhosphorDecay
from simulate.camera.stage_image import StageImage
from simulate.camera.transfer import StageBlur

# Does work on rows in bands of whole blocks: (work of first and last row, rows, rows in a block).
RunInBands = Callable[[Callable[[int, int], None], int, int], None]
# Purpose of a random generator.
PULSES = 59


@dataclass(frozen=True, kw_only=True)
class SparseLight:
    """Pulses that fall anywhere in their cells, two cells to a pixel both ways."""

    # Mean number of detected photoelectrons of every cell in one exposure, shape (row, col); the
    # first cell lies under the kernel of the first pixel.
    expected: Array32
    gain: Array32  # CCD electrons per mean pulse of every cell, shape (row, col)
    shape: float  # gamma shape of pulses
    # Ion events on all cells in one exposure, and their mean number of pulses.
    ions_per_field: float
    ion_size: float
    kernel: PulseKernel  # spread of a pulse

    @classmethod
    def of(
        cls, chain: Chain, at_mcp: StageImage, grid: Grid, blurs: tuple[StageBlur, ...], fields: int
    ) -> "SparseLight":
        """Return the light of single pulses behind the blurs that it still owes."""
        mcp, divisions = chain[Slot.MCP], (CELLS, CELLS)
        expected = (
            cut_to_frame(np.maximum(gather_planes(at_mcp.values, divisions), 0.0), grid)
            * mcp.detection_probability
        )
        gain = interleave_planes(cut_to_frame(cell_gain(chain, at_mcp, divisions), grid))
        return cls(
            expected=interleave_planes(expected).astype(np.float32),
            gain=gain.astype(np.float32),
            shape=mcp.pulse_height_shape,
            ions_per_field=mcp.ions_per_cell(at_mcp) * gain.size,
            ion_size=mcp.ion_event_size_pe,
            kernel=pulse_kernel(blurs, grid.one_pixel(), fields),
        )

    @cached_property
    def cumulative_pe(self) -> NDArray[np.float64]:
        """Photoelectrons expected in all cells up to each, shape (cell,)."""
        return np.cumsum(self.expected, dtype=np.float64)

    @cached_property
    def guide(self) -> NDArray[np.int32]:
        """First cell beyond each of evenly spaced sums of the expected photoelectrons, shape
        (sum,).
        """
        parts = ACCURACY.n_search_guides
        # A total of 0 has no pulses to search for.
        relative = self.cumulative_pe / max(self.cumulative_pe[-1], np.finfo(float).tiny)
        cells = np.bincount((relative * parts).astype(np.int64) + 1, minlength=parts + 2)
        return np.cumsum(cells[:parts]).astype(np.int32)

    @cached_property
    def charge_e(self) -> Array32:
        """Mean charge that pulses bring to cells, e-, shape (row, col)."""
        ions = np.float32(self.ions_per_field * self.ion_size / self.gain.size)
        return np.asarray(self.gain * (self.expected + ions), np.float32)

    def compact_charge_e(self, size: tuple[int, ...]) -> Array32:
        """Return the mean charge that pulses bring to so many pixels by the compact kernel, e-,
        shape (row, col).
        """
        from scipy import fft

        forward: Any = fft.rfft2
        inverse: Any = fft.irfft2
        fractions = self.kernel.fractions
        n_rows, n_columns = fractions.shape[2:]
        # Pulses are uniform over a cell: its kernel is the mean of its positions'.
        cells = fractions.reshape(CELLS, POSITIONS, CELLS, POSITIONS, n_rows, n_columns).mean(
            axis=(1, 3)
        )
        length = [
            n // CELLS + m - 1
            for n, m in zip(self.charge_e.shape, (n_rows, n_columns), strict=True)
        ]
        fast_shape = [fft.next_fast_len(n, real=True) for n in length]
        parts = [
            inverse(
                forward(self.charge_e[i::CELLS, j::CELLS], fast_shape)
                * forward(cells[i, j], fast_shape),
                fast_shape,
            )
            for i in range(CELLS)
            for j in range(CELLS)
        ]
        margin = REACH - self.kernel.half_width_px
        charge_e = np.sum(parts, axis=0)[
            n_rows - 1 + margin : length[0], n_columns - 1 + margin : length[1]
        ]
        return np.ascontiguousarray(charge_e[: size[0], : size[1]], np.float32)

    @cached_property
    def coarse_e(self) -> Array32:
        """Mean charge that pulses bring to coarse cells, e-, shape (coarse row, coarse col)."""
        side = CELLS * COARSE
        rows, cols = (n // side for n in self.charge_e.shape)
        return self.charge_e.reshape(rows, side, cols, side).sum(axis=(1, 3))

    def screen(
        self, decay: PhosphorDecay, fields: int, seed: int, shape: tuple[int, ...]
    ) -> "SparseScreen":
        return SparseScreen(self, decay, fields, seed, shape)


# Rows and columns of pulses in fractions of a pixel, their electrons, and those of them that the
# components of the phosphor store, (component, pulse).
Pulses = tuple[NDArray[np.int32], NDArray[np.int32], Array32, Array32]


class SparseScreen:
    """Phosphor on pixels from one exposure to the next; parameters and methods as of
    `DenseScreen`.
    """

    def __init__(
        self,
        light: SparseLight,
        decay: PhosphorDecay,
        fields: int,
        seed: int,
        shape: tuple[int, ...],
    ) -> None:
        self._decay, self._fields, self._seed = decay, fields, seed
        self._stored_fraction, _, self._kept_fraction = decay.recursion
        self._stored = np.zeros((len(self._stored_fraction), *shape), np.float32)
        self._coarse_stored = np.zeros(
            (len(self._stored_fraction), *light.coarse_e.shape), np.float32
        )
        self.shown = np.zeros((fields, 1, *shape), np.float32)
        # Pulses are laid on pixels at once.
        self.spread = np.ones((1, 1, 1), np.float32), np.ones((1, 1, 1), np.float32)
        self.kernel, fractions = light.kernel, light.kernel.fractions
        # The kernel's fractions, padded to a multiple of the columns added at once.
        self._padded_fractions = np.pad(
            fractions, [(0, 0)] * 3 + [(0, -fractions.shape[3] % VECTOR_COLUMNS)]
        )
        self._compact_charge: tuple[SparseLight, Array32] = light, light.compact_charge_e(shape)

    def forget(self) -> None:
        self._stored[:] = 0.0
        self._coarse_stored[:] = 0.0

    def expose(
        self, frame: int, lights: Sequence[SparseLight], brightness: float, run_in_bands: RunInBands
    ) -> Array32:
        coarse, factor, size = [], np.float32(brightness), self.shown.shape[2:]
        for number, light in enumerate(lights):
            if light is not self._compact_charge[0]:
                self._compact_charge = light, light.compact_charge_e(size)
            expected = self._compact_charge[1] * factor
            pulses = self._draw_pulses(light, frame * self._fields + number, factor)
            arguments = (
                (number, self._fields, light.kernel.half_width_px),
                pulses,
                self._padded_fractions,
                (expected, self._stored_fraction),
                self._kept_fraction,
            )
            run_in_bands(
                lambda first, last, arguments=arguments, shown=self.shown[number, 0]: pulse_rows(
                    first, last, *arguments, self._stored, shown
                ),
                size[0],
                1,
            )
            coarse.append(self._on_coarse_cells(light, pulses, factor))
        return np.stack(coarse)

    def _draw_pulses(self, light: SparseLight, exposure: int, factor: np.float32) -> Pulses:
        rng = np.random.default_rng([self._seed, PULSES, exposure + 2**32])
        number, ions = rng.poisson(light.cumulative_pe[-1]), rng.poisson(light.ions_per_field)
        # Uniform numbers in order, so that memory is walked through once: running sums of
        # exponential ones, over the last.
        cumulative = np.cumsum(rng.standard_exponential(number + 1))
        cells = find_cells(
            cumulative[:-1] * (light.cumulative_pe[-1] / cumulative[-1]),
            light.cumulative_pe,
            light.guide,
        )
        cells = np.concatenate([cells, rng.integers(light.gain.size, size=ions)])
        heights = [
            rng.standard_gamma(light.shape, size=number),
            rng.standard_gamma(rng.poisson(light.ion_size, size=ions) * light.shape),
        ]
        charge = np.concatenate(heights) / light.shape * light.gain.ravel()[cells] * factor
        rows, columns = np.divmod(cells, light.gain.shape[1])
        offset = rng.integers(POSITIONS, size=(2, len(cells)))
        remainder = self._decay.remainder(rng.random(len(cells), np.float32))
        stored_charge = charge * remainder[self._decay.lasting].astype(np.float32)
        return (
            (POSITIONS * rows + offset[0]).astype(np.int32),
            (POSITIONS * columns + offset[1]).astype(np.int32),
            charge.astype(np.float32),
            stored_charge.astype(np.float32),
        )

    def _on_coarse_cells(self, light: SparseLight, pulses: Pulses, factor: np.float32) -> Array32:
        """Light of an exposure beyond the mean, summed over coarse cells."""
        side = FINEST * COARSE
        sums = coarse_sums(*pulses, side, *light.coarse_e.shape)
        shown = sums[0] - factor * (np.float32(1.0) - self._stored_fraction.sum()) * light.coarse_e
        for stored, stored_fraction, kept_fraction, increase in zip(
            self._coarse_stored, self._stored_fraction, self._kept_fraction, sums[1:], strict=True
        ):
            shown += (np.float32(1.0) - kept_fraction) * stored
            stored *= kept_fraction
            stored += increase - factor * stored_fraction * light.coarse_e
        return shown
