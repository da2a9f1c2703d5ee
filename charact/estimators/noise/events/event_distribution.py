"""Distribution of a filtered dark pixel: compound Poisson process of pulses.

Detected photoelectrons are uniformly distributed; each gives a pulse of random height, spread over
pixels and exposures. The characteristic function is exact at any density and includes overlapping
pulses and pulses below the noise, so no threshold is needed.
"""

from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.events.frames import (
    Filter,
    PulseSpread,
    common_reach,
    quantise_amplitudes,
    responses,
)
from charact.estimators.noise.thresholds import EVENT_ACCURACY
from charact.frames.robust import NORMAL

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class PulseDecay:
    """Phosphor decay of a pulse: two exponentials."""

    glow: float = 0.0  # fraction of slow light, dimensionless
    # glow_exposures, fast_exposures: decay times of slow and fast light, exposures
    glow_exposures: float = 1.0
    fast_exposures: float = 0.0
    # fraction of the exposure period, from its start, in which pulses begin
    open_share: float = 1.0

    @property
    def lasts(self) -> bool:
        """Whether any light falls into later exposures."""
        return self.glow > 0.0 or self.fast_exposures > 0.0

    @lru_cache(maxsize=256)  # noqa: B019
    def by_exposure(self) -> tuple[Array, Array]:
        """Return the fractions of light in a pulse's own and later exposures, and quadrature
        weights.

        Returns `light`: shape (moment, exposure); `weight`: fraction of the pulses that begin then,
        shape (moment,).
        """
        if not self.lasts:
            return np.ones((1, 1)), np.ones(1)
        start, weight = _moments()
        start = self.open_share * start
        fractions = np.array([self.glow, 1.0 - self.glow])
        time = np.maximum([self.glow_exposures, self.fast_exposures], 1e-9)
        last = float(np.max(time * np.log(np.maximum(fractions / EVENT_ACCURACY.min_decay, 1.0))))
        end = np.arange(int(np.clip(np.ceil(last), 1, EVENT_ACCURACY.max_exposures)) + 1) + 1.0
        remaining = np.exp(-(end[None, :, None] - start[:, None, None]) / time) @ fractions
        return -np.diff(remaining, axis=1, prepend=1.0), weight


@lru_cache(maxsize=1)
def _moments() -> tuple[Array, Array]:
    """Return Gauss-Legendre start times in an exposure of length 1 and their weights, densest at
    its end.
    """
    node, weight = np.polynomial.legendre.leggauss(EVENT_ACCURACY.start_times)
    root = 0.5 * (node + 1.0)
    return 1.0 - root**2, root * weight


@dataclass(frozen=True, kw_only=True)
class PulsePopulation(PulseSpread, PulseDecay):
    """Pulses of a dark or dim frame."""

    density: float  # detected events per pixel and exposure
    height_dn: float  # mean pulse height, total light of a pulse, DN
    # relative variance of the pulse heights: Polya (gamma) distribution of inverse shape; 1 is
    # exponential
    relative_variance: float
    noise_dn2: float  # variance of the noise beneath the pulses, DN^2
    # line_1, line_2: fractions of a pixel's signal that the video filter moves to the next pixel of
    # the row and the one after, for noise and light alike
    line_1: float
    line_2: float

    def log_characteristic(self, matched: Filter, frequency: Array) -> NDArray[np.complex128]:
        """Return ln E exp(i t y) of filtered pixels y at frequencies t, shape (t,), 1/DN.

        rate * integral over positions of [E exp(i t h a(x)) - 1] - t^2 var / 2, with a(x) the
        filter output of a pulse of unit light at x and E exp(i s h) = (1 - i s G v)^(-1/v) of a
        gamma distribution of mean G and relative variance v (Campbell's theorem). The output
        includes the subtracted temporal mean.
        """
        amplitude, area = pulse_outputs(matched, self.spot, self.line, self.screen)
        pulse = height_transform(
            np.multiply.outer(frequency * self.height_dn, amplitude), self.relative_variance
        )
        return (
            self.density * (pulse @ area)
            - 0.5 * frequency**2 * matched.noise(self.line) * self.noise_dn2
        )

    @property
    def line(self) -> tuple[float, float, float]:
        """Impulse response of the video filter along a line."""
        return 1.0 - self.line_1 - self.line_2, self.line_1, self.line_2

    @property
    def spot(self) -> PulseSpread:
        """Spread of a pulse alone."""
        return PulseSpread(**{part.name: getattr(self, part.name) for part in fields(PulseSpread)})

    @property
    def screen(self) -> PulseDecay:
        """Phosphor decay alone."""
        return PulseDecay(**{part.name: getattr(self, part.name) for part in fields(PulseDecay)})


