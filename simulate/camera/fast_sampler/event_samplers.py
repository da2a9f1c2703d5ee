"""Pulses of one exposure behind the gain: many summed in cells, or single ones (`single_pulses`).

A light is prepared once for every scene; a screen is the phosphor from one exposure to the next.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulate.arrays import Array32
from simulate.camera.chain import Chain, Slot
from simulate.camera.fast_sampler.cell_planes import (
    CELLS,
    cell_gain,
    cut_to_frame,
    gather_planes,
)
from simulate.camera.fast_sampler.charge_distribution import normal_law, pulse_law
from simulate.camera.fast_sampler.kernel import (
    COARSE,
    Kernel,
    noise_kernel,
)
from simulate.camera.fast_sampler.phosphor_rows import (
    glow_rows,
)
from simulate.camera.fast_sampler.single_pulses import RunInBands, SparseLight
from simulate.camera.grid import ACCURACY, Grid, irfft_image, rfft_image
from simulate.camera.phosphor import PhosphorDecay
from simulate.camera.random_numbers import key_of
from simulate.camera.stage_image import StageImage
from simulate.camera.transfer import StageBlur

# Purpose of a random generator; pulses are drawn by plane.
ION = 60


@dataclass(frozen=True, kw_only=True)
class Exposure:
    """One exposure of a scene: how its pulses are drawn, and the mean charge that its light brings,
    e-, (row, col).
    """

    light: "DenseLight | SparseLight"
    light_e: Array32


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
    expected: Array32
    inverse: Array32
    rows: NDArray[np.uint16]
    gain: Array32  # CCD electrons per mean pulse of every cell, shape (plane, row, col)
    # Gamma shape of pulses, and the rows of their law, flat.
    shape: float
    quantiles: Array32
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
            gather_planes(_sharpen(at_mcp.values, kernel), kernel.divisions),
            0.0,
            ACCURACY.max_pe_per_cell,
        )
        expected = cut_to_frame(light, grid) * mcp.detection_probability
        gain = cut_to_frame(cell_gain(chain, at_mcp, kernel.divisions), grid)
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
        self, frame: int, lights: Sequence[DenseLight], brightness: float, run_in_bands: RunInBands
    ) -> Array32:
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
        is_uniform = all(light is lights[0] for light in lights)
        groups = (
            [slice(0, self._fields)]
            if is_uniform
            else [slice(n, n + 1) for n in range(self._fields)]
        )
        for group in groups:
            light = lights[group.start]
            per_cell = light.ions_per_field * light.ion_size / light.gain.size
            law = light.quantiles, *np.array([light.shape, self._lateness, per_cell], np.float32)
            factors = np.full(group.stop - group.start, brightness, np.float32)
            event_ions = ions[0] - group.start, *ions[1:]

            def work(
                first: int,
                last: int,
                light=light,
                group=group,
                law=law,
                factors=factors,
                event_ions=event_ions,
            ) -> None:
                for plane in range(planes):
                    exposures = self._keys(plane, frame)[group], factors
                    cells = (
                        light.expected[plane],
                        light.inverse[plane],
                        light.rows[plane],
                        light.gain[plane],
                    )
                    phosphor = self._decay, self._stored[plane], self.shown[group], coarse[group]
                    glow_rows(
                        first,
                        last,
                        plane,
                        exposures,
                        cells,
                        law,
                        event_ions if plane == 0 else _NO_IONS,
                        *phosphor,
                    )

            run_in_bands(work, rows * COARSE, COARSE)
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


Ions = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], Array32]
_NO_IONS: Ions = (
    np.empty(0, np.int64),
    np.empty(0, np.int64),
    np.empty(0, np.int64),
    np.empty(0, np.float32),
)


def _sharpen(light: NDArray[np.floating], kernel: Kernel) -> NDArray[np.float64]:
    """Light on cells, two a pixel both ways, through the kernel's filter on its own lattice."""
    per_row, per_column = kernel.divisions
    rows, cols = light.shape[0] // 2, light.shape[1] // 2
    lattice = light.reshape(rows * per_row, 2 // per_row, cols * per_column, 2 // per_column).sum(
        axis=(1, 3), dtype=np.float64
    )
    # The filter, origin first, on a lattice of another shape; what lies outside it is
    # folded back.
    filter_image, shape = np.zeros(lattice.shape), kernel.sharpening.shape
    indices = [
        np.fft.fftfreq(n, 1.0 / n).astype(int) % m
        for n, m in zip(shape, lattice.shape, strict=True)
    ]
    np.add.at(filter_image, np.ix_(*indices), kernel.sharpening)
    sharpened: Any = irfft_image(rfft_image(lattice) * rfft_image(filter_image), lattice.shape) / (
        2 // per_row * (2 // per_column)
    )
    return sharpened.repeat(2 // per_row, axis=0).repeat(2 // per_column, axis=1)
