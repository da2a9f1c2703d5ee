"""Characteristic functions of filtered dark frames, with empirical and model covariance."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.noise.events.event_distribution import (
    CharacteristicFunctionData,
    PulsePopulation,
    pulse_outputs,
    real_and_imaginary,
)
from charact.noise.events.filters import Filter, common_reach
from charact.noise.thresholds import EVENT_ACCURACY

Array = NDArray[np.float64]
Images = NDArray[np.float32]


def observe(
    changes: tuple[Images, ...], usable: list[NDArray[np.bool_]], filters: tuple[Filter, ...]
) -> CharacteristicFunctionData:
    """Return ln of the characteristic functions of filtered frames, and their covariance from blocks.

    `changes`: fluctuations for each parity, shape (exposure, row, col), DN; `usable`: usable values, same shapes;
    `filters`: filters.

    Filter weights sum to zero, and so does their output except for pulses at the border: its mean is subtracted, which
    rotates the functions by t times it.
    """
    scales: list[Array] = []
    parts = [_sums(change, good, filters, scales) for change, good in zip(changes, usable, strict=True)]
    sums, levels, count = (np.concatenate([part[i] for part in parts]) for i in range(3))
    frequency = np.stack(scales)
    mean, level = sums.sum(axis=0) / count.sum(), levels.sum(axis=0) / count.sum()
    off = (sums - count[:, None, None] * mean) / mean
    off = (off - 1j * (levels - count[:, None] * level)[..., None] * frequency) / count.sum()
    scatter = np.concatenate([off.real.reshape(len(off), -1), off.imag.reshape(len(off), -1)], axis=1)
    return CharacteristicFunctionData(
        filters=filters,
        frequency=frequency,
        value=real_and_imaginary(np.log(mean * np.exp(-1j * level[:, None] * frequency))),
        covariance=scatter.T @ scatter,
        pixels=float(count.sum()),
    )


def _sums(change: Images, usable: NDArray[np.bool_], filters: tuple[Filter, ...], scales: list[Array]):
    """Return sums of exp(i t y) and of y over blocks, shapes (block, filter, t) and (block, filter), and their counts.

    The first parity also sets the frequencies of every filter.
    """
    reach = common_reach(filters)
    length = len(change) - max(len(one.times) for one in filters) + 1
    good = usable[:length, reach[0] : change.shape[1] - reach[0], reach[1] : change.shape[2] - reach[1]]
    blocks = _Blocks.of(good, EVENT_ACCURACY.block_exposures if any(len(one.times) > 1 for one in filters) else 1)
    still = {}
    out, known = [], len(scales) == len(filters)
    for index, one in enumerate(filters):
        key = one.high, one.broad
        if key not in still:
            still[key] = Filter(high=one.high, broad=one.broad).within(change, reach)
        values = one.through_time(still[key])[:length]
        if not known:
            scales.append(frequencies(values))
        out.append(blocks.sums(values, scales[index]))
    return np.stack([total for total, _ in out], axis=1), np.stack([y for _, y in out], axis=1), blocks.count


def frequencies(values: Images) -> Array:
    """Return the frequencies of the characteristic function of a filter's output, shape (t,), 1/DN."""
    sample = values.ravel()[:: max(1, values.size // EVENT_ACCURACY.sample)]
    places = (np.array([0.25, 0.5, 0.999]) * (len(sample) - 1)).astype(int)
    sample = np.partition(sample, places)
    low, middle = sample[places[:2]]
    # Noise without pulses, and mean of the brightest thousandth.
    noise, bright = max(float(middle - low) / 0.6745, 1e-9), float(sample[places[2] :].mean())
    high = EVENT_ACCURACY.highest_frequency / noise
    return np.geomspace(
        min(EVENT_ACCURACY.lowest_frequency / max(bright, 1e-12), 0.25 * high), high, EVENT_ACCURACY.frequencies
    )


@dataclass(frozen=True, kw_only=True)
class _Blocks:
    """Blocks of pixels and exposures: first bin of each exposure and pixel, usable values, values per block."""

    first: NDArray[np.int64]
    good: NDArray[np.bool_] | None
    count: Array

    @classmethod
    def of(cls, good: NDArray[np.bool_], least_depth: int) -> "_Blocks":
        high, wide = (
            np.minimum(np.arange(n) // EVENT_ACCURACY.block_px, max(n // EVENT_ACCURACY.block_px, 1) - 1)
            for n in good.shape[1:]
        )
        across = int(wide[-1]) + 1
        place = high[:, None] * across + wide
        images = int(place[-1, -1]) + 1
        depth = max(least_depth, -(-len(good) * images // EVENT_ACCURACY.max_blocks))
        time = np.arange(len(good)) // depth
        first = (time[:, None, None] * images + place) * EVENT_ACCURACY.bins
        chosen = None if good.all() else good
        inside = np.bincount((first if chosen is None else first[good]).ravel() // EVENT_ACCURACY.bins,
                             minlength=(int(time[-1]) + 1) * images)  # fmt: skip
        return cls(first=first, good=chosen, count=inside.astype(float))

    def sums(self, values: Images, frequency: Array) -> tuple[NDArray[np.complex128], Array]:
        """Return sums of exp(i t y) over blocks, shape (block, t), and of y, shape (block,)."""
        step, half = EVENT_ACCURACY.bin_width / frequency[-1], EVENT_ACCURACY.bins // 2
        place = values * np.float32(1.0 / step)
        place += np.float32(half + 0.5)
        # The first and the last bin are summed individually.
        np.clip(place, 0.0, EVENT_ACCURACY.bins - 0.5, out=place)
        index = place.astype(np.intp)
        far = (index == 0) | (index == EVENT_ACCURACY.bins - 1)
        index += self.first
        if self.good is not None:
            index, far = index[self.good], far & self.good
        count = np.bincount(index.ravel(), minlength=len(self.count) * EVENT_ACCURACY.bins).reshape(
            -1, EVENT_ACCURACY.bins
        )
        count[:, [0, -1]] = 0
        centre = step * (np.arange(EVENT_ACCURACY.bins) - half)
        # Averaging over a bin lowers a wave by sin(x)/x of half its phase.
        waves = np.exp(1j * np.multiply.outer(centre, frequency)) * np.sinc(0.5 * step * frequency / np.pi)
        number = count.astype(np.float64)
        total, level = np.asarray(number @ waves, np.complex128), number @ centre
        y, block = values[far].astype(np.float64), self.first[far] // EVENT_ACCURACY.bins
        np.add.at(total, block, np.exp(1j * np.multiply.outer(y, frequency)))
        np.add.at(level, block, y)
        return total, level


def scatter(pulses: PulsePopulation, observed: CharacteristicFunctionData) -> Array:
    """Return the covariance of the data for given pulses, shape (2 filter t, 2 filter t).

    The mean of exp(i t y) over N pixels, divided by its expectation, is 1 plus what each pulse of height h adds,
    c(h) = integral over positions of [exp(i t h a(x)) - 1], plus the noise. Pulses are Poisson distributed: their
    covariance is rate/N <c c'>. That of Gaussian noise of covariance C(D) is sum over D of exp(t t' C(D)) - 1. The sum
    neglects noise beneath pulses, which is small for few pulses.
    """
    return (_by_pulses(pulses, observed) + _by_noise(pulses, observed)) / observed.pixels


def _by_pulses(pulses: PulsePopulation, observed: CharacteristicFunctionData) -> Array:
    height, chance = _heights(pulses.relative_variance)
    added = np.empty((len(height), *observed.frequency.shape), np.complex128)
    for index, (one, frequency) in enumerate(zip(observed.filters, observed.frequency, strict=True)):
        amplitude, area = pulse_outputs(one, pulses.spot, pulses.line, pulses.screen)
        z = np.multiply.outer(np.multiply.outer(height * pulses.height_dn, frequency), amplitude)
        added[:, index] = np.expm1(1j * z) @ area
    vector = np.stack([real_and_imaginary(np.asarray(one)) for one in added])
    return pulses.density * (vector.T * chance) @ vector


def _heights(relative_variance: float) -> tuple[Array, Array]:
    """Return Gauss-Laguerre heights of a gamma distribution of mean 1 and their weights."""
    from scipy.special import roots_genlaguerre

    shape = 1.0 / relative_variance
    if shape > 60.0:
        node, weight = np.polynomial.hermite_e.hermegauss(EVENT_ACCURACY.heights // 2)
        return np.maximum(1.0 + node / np.sqrt(shape), 1e-3), weight / weight.sum()
    node, weight = roots_genlaguerre(EVENT_ACCURACY.heights, shape - 1.0)
    return node / shape, weight / weight.sum()


def _by_noise(pulses: PulsePopulation, observed: CharacteristicFunctionData) -> Array:
    filters, frequency = observed.filters, observed.frequency
    count, times = frequency.shape
    even, odd = np.zeros((2, count, times, count, times))
    for a, one in enumerate(filters):
        for b, other in enumerate(filters):
            if b < a:
                even[a, :, b], odd[a, :, b] = even[b, :, a].T, odd[b, :, a].T
                continue
            shared = _output_covariance(one, other, pulses.line) * pulses.noise_dn2
            x = np.multiply.outer(np.multiply.outer(frequency[a], frequency[b]), shared)
            even[a, :, b] = (np.cosh(x) - 1.0).sum(axis=-1)
            odd[a, :, b] = np.sinh(x).sum(axis=-1)
    out = np.zeros((2 * count * times, 2 * count * times))
    half = count * times
    out[:half, :half], out[half:, half:] = even.reshape(half, half), odd.reshape(half, half)
    return out


def _output_covariance(one: Filter, other: Filter, line: tuple[float, ...]) -> Array:
    """Return the covariances of two filters' outputs at all separations, for noise of unit variance."""
    across = np.correlate(np.convolve(one.columns, line), np.convolve(other.columns, line), "full")
    down = np.correlate(np.ones(one.high), np.ones(other.high), "full")
    time = np.correlate(one.times, other.times, "full")
    return np.multiply.outer(np.multiply.outer(time, down), across).ravel()


def blend_covariances(computed: Array, counted: Array) -> Array:
    """Return the model covariance in directions dominated by pulses, and the block covariance in all others.

    Rare bright pulses lie in the few strongest directions, the neglected noise beneath pulses in the weak ones.
    """
    # Without pulses, weights of both signs may give negative values.
    unit = np.sqrt(np.maximum(np.diag(computed), 1e-6 * np.diag(counted)))
    power, direction = np.linalg.eigh(computed / np.outer(unit, unit))
    strong = direction[:, power > EVENT_ACCURACY.strong_direction]
    weak = np.eye(len(unit)) - strong @ strong.T
    rest = weak @ (counted / np.outer(unit, unit)) @ weak
    return (
        (strong * power[power > EVENT_ACCURACY.strong_direction]) @ strong.T + EVENT_ACCURACY.block_loss * rest
    ) * np.outer(unit, unit)