def height_transform(z: Array, relative_variance: float) -> NDArray[np.complex128]:
    """Return E exp(i z h) - 1 of gamma-distributed heights h of mean 1."""
    shape = 1.0 / relative_variance
    size = np.exp(-0.5 * shape * np.log1p((z * relative_variance) ** 2))
    phase = shape * np.arctan(z * relative_variance)
    return size * np.cos(phase) - 1.0 + 1j * size * np.sin(phase)


@lru_cache(maxsize=512)
def pulse_outputs(
    matched: Filter, spot: PulseSpread, line: tuple[float, ...], screen: PulseDecay
) -> tuple[Array, Array]:
    """Return the outputs for pulses of unit light at all positions and ages: amplitudes, and px
    exposures of each.
    """
    amplitude, area = responses(matched, spot, line)
    factor, number = age_amplitudes(matched, screen)
    value, weight = (
        np.multiply.outer(factor, amplitude).ravel(),
        np.multiply.outer(number, area).ravel(),
    )
    return quantise_amplitudes(value, weight) if screen.lasts else (value, weight)


@lru_cache(maxsize=512)
def age_amplitudes(matched: Filter, screen: PulseDecay) -> tuple[Array, Array]:
    """Return the output of a temporal filter for pulses of every age: amplitudes and their numbers.

    A pulse begins at any time of any exposure; the subtracted temporal mean contains its light too.
    """
    light, chance = screen.by_exposure()
    amplitude = amplitudes_by_age(matched, light)
    mean_part = sum_by_phase(matched, light)
    mean_exposures = np.maximum(
        matched.exposures
        - np.bincount(np.arange(amplitude.shape[1]) % matched.stride, minlength=matched.stride),
        0,
    )
    number = np.broadcast_to(chance[:, None], amplitude.shape)
    value = np.concatenate([amplitude.ravel(), -mean_part.ravel()])
    return value, np.concatenate(
        [number.ravel(), np.multiply.outer(chance, mean_exposures).ravel()]
    )


def amplitudes_by_age(matched: Filter, light: Array) -> Array:
    """Return the amplitude of pulses of every age, shape (moment, age), for their light, shape
    (moment, exposure).
    """
    moments, count = light.shape
    width = (len(matched.times) - 1) * matched.stride
    out = np.zeros((moments, count + width))
    for exposure, weight in enumerate(reversed(matched.times)):
        out[:, exposure * matched.stride : exposure * matched.stride + count] += weight * light
    return out - sum_by_phase(matched, light)[:, np.arange(out.shape[1]) % matched.stride]


def sum_by_phase(matched: Filter, light: Array) -> Array:
    """Return the part of a pulse removed with the temporal mean, by the parity of its start, shape
    (moment, phase).
    """
    total = np.stack(
        [light[:, phase :: matched.stride].sum(axis=1) for phase in range(matched.stride)], axis=1
    )
    return total * sum(matched.times) / matched.exposures


@dataclass(frozen=True, kw_only=True)
class CharacteristicFunctionData:
    """What frames show."""

    filters: tuple[Filter, ...]  # filters
    frequency: Array  # frequencies of each, shape (filter, t), 1/DN
    # ln of the characteristic functions, real parts, then imaginary ones, shape (2 filter t,)
    value: Array
    # covariance of the values, from the scatter of blocks, shape (2 filter t, 2 filter t)
    covariance: Array
    pixels: float  # number of pixels over all exposures

    def model(self, pulses: PulsePopulation) -> Array:
        """Return the model of pulses, shape (2 filter t,)."""
        pairs = zip(self.filters, self.frequency, strict=True)
        return real_and_imaginary(
            np.stack(
                [pulses.log_characteristic(matched, frequency) for matched, frequency in pairs]
            )
        )


def real_and_imaginary(values: NDArray[np.complex128]) -> Array:
    """Return real parts, then imaginary ones, as one vector."""
    return np.concatenate([values.real.ravel(), values.imag.ravel()])


Images = NDArray[np.float32]


