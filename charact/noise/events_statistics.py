"""The empirical characteristic functions of filtered dark frames, with their covariance from blocks."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.noise.events_filters import Filter
from charact.noise.events_law import Observed, both

Array = NDArray[np.float64]

# Frequencies of each characteristic function.
# Bins of one size up to so many of them from zero, in proportion beyond.
FINE, FREQUENCIES = 80.0, 6
# Side of the blocks whose scatter gives the covariance, px.
BLOCK_PX = 24
# The range of frequencies: lowest times the brightest thousandth, highest times the noise.
LOWEST, HIGHEST = 0.5, 1.3


@dataclass(frozen=True, kw_only=True)
class Scale:
    """How a filter's output spreads.

    Parameters
    ----------
    noise_dn
        Its standard deviation where there is no pulse, from the middle half of the values.
    bright_dn
        Mean of its brightest thousandth.
    """

    noise_dn: float
    bright_dn: float

    @property
    def frequency(self) -> Array:
        """Frequencies at which the law is looked at, shape (t,), 1/DN."""
        high = HIGHEST / self.noise_dn
        low = min(LOWEST / max(self.bright_dn, 1e-12), 0.25 * high)
        return np.geomspace(low, high, FREQUENCIES)


def scale_of(values: NDArray[np.float32]) -> Scale:
    """Return the scale of a filter's output."""
    sample = np.sort(values.ravel()[:: max(1, values.size // 400_000)])
    low, high = np.interp([0.25, 0.5], np.linspace(0, 1, len(sample)), sample)
    top = sample[-max(len(sample) // 1000, 1) :]
    return Scale(noise_dn=max(float(high - low) / 0.6745, 1e-9), bright_dn=float(top.mean()))


@dataclass
class Gathered:
    """Sums over blocks, gathered run by run.

    Parameters
    ----------
    filters
        Filters.
    scales
        The spread of each one's output.
    depth
        Exposures of a block.
    """

    filters: tuple[Filter, ...]
    scales: tuple[Scale, ...]
    depth: int

    def __post_init__(self) -> None:
        self._sums: list[NDArray[np.complex128]] = []
        self._levels: list[Array] = []
        self._counts: list[Array] = []

    def add(self, change: NDArray[np.float32], usable: NDArray[np.bool_]) -> None:
        """Add the exposures of the same rows of a run.

        Parameters
        ----------
        change
            What changes in time, shape (exposure, row, col), DN.
        usable
            Pixels that count, same shape.
        """
        inner = inside(change.shape, self.filters)
        good = usable[inner]
        block, blocks = _blocks(good.shape, self.depth)
        pairs = [
            _block_functions(cropped(one, change, self.filters), good, block, blocks, scale)
            for one, scale in zip(self.filters, self.scales, strict=True)
        ]
        self._sums.append(np.stack([total for total, _, _ in pairs], axis=1))
        self._levels.append(np.stack([level for _, level, _ in pairs], axis=1))
        self._counts.append(pairs[0][2])

    def observed(self) -> Observed:
        """Return the logarithms of the characteristic functions with their covariance from the scatter of blocks.

        Filters add up to nothing, and so does their output but for the pulses that the border cuts: its mean is
        taken away, which turns the functions by t times it.
        """
        sums, count = np.concatenate(self._sums), np.concatenate(self._counts)
        levels, frequency = np.concatenate(self._levels), np.stack([scale.frequency for scale in self.scales])
        mean, level = sums.sum(axis=0) / count.sum(), levels.sum(axis=0) / count.sum()
        off = (sums - count[:, None, None] * mean) / mean
        off = (off - 1j * (levels - count[:, None] * level)[..., None] * frequency) / count.sum()
        parts = np.concatenate([off.real.reshape(len(off), -1), off.imag.reshape(len(off), -1)], axis=1)
        value = np.log(mean * np.exp(-1j * level[:, None] * frequency))
        return Observed(
            filters=self.filters,
            frequency=frequency,
            value=both(value),
            covariance=parts.T @ parts,
            pixels=float(count.sum()),
        )


def inside(shape: tuple[int, ...], filters: tuple[Filter, ...]) -> tuple[slice, slice, slice]:
    """Return the part of the exposures that every filter reaches in full."""
    rows = max(len(one.rows) for one in filters) // 2
    cols = max(len(one.columns) for one in filters) // 2
    late = max(len(one.times) for one in filters) - 1
    return slice(0, shape[0] - late), slice(rows, shape[1] - rows), slice(cols, shape[2] - cols)


def cropped(one: Filter, change: NDArray[np.float32], filters: tuple[Filter, ...]) -> NDArray[np.float32]:
    """Return what a filter makes of exposures, where every filter reaches in full."""
    whole = inside(change.shape, filters)
    own = inside(change.shape, (one,))
    return one.of(change)[tuple(
        slice((a.start or 0) - (b.start or 0), a.stop - (b.start or 0)) for a, b in zip(whole, own, strict=True)
    )]  # fmt: skip


def _block_functions(values: NDArray[np.float32], usable: NDArray[np.bool_], block: NDArray[np.int64], blocks: int,
                     scale: Scale) -> tuple[NDArray[np.complex128], Array, Array]:  # fmt: skip
    """Sums of exp(i t y) over blocks, shape (block, t), sums of y and how many there are, both (block,)."""
    step = 0.05 / scale.frequency[-1]
    index = np.rint(np.arcsinh(values / (FINE * step)) * FINE).astype(np.int64)
    low = int(index.min())
    bins = int(index.max()) - low + 1
    centre = FINE * step * np.sinh((np.arange(bins) + low) / FINE)
    flat = (block * bins + (index - low))[usable]
    count = np.bincount(flat, minlength=blocks * bins).reshape(blocks, bins)
    waves = np.exp(1j * np.multiply.outer(centre, scale.frequency))
    number = count.astype(np.float64)
    return np.asarray(number @ waves, np.complex128), number @ centre, number.sum(axis=1)


def _blocks(shape: tuple[int, ...], depth: int) -> tuple[NDArray[np.int64], int]:
    """Number of the block of every value, and how many there are."""
    sizes = (depth, min(BLOCK_PX, shape[1]), min(BLOCK_PX, shape[2]))
    parts = [np.minimum(np.arange(n) // size, max(n // size, 1) - 1) for n, size in zip(shape, sizes, strict=True)]
    counts = [int(part[-1]) + 1 for part in parts]
    number = (parts[0][:, None, None] * counts[1] + parts[1][:, None]) * counts[2] + parts[2]
    return number, int(np.prod(counts))
