"""Pulses of one exposure behind the gain: many summed in cells, or each with its own position and
arrival time.

A light is prepared once for every scene; a screen is the phosphor from one exposure to the next.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulate.camera.chain import Chain, Slot
from simulate.camera.fast_sampler.charge_distribution import normal_law, pulse_law
from simulate.camera.fast_sampler.kernel import (
    COARSE,
    FINEST,
    REACH,
    Kernel,
    PulseKernel,
    noise_kernel,
    pulse_kernel,
)
from simulate.camera.fast_sampler.phosphor_rows import (
    ADDED_AT_ONCE,
    cells_beyond,
    coarse_sums,
    glow_rows,
    pulse_rows,
)
from simulate.camera.grid import ACCURACY, Grid, irfft_image, rfft_image
from simulate.camera.phosphor import PhosphorDecay
from simulate.camera.random_numbers import key_of
from simulate.camera.stage_image import StageImage
from simulate.camera.transfer import StageBlur

Array = NDArray[np.float32]
# Does work on rows in bands of whole blocks: (work of first and last row, rows, rows in a block).
Shared = Callable[[Callable[[int, int], None], int, int], None]
# What a generator is for, the planes of cells besides.
PULSES, ION = 59, 60
# Cells to a pixel pitch, and places to a cell, both ways.
CELLS, PLACES = 2, FINEST // 2


@dataclass(frozen=True, kw_only=True)
class Exposure:
    """One exposure of a scene: how its pulses are drawn, and the mean charge that its light brings,
    e-, (row, col).
    """

    light: "DenseLight | SparseLight"
    light_e: Array


def prepare_exposure(chain: Chain, at_mcp: StageImage, fields: int, *, sparse: bool) -> Exposure:
    """Return an exposure prepared for the frame generator, of photoelectrons at the MCP input per
    cell.

    The MCP of the chain is under the load of this light; a frame has so many fields, whose pixels
    are as many rows of the chip high; sparse light is drawn pulse by pulse.
    """
    grid = at_mcp.grid
    if grid is None or (grid.per_column, grid.per_row) != (CELLS, CELLS):
        raise ValueError("a scene is made ready from two cells per column and row")
    screen = chain.between(Slot.MCP, Slot.TAPER).mean(at_mcp)
    mean = chain[Slot.CCD].mean_charge(chain[Slot.PIXELS].mean(screen).values)
    kind = SparseLight if sparse else DenseLight
    return Exposure(
        light=kind.of(chain, at_mcp, grid, screen.pending_blurs, fields),
        light_e=np.ascontiguousarray(mean, np.float32),
    )


@dataclass(frozen=True, kw_only=True)
class DenseLight:
    """Pulses summed in cells."""

    # Mean number of detected photoelectrons of every cell, the inverse of the probability of any,
    # and the row of the law, shape (plane, row, col).
    expected: Array
    inverse: Array
    rows: NDArray[np.uint16]
    gain: Array  # CCD electrons per mean pulse of every cell, shape (plane, row, col)
    # Gamma shape of pulses, and the rows of their law, flat.
    shape: float
    quantiles: Array
    # Ion events on all cells in one exposure, and their mean number of pulses.
    ions_per_field: float
    ion_size: float
    kernel: Kernel  # spread of the noise; the first cell lies under the kernel of the first pixel

    @classmethod
    def of(
        cls, chain: Chain, at_mcp: StageImage, grid: Grid, blurs: tuple[StageBlur, ...], fields: int
    ) -> "DenseLight":
        """Return the light of many pulses behind the blurs that it still owes."""
        mcp = chain[Slot.MCP]
        kernel = noise_kernel(
            blurs, grid.one_pixel(), fields, chain[Slot.VIDEO].taps, ACCURACY.skewness_tolerance
        )
        light = np.clip(
            _planes(_sharpen(at_mcp.values, kernel), kernel.divisions),
            0.0,
            ACCURACY.max_pe_per_cell,
        )
        expected = _cut(light, grid) * mcp.detection_probability
        gain = _cut(_gain(chain, at_mcp, kernel.divisions), grid)
        law = (
            normal_law(expected) if mcp.normal_law else pulse_law(mcp.pulse_height_shape, expected)
        )
        # One block of memory for what is read together, large enough for large pages.
        cells = np.stack([expected, law.inverse, gain]).astype(np.float32)
        return cls(
            expected=cells[0],
            inverse=cells[1],
            rows=law.rows,
            gain=cells[2],
            shape=mcp.pulse_height_shape,
            quantiles=law.quantiles,
            ions_per_field=mcp.ions_per_cell(at_mcp) * CELLS**2 * expected[0].size,
            ion_size=mcp.ion_event_size_pe,
            kernel=kernel,
        )

    def screen(
        self, decay: PhosphorDecay, fields: int, seed: int, _shape: tuple[int, ...]
    ) -> "DenseScreen":
        """Return the phosphor in its initial state."""
        return DenseScreen(self, decay, fields, seed)


class DenseScreen:
    """Phosphor on cells from one exposure to the next, for any light of the scene and so many
    fields in a frame.
    """

    def __init__(self, light: DenseLight, decay: PhosphorDecay, fields: int, seed: int) -> None:
        self._decay, self._lateness, self._fields, self._seed = (
            decay.recursion,
            decay.lateness,
            fields,
            seed,
        )
        planes, rows, cols = light.gain.shape
        components = self._decay.shape[1]
        # One block of memory for what is worked on together, large enough for large pages.
        block = np.zeros((planes * (components + fields), rows, cols), np.float32)
        self._stored = block[: planes * components].reshape(planes, components, rows, cols)
        # Electrons beyond the mean that come out in each exposure, shape (exposure, plane, row,
        # col).
        self.shown = block[planes * components :].reshape(fields, planes, rows, cols)
        self.spread = light.kernel.down, light.kernel.along
        self.kernel = light.kernel

    def forget(self) -> None:
        """Reset the stored light to its mean."""
        self._stored[:] = 0.0

    def expose(
        self, frame: int, lights: Sequence[DenseLight], brightness: float, shared: Shared
    ) -> Array:
        """Draw the pulses of a frame's exposures, `brightness` times the mean light, and apply
        phosphor decay.

        Returns what each exposure shows beyond the mean, summed over coarse cells, (exposure,
        coarse row, coarse col).
        """
        planes, height, width = lights[0].gain.shape
        rows, cols = height // COARSE, width // COARSE
        coarse = np.empty((self._fields, planes, rows, cols), np.float32)
        ions = self._ions(lights[0], frame)
        # Exposures of one light are drawn in one pass.
        alike = all(light is lights[0] for light in lights)
        groups = (
            [slice(0, self._fields)] if alike else [slice(n, n + 1) for n in range(self._fields)]
        )
        for group in groups:
            light = lights[group.start]
            per_cell = light.ions_per_field * light.ion_size / light.gain.size
            law = light.quantiles, *np.array([light.shape, self._lateness, per_cell], np.float32)
            factors = np.full(group.stop - group.start, brightness, np.float32)
            fallen = ions[0] - group.start, *ions[1:]

            def work(
                first: int,
                last: int,
                light=light,
                group=group,
                law=law,
                factors=factors,
                fallen=fallen,
            ) -> None:
                for plane in range(planes):
                    exposures = self._keys(plane, frame)[group], factors
                    cells = (
                        light.expected[plane],
                        light.inverse[plane],
                        light.rows[plane],
                        light.gain[plane],
                    )
                    screen = self._decay, self._stored[plane], self.shown[group], coarse[group]
                    glow_rows(
                        first,
                        last,
                        plane,
                        exposures,
                        cells,
                        law,
                        fallen if plane == 0 else _NO_IONS,
                        *screen,
                    )

            shared(work, rows * COARSE, COARSE)
        return coarse.sum(axis=1)

    def _ions(self, light: DenseLight, frame: int) -> "Ions":
        """Exposures, rows, columns and pulses of the ion events of a frame."""
        if light.ions_per_field == 0.0:
            return _NO_IONS
        rng = np.random.default_rng([self._seed, ION, frame + 2**32])
        number = rng.poisson(light.ions_per_field * self._fields)
        pulses = rng.gamma(rng.poisson(light.ion_size, size=number) * light.shape) / light.shape
        exposures, rows, cols = (
            rng.integers(n, size=number) for n in (self._fields, *light.gain.shape[1:])
        )
        return exposures, rows, cols, pulses.astype(np.float32)

    def _keys(self, plane: int, frame: int) -> NDArray[np.uint64]:
        return np.array(
            [key_of(self._seed, plane, frame * self._fields + n) for n in range(self._fields)],
            np.uint64,
        )


Ions = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], Array]
_NO_IONS: Ions = (
    np.empty(0, np.int64),
    np.empty(0, np.int64),
    np.empty(0, np.int64),
    np.empty(0, np.float32),
)


@dataclass(frozen=True, kw_only=True)
class SparseLight:
    """Pulses that fall anywhere in their cells, two cells to a pixel both ways."""

    # Mean number of detected photoelectrons of every cell in one exposure, shape (row, col); the
    # first cell lies under the kernel of the first pixel.
    expected: Array
    gain: Array  # CCD electrons per mean pulse of every cell, shape (row, col)
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
            _cut(np.maximum(_planes(at_mcp.values, divisions), 0.0), grid)
            * mcp.detection_probability
        )
        gain = _interleave_planes(_cut(_gain(chain, at_mcp, divisions), grid))
        return cls(
            expected=_interleave_planes(expected).astype(np.float32),
            gain=gain.astype(np.float32),
            shape=mcp.pulse_height_shape,
            ions_per_field=mcp.ions_per_cell(at_mcp) * gain.size,
            ion_size=mcp.ion_event_size_pe,
            kernel=pulse_kernel(blurs, grid.one_pixel(), fields),
        )

    @cached_property
    def running(self) -> NDArray[np.float64]:
        """Photoelectrons expected in all cells up to each, shape (cell,)."""
        return np.cumsum(self.expected, dtype=np.float64)

    @cached_property
    def guide(self) -> NDArray[np.int32]:
        """First cell beyond each of evenly spaced parts of the expected photoelectrons, shape
        (part,).
        """
        parts = np.arange(ACCURACY.n_search_guides) * (self.running[-1] / ACCURACY.n_search_guides)
        return np.searchsorted(self.running, parts, side="right").astype(np.int32)

    @cached_property
    def charge_e(self) -> Array:
        """Mean charge that pulses bring to cells, e-, shape (row, col)."""
        ions = np.float32(self.ions_per_field * self.ion_size / self.gain.size)
        return np.asarray(self.gain * (self.expected + ions), np.float32)

    def near_e(self, size: tuple[int, ...]) -> Array:
        """Return the mean charge that pulses bring to so many pixels by the compact kernel, e-,
        shape (row, col).
        """
        from scipy import fft

        forward: Any = fft.rfft2
        back: Any = fft.irfft2
        shares = self.kernel.shares
        taps, breadth = shares.shape[2:]
        # Pulses are even over a cell: its kernel is the mean of its places'.
        cells = shares.reshape(CELLS, PLACES, CELLS, PLACES, taps, breadth).mean(axis=(1, 3))
        length = [
            n // CELLS + m - 1 for n, m in zip(self.charge_e.shape, (taps, breadth), strict=True)
        ]
        fast = [fft.next_fast_len(n, real=True) for n in length]
        parts = [
            back(
                forward(self.charge_e[i::CELLS, j::CELLS], fast) * forward(cells[i, j], fast), fast
            )
            for i in range(CELLS)
            for j in range(CELLS)
        ]
        further = REACH - self.kernel.reach
        whole = np.sum(parts, axis=0)[
            taps - 1 + further : length[0], breadth - 1 + further : length[1]
        ]
        return np.ascontiguousarray(whole[: size[0], : size[1]], np.float32)

    @cached_property
    def coarse_e(self) -> Array:
        """Mean charge that pulses bring to coarse cells, e-, shape (coarse row, coarse col)."""
        side = CELLS * COARSE
        rows, cols = (n // side for n in self.charge_e.shape)
        return self.charge_e.reshape(rows, side, cols, side).sum(axis=(1, 3))

    def screen(
        self, decay: PhosphorDecay, fields: int, seed: int, shape: tuple[int, ...]
    ) -> "SparseScreen":
        """Return the phosphor in its initial state."""
        return SparseScreen(self, decay, fields, seed, shape)


@dataclass(frozen=True, kw_only=True)
class _Pulses:
    """Places of pulses in fractions of a pixel, their electrons, and those of them that come
    later.
    """

    rows: NDArray[np.int32]
    columns: NDArray[np.int32]
    charge: Array
    later: Array


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
        self._stays, _, self._kept = decay.recursion
        self._stored = np.zeros((len(self._stays), *shape), np.float32)
        self._coarse_stored = np.zeros((len(self._stays), *light.coarse_e.shape), np.float32)
        self.shown = np.zeros((fields, 1, *shape), np.float32)
        # Pulses are laid on pixels at once.
        self.spread = np.ones((1, 1, 1), np.float32), np.ones((1, 1, 1), np.float32)
        self.kernel, shares = light.kernel, light.kernel.shares
        # The kernel's fractions, padded to a multiple of the columns added at once.
        self._lines = np.pad(shares, [(0, 0)] * 3 + [(0, -shares.shape[3] % ADDED_AT_ONCE)])
        self._near_e: tuple[SparseLight, Array] = light, light.near_e(shape)

    def forget(self) -> None:
        """Reset the stored light to its mean."""
        self._stored[:] = 0.0
        self._coarse_stored[:] = 0.0

    def expose(
        self, frame: int, lights: Sequence[SparseLight], brightness: float, shared: Shared
    ) -> Array:
        """Draw the pulses of a frame's exposures and apply phosphor decay; see
        `DenseScreen.expose`.
        """
        coarse, factor, size = [], np.float32(brightness), self.shown.shape[2:]
        for number, light in enumerate(lights):
            if light is not self._near_e[0]:
                self._near_e = light, light.near_e(size)
            near = self._near_e[1] * factor
            pulses = self._draw_pulses(light, frame * self._fields + number, factor)
            places, shown = (
                (pulses.rows, pulses.columns, pulses.charge, pulses.later),
                self.shown[number, 0],
            )
            given = (
                (number, self._fields, light.kernel.reach),
                places,
                self._lines,
                (near, self._stays),
                self._kept,
            )
            shared(lambda a, b, g=given, s=shown: pulse_rows(a, b, *g, self._stored, s), size[0], 1)
            coarse.append(self._on_coarse_cells(light, pulses, factor))
        return np.stack(coarse)

    def _draw_pulses(self, light: SparseLight, exposure: int, factor: np.float32) -> _Pulses:
        rng = np.random.default_rng([self._seed, PULSES, exposure + 2**32])
        number, ions = rng.poisson(light.running[-1]), rng.poisson(light.ions_per_field)
        # Even numbers in order, so that memory is walked through once: running sums of exponential
        # ones, over the last.
        running = np.cumsum(rng.standard_exponential(number + 1))
        cells = cells_beyond(
            running[:-1] * (light.running[-1] / running[-1]), light.running, light.guide
        )
        cells = np.concatenate([cells, rng.integers(light.gain.size, size=ions)])
        heights = [
            rng.standard_gamma(light.shape, size=number),
            rng.standard_gamma(rng.poisson(light.ion_size, size=ions) * light.shape),
        ]
        charge = np.concatenate(heights) / light.shape * light.gain.ravel()[cells] * factor
        rows, columns = np.divmod(cells, light.gain.shape[1])
        within = rng.integers(PLACES, size=(2, len(cells)))
        later = charge * self._decay.remainder_of_lasting(rng.random(len(cells), np.float32))
        return _Pulses(
            rows=(PLACES * rows + within[0]).astype(np.int32),
            columns=(PLACES * columns + within[1]).astype(np.int32),
            charge=charge.astype(np.float32),
            later=later.astype(np.float32),
        )

    def _on_coarse_cells(self, light: SparseLight, pulses: _Pulses, factor: np.float32) -> Array:
        """Light of an exposure beyond the mean, summed over coarse cells."""
        side = FINEST * COARSE
        sums = coarse_sums(
            pulses.rows, pulses.columns, pulses.charge, pulses.later, side, *light.coarse_e.shape
        )
        shown = sums[0] - factor * (np.float32(1.0) - self._stays.sum()) * light.coarse_e
        for one, stays, kept, later in zip(
            self._coarse_stored, self._stays, self._kept, sums[1:], strict=True
        ):
            shown += (np.float32(1.0) - kept) * one
            one *= kept
            one += later - factor * stays * light.coarse_e
        return shown


def _gain(chain: Chain, at_mcp: StageImage, divisions: tuple[int, int]) -> NDArray[np.float64]:
    """CCD electrons for each detected photoelectron, in planes of cells; where nothing falls, as on
    average.
    """
    mcp = chain[Slot.MCP]
    quiet = chain.between(Slot.MCP, Slot.TAPER).replacing(replace(mcp, ion_events_per_s_cm2=0.0))
    out, into = _planes(quiet.mean(at_mcp).values, divisions), _planes(at_mcp.values, divisions)
    average = out.sum() / into.sum() if into.sum() > 0.0 else 0.0
    known = into > 1e-9 * max(float(into.max()), 1e-300)
    each = np.divide(out, into, out=np.full(out.shape, average), where=known)
    return each * chain[Slot.CCD].quantum_efficiency / mcp.detection_probability


def _sharpen(light: NDArray[np.floating], kernel: Kernel) -> NDArray[np.float64]:
    """Light on cells, two a pixel both ways, through the kernel's filter on its own lattice."""
    down, along = kernel.divisions
    rows, cols = light.shape[0] // 2, light.shape[1] // 2
    lattice = light.reshape(rows * down, 2 // down, cols * along, 2 // along).sum(
        axis=(1, 3), dtype=np.float64
    )
    # The filter, origin first, on a lattice of another shape; what reaches beyond it is folded
    # back.
    whole, shape = np.zeros(lattice.shape), kernel.sharpening.shape
    places = [
        np.fft.fftfreq(n, 1.0 / n).astype(int) % m
        for n, m in zip(shape, lattice.shape, strict=True)
    ]
    np.add.at(whole, np.ix_(*places), kernel.sharpening)
    sharp: Any = irfft_image(rfft_image(lattice) * rfft_image(whole), lattice.shape) / (
        2 // down * (2 // along)
    )
    return sharp.repeat(2 // down, axis=0).repeat(2 // along, axis=1)


def _planes(values: NDArray[np.floating], divisions: tuple[int, int]) -> NDArray[np.float64]:
    """Gather cells, two a pixel both ways, into planes of so many cells a row and a column, shape
    (plane, row, col).
    """
    down, along = divisions
    rows, cols = values.shape[0] // 2, values.shape[1] // 2
    cells = values.reshape(rows, down, 2 // down, cols, along, 2 // along).sum(
        axis=(2, 5), dtype=np.float64
    )
    return cells.transpose(1, 3, 0, 2).reshape(down * along, rows, cols)


def _interleave_planes(planes: NDArray) -> NDArray:
    """Planes of cells, two a pixel both ways, as one image of them."""
    _, rows, cols = planes.shape
    return planes.reshape(2, 2, rows, cols).transpose(2, 0, 3, 1).reshape(2 * rows, 2 * cols)


def _cut(planes: NDArray, grid: Grid) -> NDArray:
    """Cells under the kernels of the frame's pixels, filled up with empty ones to whole coarse
    cells.
    """
    top, left = grid.margin_rows - REACH, grid.margin_columns - REACH
    cut = planes[:, top : top + grid.rows + 2 * REACH, left : left + grid.columns + 2 * REACH]
    missing = [(-n) % COARSE for n in cut.shape[1:]]
    return np.pad(cut, ((0, 0), (0, missing[0]), (0, missing[1])))