def observe(
    changes: tuple[Images, ...], usable: list[NDArray[np.bool_]], filters: tuple[Filter, ...]
) -> CharacteristicFunctionData:
    """Return ln of the characteristic functions of filtered frames, and their covariance from
    blocks.

    `changes`: fluctuations for each parity, shape (exposure, row, col), DN; `usable`: usable
    values, same shapes; `filters`: filters.

    Filter weights sum to zero, and so does their output except for pulses at the border: its mean
    is subtracted, which rotates the functions by t times it.
    """
    scales: list[Array] = []
    parts = [
        _sums(change, mask, filters, scales) for change, mask in zip(changes, usable, strict=True)
    ]
    sums, levels, count = (np.concatenate([part[i] for part in parts]) for i in range(3))
    frequency = np.stack(scales)
    mean, level = sums.sum(axis=0) / count.sum(), levels.sum(axis=0) / count.sum()
    off = (sums - count[:, None, None] * mean) / mean
    off = (off - 1j * (levels - count[:, None] * level)[..., None] * frequency) / count.sum()
    scatter = np.concatenate(
        [off.real.reshape(len(off), -1), off.imag.reshape(len(off), -1)], axis=1
    )
    return CharacteristicFunctionData(
        filters=filters,
        frequency=frequency,
        value=real_and_imaginary(np.log(mean * np.exp(-1j * level[:, None] * frequency))),
        covariance=scatter.T @ scatter,
        pixels=float(count.sum()),
    )


def _sums(
    change: Images, usable: NDArray[np.bool_], filters: tuple[Filter, ...], scales: list[Array]
):
    """Return sums of exp(i t y) and of y over blocks, shapes (block, filter, t) and (block,
    filter), and their counts.

    The first parity also sets the frequencies of every filter.
    """
    margin = common_reach(filters)
    length = len(change) - max(len(matched.times) for matched in filters) + 1
    inner = usable[
        :length, margin[0] : change.shape[1] - margin[0], margin[1] : change.shape[2] - margin[1]
    ]
    blocks = _Blocks.of(
        inner,
        EVENT_ACCURACY.block_exposures if any(len(matched.times) > 1 for matched in filters) else 1,
    )
    still = {}
    out, known = [], len(scales) == len(filters)
    for index, matched in enumerate(filters):
        key = matched.high, matched.broad
        if key not in still:
            still[key] = Filter(high=matched.high, broad=matched.broad).within(change, margin)
        values = matched.through_time(still[key])[:length]
        if not known:
            scales.append(frequencies(values))
        out.append(blocks.sums(values, scales[index]))
    return (
        np.stack([total for total, _ in out], axis=1),
        np.stack([y for _, y in out], axis=1),
        blocks.count,
    )


