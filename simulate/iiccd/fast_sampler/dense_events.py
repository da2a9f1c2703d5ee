"""Dense events: the charge of each cell from its distribution, with phosphor decay on cells."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulate.iiccd.fast_sampler.frame_generator import Shared, float32_values, key_of
from simulate.iiccd.fast_sampler.kernel import COARSE, Kernel

# What a generator is for, the planes of cells besides.
ION = 60


@dataclass(frozen=True, kw_only=True)
class DenseEventSampler:
    """Pulses summed in cells.

    Parameters
    ----------
    expected, inverse, rows
        Mean number of detected photoelectrons of every cell, the inverse of the probability of any, and the row of the
        law, shape (plane, row, col).
    gain
        CCD electrons per mean pulse of every cell, shape (plane, row, col).
    shape, quantiles
        Gamma shape of pulses, and the rows of their law, flat.
    ions_per_field, ion_size
        Ion events on all cells in one exposure, and their mean number of pulses.
    kernel
        Spread of the noise; the first cell lies under the kernel of the first pixel.
    decay
        Mean fraction stored, its standard deviation, and fraction kept, of each component of the phosphor's decay,
        shape (3, component).
    lateness
        Skewness of what pulses leave to later exposures, over their times of arrival, dimensionless.
    fields
        Exposures in a frame.
    """

    expected: NDArray[np.float32]
    inverse: NDArray[np.float32]
    rows: NDArray[np.uint16]
    gain: NDArray[np.float32]
    shape: float
    quantiles: NDArray[np.float32]
    ions_per_field: float
    ion_size: float
    kernel: Kernel
    decay: NDArray[np.float32]
    lateness: float
    fields: int

    @property
    def pulse_e(self) -> float:
        """Variance of a pixel's charge over its mean, from pulses alone, e-."""
        kernel = self.kernel
        squares = float(np.einsum("prj,prk,psj,psk->", kernel.down, kernel.along, kernel.down, kernel.along))
        return float(self.gain.mean()) * (1.0 + 1.0 / self.shape) * squares / (kernel.height * len(kernel.down))

    def phosphor_sampler(self, seed: int) -> "DensePhosphorSampler":
        """Return the phosphor in its initial state."""
        return DensePhosphorSampler(self, seed)


class DensePhosphorSampler:
    """Phosphor on cells from one exposure to the next."""

    def __init__(self, light: DenseEventSampler, seed: int) -> None:
        self._light, self._seed = light, seed
        planes, rows, cols = light.gain.shape
        components = light.decay.shape[1]
        # One block of memory for what is worked on together, large enough for large pages.
        block = np.zeros((planes * (components + light.fields), rows, cols), np.float32)
        self._stored = block[: planes * components].reshape(planes, components, rows, cols)
        self.shown = block[planes * components :].reshape(light.fields, planes, rows, cols)
        self.spread = light.kernel.down, light.kernel.along
        self.far = light.kernel

    def forget(self) -> None:
        """Reset the stored light to its mean."""
        self._stored[:] = 0.0

    def expose(self, frame: int, brightness: float, shared: Shared) -> NDArray[np.float32]:
        """Draw the pulses of a frame's exposures and apply phosphor decay; see `PhosphorSampler`."""
        from simulate.iiccd.fast_sampler.phosphor_rows import glow_rows

        light, planes = self._light, len(self._light.gain)
        rows, cols = light.gain.shape[1] // COARSE, light.gain.shape[2] // COARSE
        coarse = np.empty((light.fields, planes, rows, cols), np.float32)
        per_cell = light.ions_per_field * light.ion_size / light.gain.size
        law = light.quantiles, *float32_values(light.shape, light.lateness, per_cell)
        factors, ions = np.full(light.fields, brightness, np.float32), self._ions(frame)

        def work(first: int, last: int) -> None:
            for plane in range(planes):
                exposures = self._keys(plane, frame), factors
                cells = light.expected[plane], light.inverse[plane], light.rows[plane], light.gain[plane]
                screen = light.decay, self._stored[plane], self.shown, coarse
                glow_rows(first, last, plane, exposures, cells, law, ions if plane == 0 else _NO_IONS, *screen)

        shared(work, rows * COARSE, COARSE)
        return coarse.sum(axis=1)

    def _ions(self, frame: int) -> "Ions":
        """Exposures, rows, columns and pulses of the ion events of a frame."""
        light = self._light
        if light.ions_per_field == 0.0:
            return _NO_IONS
        rng = np.random.default_rng([self._seed, ION, frame + 2**32])
        number = rng.poisson(light.ions_per_field * light.fields)
        places = (rng.integers(n, size=number) for n in (light.fields, *light.gain.shape[1:]))
        pulses = rng.gamma(rng.poisson(light.ion_size, size=number) * light.shape) / light.shape
        exposures, rows, cols = places
        return exposures, rows, cols, pulses.astype(np.float32)

    def _keys(self, plane: int, frame: int) -> NDArray[np.uint64]:
        fields = self._light.fields
        return np.array([key_of(self._seed, plane, frame * fields + n) for n in range(fields)], np.uint64)


Ions = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]
_NO_IONS: Ions = (np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0, np.float32))