def frequencies(values: Images) -> Array:
    """Return the frequencies of the characteristic function of a filter's output, shape (t,),
    1/DN.
    """
    sample = values.ravel()[:: max(1, values.size // EVENT_ACCURACY.sample)]
    ranks = (np.array([0.25, 0.5, 0.999]) * (len(sample) - 1)).astype(int)
    sample = np.partition(sample, ranks)
    low, middle = sample[ranks[:2]]
    # Noise without pulses, and mean of the brightest thousandth.
    noise, bright = max(NORMAL * float(middle - low), 1e-9), float(sample[ranks[2] :].mean())
    high = EVENT_ACCURACY.highest_frequency / noise
    low = min(EVENT_ACCURACY.lowest_frequency / max(bright, 1e-12), 0.25 * high)
    return np.geomspace(low, high, EVENT_ACCURACY.frequencies)


@dataclass(frozen=True, kw_only=True)
class _Blocks:
    """Blocks of pixels and exposures: first bin of each exposure and pixel, usable values, values
    per block.
    """

    first: NDArray[np.int64]
    usable: NDArray[np.bool_] | None
    count: Array

    @classmethod
    def of(cls, usable: NDArray[np.bool_], least_depth: int) -> "_Blocks":
        block = EVENT_ACCURACY.block_px
        block_row, block_col = (
            np.minimum(np.arange(n) // block, max(n // block, 1) - 1) for n in usable.shape[1:]
        )
        across = int(block_col[-1]) + 1
        block_of_pixel = block_row[:, None] * across + block_col
        images = int(block_of_pixel[-1, -1]) + 1
        depth = max(least_depth, -(-len(usable) * images // EVENT_ACCURACY.max_blocks))
        time = np.arange(len(usable)) // depth
        first = (time[:, None, None] * images + block_of_pixel) * EVENT_ACCURACY.bins
        chosen = None if usable.all() else usable
        block_count = np.bincount(
            (first if chosen is None else first[usable]).ravel() // EVENT_ACCURACY.bins,
            minlength=(int(time[-1]) + 1) * images,
        )
        return cls(first=first, usable=chosen, count=block_count.astype(float))

    def sums(self, values: Images, frequency: Array) -> tuple[NDArray[np.complex128], Array]:
        """Return sums of exp(i t y) over blocks, shape (block, t), and of y, shape (block,)."""
        bins = EVENT_ACCURACY.bins
        step, half = EVENT_ACCURACY.bin_width / frequency[-1], bins // 2
        position = values * np.float32(1.0 / step)
        position += np.float32(half + 0.5)
        # The first and the last bin are summed individually.
        np.clip(position, 0.0, bins - 0.5, out=position)
        index = position.astype(np.intp)
        is_outer = (index == 0) | (index == bins - 1)
        index += self.first
        if self.usable is not None:
            index, is_outer = index[self.usable], is_outer & self.usable
        count = np.bincount(index.ravel(), minlength=len(self.count) * bins).reshape(-1, bins)
        count[:, [0, -1]] = 0
        centre = step * (np.arange(bins) - half)
        # Averaging over a bin lowers a wave by sin(x)/x of half its phase.
        waves = np.exp(1j * np.multiply.outer(centre, frequency)) * np.sinc(
            0.5 * step * frequency / np.pi
        )
        number = count.astype(np.float64)
        total, level = np.asarray(number @ waves, np.complex128), number @ centre
        y, block = values[is_outer].astype(np.float64), self.first[is_outer] // bins
        np.add.at(total, block, np.exp(1j * np.multiply.outer(y, frequency)))
        np.add.at(level, block, y)
        return total, level


def scatter(pulses: PulsePopulation, observed: CharacteristicFunctionData) -> Array:
    """Return the covariance of the data for given pulses, shape (2 filter t, 2 filter t).

    The mean of exp(i t y) over N pixels, divided by its expectation, is 1 plus what each pulse of
    height h adds, c(h) = integral over positions of [exp(i t h a(x)) - 1], plus the noise. Pulses
    are Poisson distributed: their covariance is rate/N <c c'>. That of Gaussian noise of covariance
    C(D) is sum over D of exp(t t' C(D)) - 1. The sum neglects noise beneath pulses, which is small
    for few pulses.
    """
    return (_by_pulses(pulses, observed) + _by_noise(pulses, observed)) / observed.pixels


def _by_pulses(pulses: PulsePopulation, observed: CharacteristicFunctionData) -> Array:
    height, chance = _heights(pulses.relative_variance)
    added = np.empty((len(height), *observed.frequency.shape), np.complex128)
    for index, (matched, frequency) in enumerate(
        zip(observed.filters, observed.frequency, strict=True)
    ):
        amplitude, area = pulse_outputs(matched, pulses.spot, pulses.line, pulses.screen)
        z = np.multiply.outer(np.multiply.outer(height * pulses.height_dn, frequency), amplitude)
        added[:, index] = np.expm1(1j * z) @ area
    vector = np.stack([real_and_imaginary(np.asarray(matched)) for matched in added])
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
    cosines, sines = np.zeros((2, count, times, count, times))
    for a, matched in enumerate(filters):
        for b, other in enumerate(filters):
            if b < a:
                cosines[a, :, b], sines[a, :, b] = cosines[b, :, a].T, sines[b, :, a].T
                continue
            shared = _output_covariance(matched, other, pulses.line) * pulses.noise_dn2
            x = np.multiply.outer(np.multiply.outer(frequency[a], frequency[b]), shared)
            cosines[a, :, b] = (np.cosh(x) - 1.0).sum(axis=-1)
            sines[a, :, b] = np.sinh(x).sum(axis=-1)
    out = np.zeros((2 * count * times, 2 * count * times))
    half = count * times
    out[:half, :half], out[half:, half:] = cosines.reshape(half, half), sines.reshape(half, half)
    return out


def _output_covariance(first: Filter, second: Filter, line: tuple[float, ...]) -> Array:
    """Return the covariances of two filters' outputs at all separations, for noise of unit
    variance.
    """
    across = np.correlate(
        np.convolve(first.columns, line), np.convolve(second.columns, line), "full"
    )
    down = np.correlate(np.ones(first.high), np.ones(second.high), "full")
    time = np.correlate(first.times, second.times, "full")
    return np.multiply.outer(np.multiply.outer(time, down), across).ravel()


def blend_covariances(computed: Array, counted: Array) -> Array:
    """Return the model covariance in directions dominated by pulses, and the block covariance in
    all others.

    Rare bright pulses lie in the few strongest directions, the neglected noise beneath pulses in
    the weak ones.
    """
    # Without pulses, weights of both signs may give negative values.
    unit = np.sqrt(np.maximum(np.diag(computed), 1e-6 * np.diag(counted)))
    power, direction = np.linalg.eigh(computed / np.outer(unit, unit))
    strong = direction[:, power > EVENT_ACCURACY.strong_direction]
    weak = np.eye(len(unit)) - strong @ strong.T
    weak_part = weak @ (counted / np.outer(unit, unit)) @ weak
    strong_part = (strong * power[power > EVENT_ACCURACY.strong_direction]) @ strong.T
    return (strong_part + EVENT_ACCURACY.block_loss * weak_part) * np.outer(unit, unit)
